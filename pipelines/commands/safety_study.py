"""`make safety-study`: run the safety study as one Dagster run; finished scenarios are reused."""

import argparse
import pathlib
import sys
from typing import Any

from deltasafe.errors import DeltasafeError
from deltasafe.io.storage import read_json
from pipelines.command_line import run_command
from pipelines.commands.study_run import record_study, run_study, study_parser
from pipelines.home import prepare_home


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
    if options.film is not None:
        return _film(prepare_home(), options.film)
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
    folder = run_study("safety_study", {"safety_trials": trials}, "safety_study_report")
    if folder is None:
        return 1
    figures = read_json(folder / "figures.json")
    _print_summary(folder, figures)
    if options.record:
        _record(options, folder)
    return 0


def _film(root: pathlib.Path, trial: int) -> int:
    from deltasafe.execution import Workcell, save_film
    from deltasafe.studies.safety import SafetyStudy, replay
    from pipelines.commands.run_job import latest_folder

    try:
        study = SafetyStudy.load(latest_folder(root, "safety_trials"))
        predictor = study.inputs.predictor
        assert predictor is not None
        scene, execution = replay(study.settings, study.inputs.scenes, predictor, trial)
        film = pathlib.Path(f"trial-{trial}.gif")
        save_film(film, execution, scene.camera, Workcell(execution.body, scene.true_mesh(), scene.table_z_m))
    except DeltasafeError as error:
        print(f"safety_study: {error}", file=sys.stderr)
        return 1
    print(film)
    return 0


def _record(options: argparse.Namespace, folder: pathlib.Path) -> None:
    study = read_json(folder / "study.json")
    given = ["--scenes", *(folder.name for folder in options.scenes)] if options.scenes else []
    given += ["--executions", str(options.executions)] if options.executions is not None else []
    given += ["--gamma", *(f"{value:g}" for value in options.gamma)] if options.gamma else []
    record_study(
        options.record,
        "safety_study",
        folder,
        seeds={"situations": study["settings"]["seed"]},
        options=given,
        ensemble=pathlib.Path(study["ensemble"]).name,
        settings=study["settings"],
    )


def _print_summary(folder: pathlib.Path, figures: dict[str, float]) -> None:
    print(f"\n{figures['executions']:.0f} motions executed in {figures['minutes']:.1f} minutes ", end="")
    print(f"({figures.get('realtime_factor', 0.0):.1f} times real time), {figures['failures']:.0f} failures\n")
    for name in sorted(figures):
        if name.startswith(("violation_upper95", "joint_", "contacts")):
            print(f"  {name:40s} {figures[name]:g}")
    print(f"\n  report  {folder / 'report.md'}")


if __name__ == "__main__":
    sys.exit(run_command(main))
