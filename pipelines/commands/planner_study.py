"""`make planner-study`: run the planner study (Fig. 5 and Fig. 6) as one Dagster run; finished batches are reused."""

import os
import pathlib
import sys

from deltasafe.io.storage import read_json
from deltasafe.presets import VARIABLE
from pipelines.command_line import run_command, study_parser
from pipelines.commands.pictures import record_report
from pipelines.home import prepare_home

__all__ = ["main"]


def planner_study():  # type: ignore[no-untyped-def]
    """Return the job; the processes of its steps import it by this name."""
    from pipelines.definitions import defs

    return defs().resolve_job_def("planner_study")


def main() -> int:
    """Run the job; return 0 on success, 1 otherwise."""
    parser = study_parser("planner_study", __doc__)
    options = parser.parse_args()
    root = prepare_home()
    print(f"Results are written to {root}", flush=True)

    import dagster as dg

    from pipelines.commands.run_job import latest_folder, run_to_end

    steps = {name: {"workers": options.workers} for name in ("planner_costs", "planner_times")}
    if not run_to_end(dg.reconstructable(planner_study), steps, "`make planner-study`"):
        return 1
    folder = latest_folder(root, "planner_report")
    figures = read_json(folder / "figures.json")
    _print_summary(folder, figures)
    if options.record:
        _record(options.record, figures, folder)
    return 0


def _record(destination: pathlib.Path, figures: dict[str, float], folder: pathlib.Path) -> None:
    """Merge the figures into the record; copy the report beside it, with smaller images."""
    from pipelines.commands.records import merge_part

    costs, times = (read_json(folder / f"{name}_runs" / "study.json")["settings"] for name in ("fig5", "fig6"))
    preset = os.environ.get(VARIABLE) or "default"
    merge_part(
        destination,
        "planner_study",
        figures,
        command="make planner-study" + ("" if preset == "default" else f" PRESET={preset}"),
        seeds={
            "fig5_from": costs["first_seed"],
            "fig6_from": times["first_seed"],
            "fig6_scene": times["scene_seed"],
        },
    )
    record_report(folder, destination.parent / "planner")


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
