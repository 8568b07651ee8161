"""The report of the study: figures, Markdown with its pictures, failures with their films, and all trials beside it."""

import pathlib

import numpy as np

from deltasafe.compute.progress import Progress, silent
from deltasafe.execution.film import save_film
from deltasafe.io.storage import atomic_folder, write_json
from deltasafe.studies.safety.evidence import cell, failures, touched
from deltasafe.studies.safety.report_text import safety_study_markdown
from deltasafe.studies.safety.runs import replay
from deltasafe.studies.safety.study import SafetyStudy

__all__ = ["figures_of", "write_safety_study"]

PICTURES = ("rates", "clearances", "speed")


def figures_of(study: SafetyStudy) -> dict[str, float]:
    """The figures that a record holds, by name. Those without a contender's name are of ours.

    ``delta_001`` is delta = 0.01, and so on. ``violation`` is about the field that was used, ``touch`` about the true
    hand; ``joint`` counts motions, the others poses.
    """
    executed = study.executed
    seconds = 60 * study.effort.minutes
    execute_s = study.stage_s["execute"]
    figures: dict[str, float] = {
        "executions": float(executed.sum()),
        "trials": float(len(executed)),
        "situations": float(len(np.unique(study.trials["situation"]))),
        "scenes": float(len(np.unique(study.trials["scene"]))),
        "failures": float(len(failures(study))),
        "minutes": study.effort.minutes,
        "cpu_minutes": study.effort.cpu_minutes,
        "realtime_factor": study.simulated_s / seconds if seconds > 0 else float("nan"),
        "realtime_factor_execution_one_core": study.simulated_s / execute_s if execute_s > 0 else float("nan"),
        **{f"cpu_s_per_trial_{stage}": spent / len(executed) for stage, spent in study.stage_s.items()},
    }
    for name in study.settings.contenders:
        for delta in study.settings.deltas_of(name):
            level = f"delta_{round(100 * delta):03d}"
            found, prefix = cell(study, name, delta), "" if name == "ours" else f"{name}_"
            figures |= {
                f"{prefix}executions_{level}": found.executed,
                f"{prefix}refused_{level}": found.trials - found.executed,
                f"{prefix}contacts_{level}": found.contacts,
                f"{prefix}stopped_{level}": found.stopped,
                f"{prefix}min_tool_mm_{level}": 1000 * found.min_tool_m,
                f"{prefix}min_arm_mm_{level}": 1000 * found.min_arm_m,
            }
            for kind, rate in (("violation", found.model), ("touch", found.reality)):
                figures |= {
                    f"{prefix}{kind}_pose_rate_{level}": rate.pose_rate,
                    f"{prefix}{kind}_upper95_{level}": rate.pose_upper95,
                    f"{prefix}joint_{kind}_motions_{level}": rate.violated,
                    f"{prefix}joint_{kind}_upper95_{level}": rate.upper95,
                    f"{prefix}joint_{kind}_upper95_new_scene_{level}": rate.scenes_upper95,
                }
    return {name: round(float(value), 6) for name, value in figures.items() if np.isfinite(value)}


def write_safety_study(study: SafetyStudy, folder: str | pathlib.Path, progress: Progress = silent) -> dict[str, float]:
    """Write `report.md` with its pictures, `trials.npz`, `figures.json` and films, as a whole; returns the figures.

    The first ``n_films`` failures are executed once more for their films; without eyes nothing is filmed.
    """
    from deltasafe.studies.safety.figures import plot_clearances, plot_rates, plot_speed

    figures = figures_of(study)
    with atomic_folder(folder) as temporary:
        study.save(temporary)
        for draw, name in zip((plot_rates, plot_clearances, plot_speed), PICTURES, strict=True):
            draw(study, temporary / f"{name}.png")
        films = {}
        inputs = study.inputs
        if inputs.eyes is not None:
            chosen = _to_film(study)
            for done, trial in enumerate(chosen, start=1):
                scene, execution = replay(study.settings, inputs.scenes, inputs.eyes, trial)
                films[trial] = f"trial-{trial}.gif"
                mesh = scene.true_mesh()
                save_film(temporary / films[trial], execution, scene.camera, mesh, table_z_m=scene.table_z_m)
                progress(done, len(chosen), f"filmed trial {trial}")
        write_json(temporary / "figures.json", figures)
        (temporary / "report.md").write_text(safety_study_markdown(study, films), encoding="utf-8")
    return figures


def _to_film(study: SafetyStudy) -> list[int]:
    """Failures of ours first, then contacts, in the order of their numbers."""
    numbers, hit = failures(study), touched(study)
    contender = study.trials["contender"]
    ranked = sorted(map(int, numbers), key=lambda trial: (contender[trial] > 0, not hit[trial], trial))
    return ranked[: study.settings.n_films]
