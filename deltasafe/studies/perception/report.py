"""The studies as a folder: `report.md` with tables and pictures, and every figure by a short name."""

import dataclasses
import pathlib
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING

from deltasafe.io.storage import atomic_folder
from deltasafe.perception.calibration.ensemble_size import ensemble_size_table, ensemble_size_values
from deltasafe.perception.calibration.metrics import Scores
from deltasafe.reporting.markdown import table
from deltasafe.studies.perception.settings import Cell, StudySettings
from deltasafe.studies.perception.tables import (
    SCHEME_TITLES,
    AblationRow,
    Reports,
    SchemeRow,
    ablation_rows,
    best_everywhere,
    best_rows,
    missing_cells,
    scheme_rows,
)

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from deltasafe.perception.data.augmented_set import AugmentedSet

__all__ = ["SECTIONS", "ablation_markdown", "scheme_markdown", "study_values", "write_study"]

SECTIONS = ("schemes", "ensemble_size", "ablation")

_SHORT = {"pixel_accuracy": "pa", "miou": "miou", "nll": "nll", "brier": "bs"}


def write_study(
    folder: str | pathlib.Path,
    settings: StudySettings,
    reports: Reports,
    sections: Sequence[str] = SECTIONS,
    sets: "Mapping[str, AugmentedSet] | None" = None,
) -> pathlib.Path:
    """Write what is finished; what is not is named as missing. The folder appears as a whole or not at all.

    Args:
        folder: destination, replaced if it exists.
        reports: of the finished cells, by name.
        sections: some of `SECTIONS`.
        sets: augmented sets of the largest size by scheme, to show some of their images.

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
        text = "\n\n".join(part for section in made for part in section.parts)
        (temporary / "report.md").write_text(text + "\n", encoding="utf-8")
    return pathlib.Path(folder) / "report.md"


@dataclasses.dataclass(frozen=True)
class _Section:
    parts: Sequence[str]
    pictures: "Mapping[str, Figure]"


def _section(title: str, missing: Sequence[str], text: str, pictures: "Mapping[str, Figure]") -> _Section:
    parts = [f"## {title}"]
    if missing:
        parts.append(f"Not finished yet: {', '.join(missing)}.")
    if text:
        parts.append(text)
    return _Section([*parts, *(f"![{name.removesuffix('.png')}]({name})" for name in pictures)], pictures)


def _schemes(settings: StudySettings, reports: Reports, sets: "Mapping[str, AugmentedSet]") -> _Section:
    from deltasafe.perception.data.contact_sheet import scheme_sheet
    from deltasafe.studies.perception.scheme_figures import scheme_figure, scheme_tables_figure

    rows = scheme_rows(settings, reports)
    pictures = {"tables-1-2.png": scheme_tables_figure(rows), "schemes.png": scheme_figure(rows)} if rows else {}
    if sets:
        pictures["images.jpg"] = scheme_sheet({SCHEME_TITLES[name]: made for name, made in sets.items()})
    text = scheme_markdown(rows, settings) if rows else ""
    missing = missing_cells(settings.schemes(), reports)
    return _section("Augmentation schemes (Tables I and II)", missing, text, pictures)


def _ensemble_size(settings: StudySettings, reports: Reports) -> _Section:
    from deltasafe.perception.calibration.ensemble_size_figure import ensemble_reliability_figure, ensemble_size_figure

    title = f"Ensemble size (Table III and Fig. 4): our scheme, {settings.sizes[-1]} images"
    if (report := reports.get(settings.largest.name)) is None:
        return _section(title, [settings.largest.name], "", {})
    pictures = {"table-3.png": ensemble_size_figure(report), "figure-4.png": ensemble_reliability_figure(report)}
    return _section(title, (), ensemble_size_table(report), pictures)


def _ablation(settings: StudySettings, reports: Reports) -> _Section:
    from deltasafe.studies.perception.scheme_figures import ablation_figure

    rows = ablation_rows(settings, reports)
    pictures = {"ablation.png": ablation_figure(rows)} if any(row.loss is not None for row in rows) else {}
    text = ablation_markdown(rows) if rows else ""
    whole = Cell("ours", settings.sizes[-1], settings.n_members)
    missing = missing_cells((whole, *settings.ablation()), reports)
    return _section("Ablation: one method left out", missing, text, pictures)


def scheme_markdown(rows: Sequence[SchemeRow], settings: StudySettings) -> str:
    """Tables I and II in the paper's units, beside the paper's figures, and how far our scheme leads."""
    best = best_everywhere(rows, settings)
    verdict = {
        None: "",
        True: "Our scheme beats every other in all four measures at every size.",
        False: "Our scheme does **not** beat every other in all four measures at every size.",
    }[best]
    notes = (
        "Every cell is trained with the same number of gradient steps, every row has the M that stands in it. PA and "
        "mIoU: mean ± one standard deviation over the M members. NLL and BS: of the mean of the members. In brackets "
        "the interval by bootstrap over test images. The headings of the paper's Table II are swapped, here they are "
        'corrected; its row "1000 images, our scheme" is an ensemble of M = 10, the M of its others is not given.'
    )
    if settings.lighter:
        notes += (
            " The recipe of all these cells is a lighter one, the same for all: "
            + " and ".join(
                text
                for value, text in (
                    (settings.comparison_width, f"images {settings.comparison_width} pixels wide"),
                    (settings.comparison_epochs, f"{settings.comparison_epochs} epochs over the largest set"),
                )
                if value
            )
            + ", all else as in the preset; the figures are worse than Table III's for that reason."
        )
    lead_note = (
        "Lead of our scheme, interval by bootstrap over images (paired: both schemes on the same drawn images); "
        "above zero it is better."
    )
    first = table(
        ("Images", "Scheme", "M", "PA [%]", "Paper", "mIoU [%]", "Paper"),
        [(*_head(row), *_members(row, rows, "pixel_accuracy"), *_members(row, rows, "miou")) for row in rows],
    )
    second = table(
        ("Images", "Scheme", "M", "NLL x 10²", "Paper", "BS x 10³", "Paper"),
        [(*_head(row), *_mean(row, rows, "nll", 1e2), *_mean(row, rows, "brier", 1e3)) for row in rows],
    )
    led = [row for row in rows if row.lead_low is not None and row.lead_high is not None]
    third = table(
        ("Images", "Over", "PA [%]", "mIoU [%]", "NLL x 10²", "BS x 10³"),
        [(f"{row.cell.n_images}", SCHEME_TITLES[row.cell.scheme], *_spans(row.lead_low, row.lead_high)) for row in led],
    )
    return "\n\n".join(part for part in (verdict, first, second, *((lead_note, third) if led else ()), notes) if part)


def ablation_markdown(rows: Sequence[AblationRow]) -> str:
    """What is lost without a method, with intervals."""
    note = (
        "Loss without the method, interval by paired bootstrap over images: what is above zero, the method is worth. "
        "The interval says what other images would change, not what other seeds would, and M is small. PA and mIoU "
        "are means over members, NLL and BS those of their ensemble, against the same seeds of the whole scheme."
    )
    head = ("Without", "M", "PA [%]", "loss", "mIoU [%]", "loss", "NLL x 10²", "loss", "BS x 10³", "loss")
    lines = []
    for row in rows:
        mean, ensemble = row.members.mean, row.ensemble
        values = (1e2 * mean.pixel_accuracy, 1e2 * mean.miou, 1e2 * ensemble.nll, 1e3 * ensemble.brier)
        losses = _spans(row.loss_low, row.loss_high)
        pairs = (text for value, loss in zip(values, losses, strict=True) for text in (f"{value:.2f}", loss))
        lines.append((row.cell.left_out.replace("_", " "), f"{row.cell.n_members}", *pairs))
    return f"{note}\n\n{table(head, lines)}"


def study_values(settings: StudySettings, reports: Reports) -> dict[str, float]:
    """Every figure of the tables by a short name: ``cutout_200_pa``, ``bs_m10``, ``without_flip_nll_loss``, ..."""
    values: dict[str, float] = {}
    rows = scheme_rows(settings, reports)
    for row in rows:
        name = f"{row.cell.scheme}_{row.cell.n_images}"
        values[f"{name}_m"] = row.cell.n_members
        for field, short in _SHORT.items():
            values[f"{name}_{short}"] = getattr(row.compared, field)
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
    if (best := best_everywhere(rows, settings)) is not None:
        values["ours_best_in_all_cells"] = best
    return values


def _head(row: SchemeRow) -> tuple[str, str, str]:
    return f"{row.cell.n_images}", SCHEME_TITLES[row.cell.scheme], f"{row.cell.n_members}"


def _members(row: SchemeRow, rows: Sequence[SchemeRow], name: str) -> tuple[str, str]:
    """Mean and sd over members in percent, the best of its size in bold, and the paper's."""
    sd = "" if row.members.sd is None else f" ± {1e2 * getattr(row.members.sd, name):.1f}"
    ours = _bold(f"{1e2 * getattr(row.compared, name):.1f}{sd}", row in best_rows(rows, name))
    if row.paper is None:
        return ours, ""
    return ours, f"{1e2 * getattr(row.paper, name):.1f} ± {1e2 * getattr(row.paper, f'{name}_sd'):.1f}"


def _mean(row: SchemeRow, rows: Sequence[SchemeRow], name: str, unit: float) -> tuple[str, str]:
    """Score of the ensemble with its interval, the best of its size in bold, and the paper's."""
    value, low, high = (unit * getattr(scores, name) for scores in (row.compared, row.low, row.high))
    ours = f"{_bold(f'{value:.2f}', row in best_rows(rows, name))} ({low:.2f} to {high:.2f})"
    return ours, "" if row.paper is None else f"{unit * getattr(row.paper, name):.1f}"


def _bold(text: str, bold: bool) -> str:
    return f"**{text}**" if bold else text


def _spans(low: Scores | None, high: Scores | None) -> tuple[str, ...]:
    """An interval for each measure, in the paper's units and order."""
    if low is None or high is None:
        return ("",) * 4
    return tuple(
        f"{unit * getattr(low, name):+.2f} to {unit * getattr(high, name):+.2f}"
        for name, unit in (("pixel_accuracy", 1e2), ("miou", 1e2), ("nll", 1e2), ("brier", 1e3))
    )
