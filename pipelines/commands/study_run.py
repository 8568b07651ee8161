"""What the commands of the studies share: options, the Dagster run, and the record of the figures."""

import argparse
import os
import pathlib
from collections.abc import Mapping, Sequence
from typing import Any

from deltasafe.io.storage import read_json
from deltasafe.presets import VARIABLE
from pipelines.commands.pictures import record_report
from pipelines.commands.records import merge_part
from pipelines.home import prepare_home


def study_parser(study: str, description: str | None) -> argparse.ArgumentParser:
    """Create the parser of ``python -m pipelines.commands.STUDY`` with the options that all studies have."""
    parser = argparse.ArgumentParser(prog=f"python -m pipelines.commands.{study}", description=description)
    parser.add_argument("--record", type=pathlib.Path, help="merge the figures into this file (docs/results/...)")
    parser.add_argument(
        "--workers", type=int, default=os.cpu_count() or 1, help="number of processes (default: one per core)"
    )
    return parser


def run_study(study: str, steps: Mapping[str, Mapping[str, Any]], asset: str) -> pathlib.Path | None:
    """Run the job of a study with the configuration of its steps; return the folder of ``asset``, None on failure."""
    root = prepare_home()
    print(f"Results are written to {root}", flush=True)
    from pipelines.commands.run_job import latest_folder, run_to_end

    return latest_folder(root, asset) if run_to_end(study, steps, f"`make {study.replace('_', '-')}`") else None


def record_study(
    record: pathlib.Path,
    study: str,
    report: pathlib.Path,
    *,
    seeds: Mapping[str, int],
    options: Sequence[str] = (),
    pictures: str = "",
    **about: Any,
) -> None:
    """Merge the figures of a report into the record; copy the report beside it, with smaller images.

    Args:
        options: of the command line.
        pictures: folder of the copied report; the name of the study by default.
        about: other facts that are stored with the figures.
    """
    preset = os.environ.get(VARIABLE) or "default"
    given = [] if preset == "default" else [f"{VARIABLE}={preset}"]
    command = " ".join([*given, "python -m", f"pipelines.commands.{study}", *options])
    merge_part(record, study, read_json(report / "figures.json"), command=command, seeds=seeds, **about)
    record_report(report, record.parent / (pictures or study))
