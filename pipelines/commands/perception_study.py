"""`make study`: Tables I to III, Fig. 4 and the ablation; hours on two cores, in pieces as small as one likes.

Whatever is interrupted goes on where it was, whatever is finished is found, also by the assets in Dagster.
"""

import argparse
import os
import pathlib
import sys
import time
from typing import TYPE_CHECKING

from assets.interfaces import Store
from assets.perception_study import CellConfig, open_study
from deltasafe import presets
from pipelines.home import DATASETS, home

if TYPE_CHECKING:
    from deltasafe.perception.training.train_member import StepReport
    from deltasafe.studies.perception import Cell
    from deltasafe.studies.perception.study import Study
    from deltasafe.studies.perception.tables import Reports

__all__ = ["main"]

_FEW_STEPS = 20


def main() -> int:
    """Work on the cells that are asked for, then report on all that are finished; 0 if none is missing."""
    names = [cell.name for cell in presets.active().study.cells()]
    parser = argparse.ArgumentParser(prog="python -m pipelines.commands.perception_study", description=__doc__)
    parser.add_argument("--cells", nargs="*", default=names, metavar="CELL", help=f"of {', '.join(names)}")
    parser.add_argument("--home", type=pathlib.Path, help="where everything is kept ($DELTASAFE_HOME)")
    parser.add_argument("--record", type=pathlib.Path, help="also write the figures to this file (docs/results/...)")
    parser.add_argument("--workers", type=int, default=0, help="processes; 0 is one a core")
    options = parser.parse_args()
    if unknown := sorted(set(options.cells) - set(names)):
        parser.error(f"no such cells: {', '.join(unknown)}; there are {', '.join(names)}")
    root = (options.home or home()).expanduser().resolve()
    study = open_packaged(root, options.workers)
    print(f"Everything that is made goes to {study.store.home}", flush=True)
    chosen = [cell for cell in study.settings.cells() if cell.name in options.cells]
    watch = _Watch(study, chosen)
    for cell in chosen:
        watch.begin(cell)
        study.judge(cell, watch.step, watch.say)
        watch.end(cell)
        report(study, root, options.record)
    reports = report(study, root, options.record)
    print(f"\nReport: {root / 'study-report' / 'report.md'}")
    return int(len(reports) < len(names))


def open_packaged(root: pathlib.Path, workers: int = 0) -> "Study":
    """The study of the active preset on the packaged data, as the assets open it."""
    hands = DATASETS / "hands"
    return open_study(CellConfig(workers=workers), hands / "train", hands / "test", Store(root, DATASETS))


def report(study: "Study", root: pathlib.Path, record: pathlib.Path | None) -> "Reports":
    """Write what is finished below ``root``, and to ``record`` with its pictures beside it."""
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
    """Figures with what made them; those of others in the same file (benchmarks) stay as they are."""
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


class _Watch:
    """Tells in the terminal what is being done, and how long the rest will take at the speed so far."""

    def __init__(self, study: "Study", cells: "list[Cell]") -> None:
        self.left = {cell.name: study.steps_left(cell) for cell in cells}
        self.seen: dict[str, int] = {}
        self.n_done, self.began_s, self.spoke_s = 0, 0.0, 0.0
        self.cell = ""

    def begin(self, cell: "Cell") -> None:
        self.cell, self.seen = cell.name, {}
        print(f"{_now()}  {cell.name}: {cell.n_members} members, {self.left[cell.name]} steps to go", flush=True)

    def end(self, cell: "Cell") -> None:
        self.left[cell.name] = 0
        print(f"{_now()}  {cell.name}: done", flush=True)

    def step(self, name: str, step: "StepReport") -> None:
        if not self.n_done:
            self.began_s = time.monotonic()
        # a training that goes on from its checkpoint begins beyond its first step
        before = self.seen.get(name, step.step - 1)
        self.left[self.cell] -= step.step - self.seen.get(name, 0)
        self.seen[name] = step.step
        self.n_done += step.step - before
        text = f"{name} step {step.step} of {step.n_steps}, loss {step.loss:.3f}, {step.images_per_s:.1f} images/s"
        self._every(15.0, f"{text}; {self._remaining()}")

    def say(self, done: int, total: int, message: str) -> None:
        self._every(15.0, f"{message} ({done} of {total})")

    def _remaining(self) -> str:
        if self.n_done < _FEW_STEPS:
            return f"{sum(self.left.values())} steps in all cells"
        left_s = sum(self.left.values()) * (time.monotonic() - self.began_s) / self.n_done
        return f"all cells in about {left_s / 3600:.0f} h {left_s % 3600 / 60:.0f} min"

    def _every(self, interval_s: float, text: str) -> None:
        if time.monotonic() - self.spoke_s >= interval_s:
            self.spoke_s = time.monotonic()
            print(f"{_now()}  {self.cell}: {text}", flush=True)


def _now() -> str:
    return time.strftime("%H:%M:%S")


if __name__ == "__main__":
    sys.exit(main())
