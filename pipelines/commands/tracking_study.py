"""`make tracking-study`: run the tracking study as one Dagster run; finished batches are reused."""

import sys

from deltasafe.io.storage import read_json
from pipelines.command_line import run_command
from pipelines.commands.study_run import record_study, run_study, study_parser


def main() -> int:
    """Run the job; return 0 on success, 1 otherwise."""
    options = study_parser("tracking_study", __doc__).parse_args()
    folder = run_study("tracking_study", {"tracking_bound": {"workers": options.workers}}, "tracking_bound")
    if folder is None:
        return 1
    report = folder.with_name(f"{folder.name}-report")
    figures = read_json(report / "figures.json")
    for name, value in figures.items():
        print(f"  {name:42s} {value:.6g}")
    print(f"\n  report  {report / 'report.md'}")
    if options.record:
        settings = read_json(folder / "study.json")["settings"]
        seeds = {"runs_from": settings["first_seed"]}
        record_study(options.record, "tracking_study", report, seeds=seeds, settings=settings)
    return 0


if __name__ == "__main__":
    sys.exit(run_command(main))
