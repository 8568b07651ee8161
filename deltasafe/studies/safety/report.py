"""Report of the safety study: Markdown with figures, films of failures, and all trials beside it."""

import math
import pathlib

import numpy as np
from numpy.typing import NDArray

from deltasafe.compute.progress import Progress, silent
from deltasafe.execution.film import save_film
from deltasafe.execution.workcell import Workcell
from deltasafe.io.storage import atomic_folder, write_json
from deltasafe.reporting.templates import render
from deltasafe.studies.safety.evidence import by_speed, evaluate_all, failures, pair, touched
from deltasafe.studies.safety.runs import replay
from deltasafe.studies.safety.settings import LABELS, METHODS, PARAMETRIC
from deltasafe.studies.safety.study import SafetyStudy

MAX_FAILURES = 60
"""Failures that the report lists."""


def figures_of(study: SafetyStudy) -> dict[str, float]:
    """Collect the figures of a record, by name. Names without a method belong to ours.

    ``delta_001`` stands for delta = 0.01. ``violation`` refers to the field used, ``touch`` to the true hand. ``joint``
    counts motions, the others count poses.
    """
    executed = study.executed
    seconds = 60 * study.effort.minutes
    execute_s = study.stage_s["execute"]
    figures: dict[str, float] = {
        "executions": float(executed.sum()),
        "trials": float(len(executed)),
        "situations": float(len(np.unique(study.trials["scenario"]))),
        "scenes": float(len(np.unique(study.trials["scene"]))),
        "failures": float(len(failures(study))),
        "minutes": study.effort.minutes,
        "cpu_minutes": study.effort.cpu_minutes,
        "realtime_factor": study.simulated_s / seconds if seconds > 0 else float("nan"),
        "realtime_factor_execution_one_core": study.simulated_s / execute_s if execute_s > 0 else float("nan"),
        **{f"cpu_s_per_trial_{stage}": spent / len(executed) for stage, spent in study.stage_s.items()},
    }
    for found in evaluate_all(study):
        level = f"delta_{round(100 * found.delta):03d}"
        prefix = "" if found.method == "ours" else f"{found.method}_"
        figures |= {
            f"{prefix}executions_{level}": found.executed,
            f"{prefix}refused_{level}": found.trials - found.executed,
            f"{prefix}contacts_{level}": found.contacts,
            f"{prefix}stopped_{level}": found.stopped,
            f"{prefix}min_tool_mm_{level}": 1000 * found.min_tool_m,
            f"{prefix}min_arm_mm_{level}": 1000 * found.min_arm_m,
        }
        for kind, rate in (("violation", found.violation), ("touch", found.touch)):
            figures |= {
                f"{prefix}{kind}_pose_rate_{level}": rate.pose_rate,
                f"{prefix}{kind}_upper95_{level}": rate.pose_upper95,
                f"{prefix}joint_{kind}_motions_{level}": rate.violated,
                f"{prefix}joint_{kind}_upper95_{level}": rate.upper95,
                f"{prefix}joint_{kind}_upper95_new_scene_{level}": rate.scenes_upper95,
            }
    return {name: round(float(value), 6) for name, value in figures.items() if np.isfinite(value)}


def write_report(study: SafetyStudy, folder: str | pathlib.Path, progress: Progress = silent) -> dict[str, float]:
    """Write report.md with its figures, trials.npz, figures.json and films atomically; return the figures.

    The first ``n_films`` failures are executed again for their films. Without a predictor nothing is filmed.
    """
    from deltasafe.studies.safety.figures import plot_clearances, plot_rates, plot_speed

    figures = figures_of(study)
    with atomic_folder(folder) as temporary:
        study.save(temporary)
        for draw, name in ((plot_rates, "rates"), (plot_clearances, "clearances"), (plot_speed, "speed")):
            draw(study, temporary / f"{name}.png")
        films = _film_failures(study, temporary, progress)
        write_json(temporary / "figures.json", figures)
        (temporary / "report.md").write_text(_markdown(study, films), encoding="utf-8")
    return figures


def _film_failures(study: SafetyStudy, folder: pathlib.Path, progress: Progress) -> dict[int, str]:
    """Film failures of ours first, then contacts, in the order of their numbers; return file names by trial."""
    inputs, films = study.inputs, dict[int, str]()
    if inputs.predictor is None:
        return films
    hit, method = touched(study), study.trials["method"]
    ranked = sorted(map(int, failures(study)), key=lambda trial: (method[trial] > 0, not hit[trial], trial))
    chosen = ranked[: study.settings.n_films]
    for done, trial in enumerate(chosen, start=1):
        scene, execution = replay(study.settings, inputs.scenes, inputs.predictor, trial)
        films[trial] = f"trial-{trial}.gif"
        cell = Workcell(execution.body, scene.true_mesh(), scene.table_z_m)
        save_film(folder / films[trial], execution, scene.camera, cell)
        progress(done, len(chosen), f"filmed trial {trial}")
    return films


def _markdown(study: SafetyStudy, films: dict[int, str]) -> str:
    settings, smallest, failed = study.settings, study.inputs.smallest_supported_delta, failures(study).tolist()
    results = list(evaluate_all(study))
    # filmed failures first, then ours, then by number
    listed = sorted(failed, key=lambda number: (number not in films, study.trials["method"][number] > 0, number))
    return render(
        "deltasafe.studies.safety",
        "report.md.j2",
        study=study,
        settings=settings,
        results=results,
        by_speed=by_speed,
        pair=pair,
        reasons=sorted({reason for found in results for reason in found.refusals}),
        miss_rates=_miss_rates(study) if "single_member" in settings.compared else {},
        is_finite=math.isfinite,
        names=LABELS,
        methods=METHODS,
        minutes=study.effort.minutes,
        executed=int(study.executed.sum()),
        n_trials=len(study.executed),
        n_scenarios=len(np.unique(study.trials["scenario"])),
        n_scenes=len(np.unique(study.trials["scene"])),
        smallest_delta=smallest,
        unsupported=[f"{delta:g}" for delta in settings.deltas if smallest is None or delta < smallest],
        parametric=[name for name in PARAMETRIC if name in settings.compared],
        pose_spacing_m=settings.motion.v_max_mps / settings.execution.record_rate_hz,
        n_failures=len(failed),
        listed=[(n, {name: column[n] for name, column in study.trials.items()}) for n in listed[:MAX_FAILURES]],
        films=films,
    )


def _miss_rates(study: SafetyStudy) -> dict[float, dict[str, NDArray[np.float64]]]:
    """Return the miss rates of ensemble and single member in the scenarios of the latter, by delta."""
    miss_rate, scenario = study.trials["miss_rate"], study.trials["scenario"]
    chosen = {}
    for delta in study.settings.deltas:
        single = study.of("single_member", delta)
        ours = study.of("ours", delta) & np.isin(scenario, scenario[single])
        chosen[delta] = {"single": miss_rate[single], "ensemble": miss_rate[ours]}
    return chosen
