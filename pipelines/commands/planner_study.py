"""`make planner-study`: run the planner study (Fig. 5 and Fig. 6) as one Dagster run; finished batches are reused."""

import pathlib
import sys

from deltasafe.io.storage import read_json
from pipelines.command_line import run_command
from pipelines.commands.study_run import record_study, run_study, study_parser


def main() -> int:
    """Run the job; return 0 on success, 1 otherwise."""
    options = study_parser("planner_study", __doc__).parse_args()
    steps = {name: {"workers": options.workers} for name in ("planner_costs", "planner_times")}
    folder = run_study("planner_study", steps, "planner_report")
    if folder is None:
        return 1
    figures = read_json(folder / "figures.json")
    _print_summary(folder, figures)
    if options.record:
        costs, times = (read_json(folder / f"{name}_runs" / "study.json")["settings"] for name in ("fig5", "fig6"))
        first = {"fig5_from": costs["first_seed"], "fig6_from": times["first_seed"], "fig6_scene": times["scene_seed"]}
        record_study(options.record, "planner_study", folder, seeds=first, pictures="planner")
    return 0


def _print_summary(folder: pathlib.Path, figures: dict[str, float]) -> None:
    effects = {name.removeprefix("holds_"): bool(value) for name, value in figures.items() if name.startswith("holds_")}
    print(f"\nFig. 5: {figures['plans']:.0f} plans in {figures['fig5_minutes']:.1f} minutes ", end="")
    print(f"({figures['fig5_cpu_minutes']:.1f} CPU minutes); Fig. 6: {figures['fig6_minutes']:.1f} minutes ", end="")
    print(f"({figures['fig6_cpu_minutes']:.1f} CPU minutes)\n")
    for name, holds in effects.items():
        print(f"  {'holds         ' if holds else 'does not hold '} {name.replace('_', ' ')}")
    print(f"\n  report  {folder / 'report.md'}")


if __name__ == "__main__":
    sys.exit(run_command(main))
