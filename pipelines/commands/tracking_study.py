"""`make tracking-study`: run the tracking study as one Dagster run; finished batches are reused."""

import os
import pathlib
import sys

from deltasafe.io.storage import read_json
from deltasafe.presets import VARIABLE
from pipelines.command_line import run_command, study_parser
from pipelines.commands.pictures import record_report
from pipelines.commands.records import merge_part
from pipelines.home import prepare_home

__all__ = ["main"]


def tracking_study():  # type: ignore[no-untyped-def]
    """Return the job; the processes of its steps import it by this name."""
    from pipelines.definitions import defs

    return defs().resolve_job_def("tracking_study")


def main() -> int:
    """Run the job; return 0 on success, 1 otherwise."""
    parser = study_parser("tracking_study", __doc__)
    options = parser.parse_args()
    root = prepare_home()
    print(f"Results are written to {root}", flush=True)

    import dagster as dg

    from pipelines.commands.run_job import latest_folder, run_to_end

    steps = {"tracking_bound": {"workers": options.workers}}
    if not run_to_end(dg.reconstructable(tracking_study), steps, "`make tracking-study`"):
        return 1
    folder = latest_folder(root, "tracking_bound")
    report = folder.with_name(f"{folder.name}-report")
    figures = read_json(report / "figures.json")
    for name, value in figures.items():
        print(f"  {name:42s} {value:.6g}")
    print(f"\n  report  {report / 'report.md'}")
    if options.record:
        _record(options.record, figures, folder, report)
    return 0


def _record(destination: pathlib.Path, figures: dict[str, float], folder: pathlib.Path, report: pathlib.Path) -> None:
    """Merge the figures into the record; copy the report beside it, with smaller images."""
    preset = os.environ.get(VARIABLE) or "default"
    command = "python -m pipelines.commands.tracking_study"
    settings = read_json(folder / "study.json")["settings"]
    merge_part(
        destination,
        "tracking_study",
        figures,
        command=command if preset == "default" else f"{VARIABLE}={preset} {command}",
        seeds={"runs_from": settings["first_seed"]},
        settings=settings,
    )
    record_report(report, destination.parent / "tracking_study")


if __name__ == "__main__":
    sys.exit(run_command(main))
