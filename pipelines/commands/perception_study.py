"""`make study`: Tables I to III, Fig. 4 and the ablation. Takes hours on two cores.

An interrupted run is resumed, and finished work is reused, by this command and by the assets in Dagster.
"""

import argparse
import os
import pathlib
import sys
import time
from typing import TYPE_CHECKING

from deltasafe import presets
from pipelines.command_line import run_command
from pipelines.home import DATASETS, home

if TYPE_CHECKING:
    from deltasafe.perception.training.train_member import StepReport
    from deltasafe.studies.perception import Cell
    from deltasafe.studies.perception.study import Study
    from deltasafe.studies.perception.tables import Reports

_PRINT_EVERY_S = 15.0
_MIN_STEPS_FOR_ESTIMATE = 20


def main() -> int:
    """Evaluate the selected cells and report on all finished cells; exit status 0 if no cell is missing."""
    names = [cell.name for cell in presets.active().study.cells()]
    parser = argparse.ArgumentParser(prog="python -m pipelines.commands.perception_study", description=__doc__)
    parser.add_argument("--cells", nargs="*", default=names, metavar="CELL", help=f"of {', '.join(names)}")
    parser.add_argument("--home", type=pathlib.Path, help="folder of all results ($DELTASAFE_HOME)")
    parser.add_argument("--record", type=pathlib.Path, help="also write the figures to this file (docs/results/...)")
    parser.add_argument("--workers", type=int, default=0, help="processes; 0: one per core")
    options = parser.parse_args()
    if unknown := sorted(set(options.cells) - set(names)):
        parser.error(f"no such cells: {', '.join(unknown)}; there are {', '.join(names)}")
    root = (options.home or home()).expanduser().resolve()
    study = open_packaged(root, options.workers)
    print(f"Results are written to {study.home}", flush=True)
    chosen = [cell for cell in study.settings.cells() if cell.name in options.cells]
    progress = _ProgressPrinter(study, chosen)
    for cell in chosen:
        progress.begin(cell)
        study.evaluate(cell, progress.on_step, progress.on_progress)
        progress.end(cell)
        report(study, root, options.record)
    reports = report(study, root, options.record)
    print(f"\nReport: {root / 'study-report' / 'report.md'}")
    return int(len(reports) < len(names))


def open_packaged(root: pathlib.Path, workers: int = 0) -> "Study":
    """Open the study of the active preset on the packaged data, as the assets do."""
    from assets.interfaces import Store
    from assets.perception_study import CellConfig, open_study  # reads the preset, which may be mistyped

    hands = DATASETS / "hands"
    return open_study(CellConfig(workers=workers), hands / "train", hands / "test", Store(root, DATASETS))


def report(study: "Study", root: pathlib.Path, record: pathlib.Path | None) -> "Reports":
    """Write the finished parts below ``root``, and to ``record`` with the pictures beside it."""
    from deltasafe.studies.perception.report import write_study

    reports = study.finished()
    write_study(root / "study-report", study.settings, reports)
    for destination in (root / "study-report.json", record):
        if destination is not None:
            write_record(destination, study, reports)
    if record is not None:
        shown = [cell for cell in study.settings.schemes() if cell.n_images == study.settings.sizes[-1]]
        sets = {cell.scheme: found for cell in shown if (found := study.find_set(cell)) is not None}
        write_study(record.with_suffix(""), study.settings, reports, sets=sets)
    return reports


def write_record(path: pathlib.Path, study: "Study", reports: "Reports") -> None:
    """Write the figures with their command and seeds; figures of other commands in the same file are kept."""
    from deltasafe.studies.perception.report import study_values
    from deltasafe.studies.perception.tables import missing_cells
    from pipelines.commands.records import merge_part

    values = study_values(study.settings, reports)
    preset = os.environ.get(presets.VARIABLE) or "default"
    merge_part(
        path,
        "study",
        {name: value if isinstance(value, bool) else round(value, 6) for name, value in values.items()},
        command="make study" + ("" if preset == "default" else f" PRESET={preset}"),
        seeds={"augmentation": study.augmentation.seed, "members_from": study.settings.first_seed},
        missing=missing_cells(study.settings.cells(), reports),
    )


class _ProgressPrinter:
    """Prints the current step, and the remaining time estimated from the speed so far."""

    def __init__(self, study: "Study", cells: "list[Cell]") -> None:
        self.steps_left = {cell.name: study.steps_left(cell) for cell in cells}
        self.last_step: dict[str, int] = {}
        self.n_done, self.first_step_s, self.printed_s = 0, 0.0, 0.0
        self.cell = ""

    def begin(self, cell: "Cell") -> None:
        self.cell, self.last_step = cell.name, {}
        self._print(f"{cell.n_members} members, {self.steps_left[cell.name]} steps left")

    def end(self, cell: "Cell") -> None:
        self.steps_left[cell.name] = 0
        self._print("finished")

    def on_step(self, name: str, step: "StepReport") -> None:
        if not self.n_done:
            self.first_step_s = time.monotonic()
        # the first report of a resumed training has a step above 1
        self.n_done += step.step - self.last_step.get(name, step.step - 1)
        self.steps_left[self.cell] -= step.step - self.last_step.get(name, 0)
        self.last_step[name] = step.step
        text = f"{name} step {step.step} of {step.n_steps}, loss {step.loss:.3f}, {step.images_per_s:.1f} images/s"
        self._print_rarely(f"{text}; {self._remaining()}")

    def on_progress(self, done: int, total: int, message: str) -> None:
        self._print_rarely(f"{message} ({done} of {total})")

    def _remaining(self) -> str:
        n_left = sum(self.steps_left.values())
        if self.n_done < _MIN_STEPS_FOR_ESTIMATE:
            return f"{n_left} steps left in all cells"
        left_s = n_left * (time.monotonic() - self.first_step_s) / self.n_done
        hours, minutes = divmod(round(left_s / 60), 60)
        return f"about {hours} h {minutes} min left for all cells"

    def _print_rarely(self, text: str) -> None:
        if time.monotonic() - self.printed_s >= _PRINT_EVERY_S:
            self.printed_s = time.monotonic()
            self._print(text)

    def _print(self, text: str) -> None:
        print(f"{time.strftime('%H:%M:%S')}  {self.cell}: {text}", flush=True)


if __name__ == "__main__":
    sys.exit(run_command(main))
