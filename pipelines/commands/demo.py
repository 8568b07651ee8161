"""`make demo`: run the whole pipeline as one Dagster run, with progress in the terminal, and print a summary."""

import argparse
import os
import pathlib
import shlex
import sys
import time
from collections.abc import Mapping
from types import MappingProxyType
from typing import Any

from deltasafe.io.storage import read_json, write_json
from deltasafe.presets import VARIABLE
from pipelines.command_line import run_command
from pipelines.commands.pictures import record_pictures
from pipelines.commands.provenance import commit, machine
from pipelines.home import home, prepare_home
from pipelines.own_data import converted, home_of, steps_of

_OWN_DATA = {
    "hands": "labeled training images: images/ and masks/, or labels of another tool",
    "test": "labeled test images",
    "scenes": "folder of scene folders",
    "backgrounds": "pictures without the obstacle",
}


def main(arguments: list[str] | None = None) -> int:
    """Run the job; return 0 if every step and every blocking check passed, else 1."""
    parser = argparse.ArgumentParser(prog="python -m pipelines.commands.demo", description=__doc__)
    parser.add_argument("--record", type=pathlib.Path, help="also write the figures to this file (docs/results/...)")
    for name, meaning in _OWN_DATA.items():
        parser.add_argument(f"--{name}", default="", metavar="FOLDER", help=f"{meaning} (default: packaged)")
    options = parser.parse_args(arguments)
    given = {name: value for name in _OWN_DATA if (value := getattr(options, name))}
    if given and options.record:
        parser.error("--record is for the packaged data: recorded figures must not come from other folders")
    return run_command(lambda: _run_own(given) if given else _run(options.record))


def _run_own(given: Mapping[str, str]) -> int:
    """Run the job on folders of the user, in a home of their own below `$DELTASAFE_HOME`."""
    folders = converted(home(), given)
    os.environ["DELTASAFE_HOME"] = str(home_of(home(), folders))
    return _run(None, folders)


def _run(recorded: pathlib.Path | None, given: Mapping[str, str] = MappingProxyType({})) -> int:
    root = prepare_home()
    preset = os.environ.get(VARIABLE) or "default"
    if recorded and (root / "store").exists():
        print(f"{root} contains earlier results, which a run would reuse: its duration would not be that of a whole")
        print("run. Record in a new home: DELTASAFE_HOME=/some/new/folder make record")
        return 1
    print(f"Preset {preset!r}; results are written to {root}", flush=True)

    from pipelines.commands.run_job import run_to_end  # imports dagster, which takes seconds

    began_s = time.monotonic()
    words = [f"{name.upper()}={shlex.quote(folder)}" for name, folder in given.items()]
    command = " ".join([f"make {'record' if recorded else 'demo'}", *words])
    if not run_to_end("everything", steps_of(given), f"`{command}`"):
        return 1
    figures = _figures(root) | {"minutes_total": round((time.monotonic() - began_s) / 60, 1)}
    command += "" if preset == "default" else f" PRESET={preset}"
    record = {
        "figures": figures,
        "command": command,
        "commit": commit(),
        "seeds": _seeds(root),
        "machine": machine(),
    }
    write_json(root / "results.json", record)
    if recorded:
        write_json(recorded, record)
        record_pictures(_folder(root, "augmented_hands"), *_reports(root), recorded.with_suffix(""))
    _print_summary(root, figures, bool(given))
    return 0


def _reports(root: pathlib.Path) -> tuple[pathlib.Path, pathlib.Path]:
    return _folder(root, "calibration_report"), _folder(root, "safety_report")


def _figures(root: pathlib.Path) -> dict[str, Any]:
    from deltasafe.perception.calibration.report import CalibrationReport
    from deltasafe.trials.safety_report import read_figures

    calibration, safety = _reports(root)
    figures = {**CalibrationReport.load(calibration).figures(), **read_figures(safety)}
    return {name: None if value is None else round(value, 6) for name, value in figures.items()}


def _seeds(root: pathlib.Path) -> dict[str, int]:
    """Read the seeds from the results. Members and scenes have consecutive seeds from the first one on."""
    from deltasafe.perception.data.augmented_set import AugmentedSet
    from deltasafe.trials.executions import load_execution, load_outcomes
    from deltasafe.trials.motions import load_motion

    executions = _folder(root, "executed_motions")
    outcomes = load_outcomes(executions)
    executed = [index for index, outcome in enumerate(outcomes) if outcome.executed]
    seeds = {
        "augmentation": AugmentedSet.load(_folder(root, "augmented_hands")).settings.seed,
        "members_from": min(read_json(_folder(root, "frozen_ensemble") / "manifest.json")["seeds"]),
        "planning_from": load_motion(_folder(root, "planned_motions"), outcomes[0].scene_id).seed,
    }
    if executed:
        first = executed[0]
        seeds["execution_from"] = load_execution(executions, outcomes[first].scene_id).seed - first
    return seeds


def _folder(root: pathlib.Path, asset: str) -> pathlib.Path:
    from pipelines.commands.run_job import latest_folder

    return latest_folder(root, asset)


def _print_summary(root: pathlib.Path, figures: dict[str, Any], is_own_data: bool) -> None:
    from deltasafe.perception.data.dataset_info import DatasetInfo

    calibration, safety = _reports(root)
    obstacle = DatasetInfo.load(_folder(root, "raw_hands")).singular
    films = sorted(safety.glob("*.gif"))
    unjudged = figures["scenes_executed"] - figures["scenes_judged"]
    print(f"\nDone in {figures['minutes_total']:.1f} minutes.\n")
    print(
        f"  {int(figures['n_members'])} members: pixel accuracy {figures['pa']:.4f}, mIoU {figures['miou']:.4f}, "
        f"NLL {figures['nll']:.4f}, Brier score {figures['bs']:.4f}"
    )
    judged = (
        f", {figures['scenes_safe']} of {figures['scenes_judged']} judged ones safe throughout, "
        f"contacts with {obstacle} or table: {figures['contacts']}"
    )
    executed = f"  {figures['scenes_executed']} of {figures['scenes']} scenes executed"
    print(executed + (judged if figures["scenes_judged"] else ""))
    if unjudged:
        print(f"  contacts not judged in {unjudged} executed scenes, which have no true {obstacle}")
    print()
    print(f"  calibration report  {calibration / 'report.md'}")
    print(f"  safety report       {safety / 'report.md'}")
    print(f"  films               {', '.join(str(film) for film in films) or 'none'}")
    print(f"  frozen ensemble     {_folder(root, 'frozen_ensemble')}")
    if _folder(root, "champion") != _folder(root, "frozen_ensemble"):
        print(f"  it was refused; the motions use {_folder(root, 'champion')}: see `make registry`")
    print(f"  figures             {root / 'results.json'}")
    where = f"DELTASAFE_HOME={shlex.quote(str(root))} " if is_own_data else ""
    print(f"  UI                  {where}make ui, then http://127.0.0.1:3000")


if __name__ == "__main__":
    sys.exit(main())
