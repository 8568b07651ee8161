"""`make safety-study`: run the safety study as one Dagster run; finished scenarios are reused."""

import argparse
import os
import pathlib
import sys
from typing import Any

from deltasafe.errors import DeltasafeError
from deltasafe.io.storage import read_json
from deltasafe.presets import VARIABLE
from pipelines.command_line import run_command, study_parser
from pipelines.commands.pictures import record_report
from pipelines.home import prepare_home

__all__ = ["main"]


def safety_study():  # type: ignore[no-untyped-def]
    """Return the job; the processes of its steps import it by this name."""
    from pipelines.definitions import defs

    return defs().resolve_job_def("safety_study")


def main() -> int:
    """Run the job, or film one trial of the last run; return 0 on success, 1 otherwise."""
    parser = study_parser("safety_study", __doc__)
    parser.add_argument(
        "--scenes", type=pathlib.Path, nargs="+", metavar="DIR", help="folders of scenes (default: packaged)"
    )
    parser.add_argument("--executions", type=int, help="smallest number of executed motions")
    parser.add_argument(
        "--ensemble", type=pathlib.Path, metavar="DIR", help="a frozen ensemble (default: the one in use)"
    )
    parser.add_argument("--gamma", type=float, nargs=2, metavar=("GAMMA0_M", "GAMMA1_S"), help="tracking bound")
    parser.add_argument("--film", type=int, metavar="TRIAL", help="only film this trial of the last run")
    options = parser.parse_args()
    root = prepare_home()
    if options.film is not None:
        return _film(root, options.film)
    print(f"Results are written to {root}", flush=True)

    import dagster as dg

    from pipelines.commands.run_job import latest_folder, run_to_end

    study: dict[str, Any] = {}
    if options.executions is not None:
        study["n_executions"] = options.executions
    if options.gamma:
        study["motion"] = dict(zip(("gamma0_m", "gamma1_s"), options.gamma, strict=True))
    trials: dict[str, Any] = {"workers": options.workers, "study": study}
    if options.scenes:
        trials["scenes"] = [str(folder.expanduser().resolve()) for folder in options.scenes]
    if options.ensemble:
        trials["ensemble"] = str(options.ensemble.expanduser().resolve())
    if not run_to_end(dg.reconstructable(safety_study), {"safety_trials": trials}, "`make safety-study`"):
        return 1
    folder = latest_folder(root, "safety_study_report")
    figures = read_json(folder / "figures.json")
    _print_summary(folder, figures)
    if options.record:
        _record(options, figures, folder)
    return 0


def _film(root: pathlib.Path, trial: int) -> int:
    from deltasafe.execution import save_film
    from deltasafe.studies.safety import SafetyStudy, replay
    from pipelines.commands.run_job import latest_folder

    try:
        study = SafetyStudy.load(latest_folder(root, "safety_trials"))
        predictor = study.inputs.predictor
        assert predictor is not None
        scene, execution = replay(study.settings, study.inputs.scenes, predictor, trial)
        film = pathlib.Path(f"trial-{trial}.gif")
        save_film(film, execution, scene.camera, scene.true_mesh(), table_z_m=scene.table_z_m)
    except DeltasafeError as error:
        print(f"safety_study: {error}", file=sys.stderr)
        return 1
    print(film)
    return 0


def _record(options: argparse.Namespace, figures: dict[str, float], folder: pathlib.Path) -> None:
    """Merge the figures into the record; copy the report beside it, with smaller images."""
    from pipelines.commands.records import merge_part

    destination: pathlib.Path = options.record
    study = read_json(folder / "study.json")
    preset = os.environ.get(VARIABLE) or "default"
    given = [] if preset == "default" else [f"{VARIABLE}={preset}"]
    given += ["python -m pipelines.commands.safety_study"]
    given += ["--scenes", *(folder.name for folder in options.scenes)] if options.scenes else []
    given += ["--executions", str(options.executions)] if options.executions is not None else []
    given += ["--gamma", *(f"{value:g}" for value in options.gamma)] if options.gamma else []
    merge_part(
        destination,
        "safety_study",
        figures,
        command=" ".join(given),
        seeds={"situations": study["settings"]["seed"]},
        ensemble=pathlib.Path(study["ensemble"]).name,
        settings=study["settings"],
    )
    record_report(folder, destination.parent / "safety_study")


def _print_summary(folder: pathlib.Path, figures: dict[str, float]) -> None:
    print(f"\n{figures['executions']:.0f} motions executed in {figures['minutes']:.1f} minutes ", end="")
    print(f"({figures.get('realtime_factor', 0.0):.1f} times real time), {figures['failures']:.0f} failures\n")
    for name in sorted(figures):
        if name.startswith(("violation_upper95", "joint_", "contacts")):
            print(f"  {name:40s} {figures[name]:g}")
    print(f"\n  report  {folder / 'report.md'}")


if __name__ == "__main__":
    sys.exit(run_command(main))
