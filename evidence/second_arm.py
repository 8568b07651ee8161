"""Run the chain on the second arm: identify its tracking bound, plan the packaged scenes with it, and execute them.

The bound comes from the tracking study with the setting `arm`; finished runs in --work are reused. Occupancy comes from
a frozen ensemble. All motions are executed beside the true hands and judged by the safety report.
"""

import dataclasses
import os
import pathlib
import sys

from deltasafe import presets
from deltasafe.execution import ArmSettings
from deltasafe.perception.artifact.frozen_ensemble import load_ensemble
from deltasafe.studies.tracking import TrackingStudy, TrackingStudySettings, run_study
from deltasafe.trials.executions import execute_scenes
from deltasafe.trials.motions import PlannedScenes, plan_scenes
from deltasafe.trials.occupancy_fields import write_fields
from deltasafe.trials.safety_report import SafetyReport
from deltasafe.trials.selection import select_scenes
from deltasafe.trials.write_safety_report import write_safety_report
from evidence.reporting import command_parser, finish, print_progress
from pipelines.command_line import run_command
from pipelines.home import PROJECT

STUDY = TrackingStudySettings(n_slope_runs=50, n_bound_runs=300, n_held_out_runs=100)
KEPT = ("gamma0_m", "gamma1_s", "runs", "held_out_runs", "coverage", "coverage_lower95")
"""Figures of the tracking study that are recorded, without their prefix."""


def main(arguments: list[str] | None = None) -> int:
    """Run ``python -m evidence.second_arm``; 1 if a scene is not executed, or an execution is not safe."""
    parser = command_parser("second_arm", __doc__, seeded=True)
    parser.add_argument("--ensemble", type=pathlib.Path, required=True, metavar="DIR", help="a frozen ensemble")
    parser.add_argument("--arm", default="panda", help="name or URDF file of the arm (default panda)")
    parser.add_argument("--flange", default="", metavar="LINK", help="link that carries the tool, for a URDF file")
    parser.add_argument("--scenes", type=pathlib.Path, default=PROJECT / "datasets" / "scenes", metavar="DIR")
    parser.add_argument("--work", type=pathlib.Path, default=pathlib.Path("second_arm"), metavar="DIR", help="results")
    parser.add_argument("--workers", type=int, default=os.cpu_count() or 1, help="number of processes")
    options = parser.parse_args(arguments)
    arm, work = ArmSettings(options.arm, options.flange), options.work
    study = run_study(dataclasses.replace(STUDY, arm=arm), work / "tracking", options.workers, print_progress(1))
    report = execute_all(options.scenes, options.ensemble, work, arm, study, options.seed, options.workers)
    failures = [f"{scene.scene_id}: {scene.outcome}" for scene in report.scenes if scene.verdict is None]
    failures += [
        f"{scene.scene_id} was not safe" for scene in report.scenes if scene.verdict and scene.verdict.safe is False
    ]
    seeds = {"tracking_runs_from": study.settings.first_seed, "scenes": options.seed}
    command = f"python -m evidence.second_arm --arm {options.arm} --ensemble {options.ensemble.name}"
    return finish(options, second_arm_figures(report, study), failures, seeds=seeds, command=command)


def execute_all(
    source: pathlib.Path,
    ensemble: pathlib.Path,
    work: pathlib.Path,
    arm: ArmSettings,
    study: TrackingStudy,
    seed: int,
    workers: int,
) -> SafetyReport:
    """Predict, plan, execute and judge all scenes below ``source``; each step is a folder below ``work``."""
    preset, loaded = presets.active(), load_ensemble(ensemble)
    scenes = select_scenes(source, 0, work / "scenes")
    planned = PlannedScenes(scenes, work / "fields", work / "motions")
    write_fields(loaded, scenes, planned.fields, preset.field, print_progress(5))
    bound = study.bound
    motion = dataclasses.replace(preset.motion, gamma0_m=bound.gamma0_m, gamma1_s=bound.gamma1_s)
    plan_scenes(scenes, planned.fields, planned.motions, motion, loaded.calibration, seed, print_progress(5))
    execution = dataclasses.replace(preset.execution, arm=arm)
    executions = work / "executions"
    execute_scenes(planned, executions, execution, seed, workers, progress=print_progress(5))
    return write_safety_report(planned, executions, work / "report", n_films=1, progress=print_progress(20))


def second_arm_figures(report: SafetyReport, study: TrackingStudy) -> dict[str, float]:
    """Figures of the second arm, from the safety report and the tracking study."""
    figures, tracking = report.figures(), study.figures()
    names = {"executions": "scenes_executed", "completed": "scenes_completed", "contacts": "contacts"}
    found = {f"second_arm_{name}": figures[figure] for name, figure in names.items()}
    found |= {"second_arm_scenes": figures["scenes"], "second_arm_unsafe": figures["scenes_unsafe"]}
    found |= {f"second_arm_tracking_{name}": tracking[f"tracking_{name}"] for name in KEPT}
    found |= {f"second_arm_{name}": figures[name] for name in ("min_tool_to_hand_m", "max_tracking_error_m")}
    return {name: float(value) for name, value in found.items() if value is not None}


if __name__ == "__main__":
    sys.exit(run_command(main))
