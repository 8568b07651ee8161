"""Write the studies as a folder, `report.md` with tables and pictures, and list every figure by a short name."""

import dataclasses
import pathlib
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING

from deltasafe.io.storage import atomic_folder
from deltasafe.perception.calibration.ensemble_size import ensemble_size_table, ensemble_size_values
from deltasafe.reporting.templates import render
from deltasafe.studies.perception.settings import Cell, StudySettings
from deltasafe.studies.perception.tables import (
    SCHEME_TITLES,
    Reports,
    SchemeRow,
    ablation_rows,
    best_rows,
    missing_cells,
    ours_is_best,
    scheme_rows,
)

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from deltasafe.perception.data.augmented_set import AugmentedSet

SECTIONS = ("schemes", "ensemble_size", "ablation")

_PACKAGE = "deltasafe.studies.perception"
_SHORT = {"pixel_accuracy": "pa", "miou": "miou", "nll": "nll", "brier": "bs"}
_UNITS = {"pixel_accuracy": 1e2, "miou": 1e2, "nll": 1e2, "brier": 1e3}
"""Factors to the units of the paper's tables, in their order."""


def write_study(
    folder: str | pathlib.Path,
    settings: StudySettings,
    reports: Reports,
    sections: Sequence[str] = SECTIONS,
    sets: "Mapping[str, AugmentedSet] | None" = None,
) -> pathlib.Path:
    """Write the finished parts atomically, and name the missing cells.

    Args:
        folder: destination, replaced if it exists.
        settings: the cells.
        reports: of the finished cells, by name.
        sections: some of `SECTIONS`.
        sets: augmented sets of the largest size by scheme; some of their images are shown.

    Returns:
        path of `report.md`.
    """
    write: dict[str, Callable[[], _Section]] = {
        "schemes": lambda: _schemes(settings, reports, sets or {}),
        "ensemble_size": lambda: _ensemble_size(settings, reports),
        "ablation": lambda: _ablation(settings, reports),
    }
    made = [write[name]() for name in sections]
    with atomic_folder(folder) as temporary:
        for name, figure in (item for section in made for item in section.pictures.items()):
            figure.savefig(temporary / name, dpi=110, facecolor="white")
        text = render(_PACKAGE, "report.md.j2", sections=made).rstrip("\n") + "\n"
        (temporary / "report.md").write_text(text, encoding="utf-8")
    return pathlib.Path(folder) / "report.md"


def study_values(settings: StudySettings, reports: Reports) -> dict[str, float]:
    """List every figure by a short name: ``cutout_200_pa``, ``bs_m10``, ``without_flip_nll_loss``, ..."""
    values: dict[str, float] = {}
    rows = scheme_rows(settings, reports)
    for row in rows:
        name = f"{row.cell.scheme}_{row.cell.n_images}"
        values[f"{name}_m"] = row.cell.n_members
        for field, short in _SHORT.items():
            values[f"{name}_{short}"] = getattr(row.table_scores, field)
            if row.members.sd is not None and short in ("pa", "miou"):
                values[f"{name}_{short}_sd"] = getattr(row.members.sd, field)
            if short in ("nll", "bs"):
                values[f"{name}_{short}_low"] = getattr(row.low, field)
                values[f"{name}_{short}_high"] = getattr(row.high, field)
    for without in ablation_rows(settings, reports):
        name = f"without_{without.cell.left_out}"
        values[f"{name}_m"] = without.cell.n_members
        for field, short in _SHORT.items():
            if without.loss is not None:
                values[f"{name}_{short}_loss"] = getattr(without.loss, field)
                values[f"{name}_{short}_loss_low"] = getattr(without.loss_low, field)
                values[f"{name}_{short}_loss_high"] = getattr(without.loss_high, field)
    if (largest := reports.get(settings.largest.name)) is not None:
        values |= ensemble_size_values(largest)
    if (best := ours_is_best(rows, settings)) is not None:
        values["ours_best_in_all_cells"] = best
    return values


@dataclasses.dataclass(frozen=True)
class _Section:
    title: str
    missing: Sequence[str] = ()
    text: str = ""
    pictures: "Mapping[str, Figure]" = dataclasses.field(default_factory=dict)


def _schemes(settings: StudySettings, reports: Reports, sets: "Mapping[str, AugmentedSet]") -> _Section:
    from deltasafe.perception.data.contact_sheet import scheme_sheet
    from deltasafe.studies.perception.scheme_figures import scheme_figure

    rows = scheme_rows(settings, reports)
    pictures = {"schemes.png": scheme_figure(rows)} if rows else {}
    if sets:
        pictures["images.jpg"] = scheme_sheet({SCHEME_TITLES[name]: augmented for name, augmented in sets.items()})
    missing = missing_cells(settings.schemes(), reports)
    return _Section("Augmentation schemes (Tables I and II)", missing, _scheme_text(rows, settings), pictures)


def _ensemble_size(settings: StudySettings, reports: Reports) -> _Section:
    from deltasafe.perception.calibration.ensemble_size_figure import ensemble_reliability_figure, ensemble_size_figure

    title = f"Ensemble size (Table III and Fig. 4): our scheme, {settings.sizes[-1]} images"
    if (report := reports.get(settings.largest.name)) is None:
        return _Section(title, [settings.largest.name])
    pictures = {"table-3.png": ensemble_size_figure(report), "figure-4.png": ensemble_reliability_figure(report)}
    return _Section(title, (), ensemble_size_table(report), pictures)


def _ablation(settings: StudySettings, reports: Reports) -> _Section:
    from deltasafe.studies.perception.scheme_figures import ablation_figure

    rows = ablation_rows(settings, reports)
    pictures = {"ablation.png": ablation_figure(rows)} if any(row.loss is not None for row in rows) else {}
    text = render(_PACKAGE, "ablation.md.j2", rows=rows, units=_UNITS) if rows else ""
    whole = Cell("ours", settings.sizes[-1], settings.n_members)
    missing = missing_cells((whole, *settings.ablation()), reports)
    return _Section("Ablation: one method left out", missing, text.rstrip("\n"), pictures)


def _scheme_text(rows: Sequence[SchemeRow], settings: StudySettings) -> str:
    """Write Tables I and II in the paper's units with the paper's values, and the lead of our scheme."""
    if not rows:
        return ""
    return render(
        _PACKAGE,
        "schemes.md.j2",
        settings=settings,
        rows=rows,
        ours_is_best=ours_is_best(rows, settings),
        best={name: best_rows(rows, name) for name in _UNITS},
        titles=SCHEME_TITLES,
        units=_UNITS,
    ).rstrip("\n")
