"""Rows of Tables I and II and of the ablation, from the reports of the finished cells."""

import dataclasses
from collections.abc import Mapping, Sequence
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from deltasafe.perception.calibration.metrics import (
    MeanAndSd,
    Scores,
    bootstrap_scores,
    mean_and_sd,
    percentile_interval,
)
from deltasafe.perception.calibration.paper_results import AUGMENTATION_RESULTS, SchemeResult
from deltasafe.perception.calibration.reliability import bootstrap_weights
from deltasafe.perception.calibration.report import CalibrationReport
from deltasafe.studies.perception.settings import Cell, StudySettings

SCHEME_TITLES = {
    "cutout": "Cutout",
    "mixup": "Mixup",
    "flip_rotate90": "Flip + 90° rotation",
    "flip_rotate_crop": "Flip + rotation + crop",
    "ours": "Our scheme",
}
"""Names in the paper's tables."""

Reports: TypeAlias = Mapping[str, CalibrationReport]
"""Calibration reports of the finished cells, by name."""

_FIELDS = tuple(field.name for field in dataclasses.fields(Scores))
_SIGN = np.array([1.0, 1.0, -1.0, -1.0])
"""Of PA, mIoU, BS and NLL: in a product with it, larger is better."""


@dataclasses.dataclass(frozen=True)
class _CellScores:
    cell: Cell
    members: MeanAndSd
    ensemble: Scores

    @property
    def table_scores(self) -> Scores:
        """The scores in the paper's tables: PA and mIoU averaged over members, BS and NLL of their mean."""
        members, ensemble = self.members.mean, self.ensemble
        return Scores(members.pixel_accuracy, members.miou, ensemble.brier, ensemble.nll)


@dataclasses.dataclass(frozen=True)
class SchemeRow(_CellScores):
    """A row of Tables I and II.

    Attributes:
        cell: scheme and size; ``n_members`` is the M of this row.
        members: mean and sd of the scores of M members (PA and mIoU of Table I).
        ensemble: scores of the mean of the M members (BS and NLL of Table II).
        low, high: intervals of ``ensemble``, by bootstrap over images.
        lead_low, lead_high: interval of the lead of our scheme in ``table_scores``, by paired bootstrap over images;
            positive: our scheme is better. None in the row of our scheme, and if ours is not finished.
        paper: the paper's row; None at sizes that the paper does not have.
    """

    low: Scores
    high: Scores
    lead_low: Scores | None
    lead_high: Scores | None
    paper: SchemeResult | None


@dataclasses.dataclass(frozen=True)
class AblationRow(_CellScores):
    """The effect of leaving out one method.

    Attributes:
        cell: the method that was left out, and M.
        members: mean and sd of the scores of the M members without it.
        ensemble: scores of the mean of the M members without it.
        loss: lead of the whole scheme with the same M seeds, in ``table_scores``; positive: worse without the method.
            None if the whole scheme is not finished.
        loss_low, loss_high: interval of ``loss``, by paired bootstrap over images.
    """

    loss: Scores | None
    loss_low: Scores | None
    loss_high: Scores | None


def scheme_rows(settings: StudySettings, reports: Reports) -> tuple[SchemeRow, ...]:
    """Compute the finished rows of Tables I and II in the paper's order, all with M = ``settings.n_members``."""
    printed = {(row.scheme, row.n_images): row for row in AUGMENTATION_RESULTS}
    rows = []
    for cell in settings.schemes():
        if (report := reports.get(cell.name)) is None:
            continue
        m = settings.n_members
        ours = None if cell.scheme == "ours" else reports.get(Cell("ours", cell.n_images, m).name)
        lead = None if ours is None else _lead(ours, report, m)
        ensemble = report.ensembles[m - 1]
        low, high = (None, None) if lead is None else percentile_interval(lead[1], report.settings.level)
        rows.append(
            SchemeRow(
                cell=dataclasses.replace(cell, n_members=m),
                members=mean_and_sd([member.scores for member in report.members[:m]]),
                ensemble=ensemble.scores,
                low=ensemble.low,
                high=ensemble.high,
                lead_low=low,
                lead_high=high,
                paper=printed.get((cell.scheme, cell.n_images)),
            )
        )
    return tuple(rows)


def ablation_rows(settings: StudySettings, reports: Reports) -> tuple[AblationRow, ...]:
    """Compute the finished rows of the ablation, in the order of the methods."""
    whole, rows = reports.get(Cell("ours", settings.sizes[-1], settings.n_members).name), []
    for cell in settings.ablation():
        if (report := reports.get(cell.name)) is None:
            continue
        m = cell.n_members
        loss, low, high = None, None, None
        if whole is not None:
            lead, samples = _lead(whole, report, m)
            loss, (low, high) = Scores(*lead.tolist()), percentile_interval(samples, report.settings.level)
        members = mean_and_sd([member.scores for member in report.members[:m]])
        rows.append(AblationRow(cell, members, report.ensembles[m - 1].scores, loss, low, high))
    return tuple(rows)


def best_rows(rows: Sequence[SchemeRow], name: str) -> tuple[SchemeRow, ...]:
    """Return the best row of each size in the measure ``name`` of `SchemeRow.table_scores`."""
    sign = _SIGN[_FIELDS.index(name)]
    sizes = dict.fromkeys(row.cell.n_images for row in rows)
    return tuple(
        max((row for row in rows if row.cell.n_images == size), key=lambda row: sign * getattr(row.table_scores, name))
        for size in sizes
    )


def ours_is_best(rows: Sequence[SchemeRow], settings: StudySettings) -> bool | None:
    """Test whether our scheme beats every other in all four measures at all sizes; None if a cell is missing."""
    if len(rows) < len(settings.schemes()):
        return None
    scores = {row.cell: _SIGN * np.array(dataclasses.astuple(row.table_scores)) for row in rows}
    ours = {cell.n_images: values for cell, values in scores.items() if cell.scheme == "ours"}
    return all((ours[cell.n_images] > other).all() for cell, other in scores.items() if cell.scheme != "ours")


def missing_cells(cells: Sequence[Cell], reports: Reports) -> tuple[str, ...]:
    """Return the names of the cells that are not finished."""
    return tuple(cell.name for cell in cells if cell.name not in reports)


def _lead(
    report: CalibrationReport, other: CalibrationReport, m: int
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Compute (4,) the lead of ``report`` over ``other`` with M members, and (R, 4) its paired bootstrap samples."""
    settings, n_images = other.settings, len(other.image_ids)
    weights = bootstrap_weights(n_images, settings.n_bootstrap, settings.seed)
    lead, samples = (
        _table_scores(report, m, sample) - _table_scores(other, m, sample)
        for sample in (np.ones((1, n_images)), weights)
    )
    return _SIGN * lead[0], _SIGN * samples


def _table_scores(report: CalibrationReport, m: int, weights: NDArray[np.number]) -> NDArray[np.float64]:
    """Compute (R, 4) `SchemeRow.table_scores` of the first M members in R bootstrap samples."""
    members = np.mean([bootstrap_scores(member.images, weights) for member in report.members[:m]], axis=0)
    ensemble = bootstrap_scores(report.ensembles[m - 1].images, weights)
    return np.hstack([members[:, :2], ensemble[:, 2:]])
