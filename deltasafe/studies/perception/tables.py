"""Tables I and II and the ablation, from the reports of finished cells; what is not finished is left open."""

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

__all__ = [
    "SCHEME_TITLES",
    "AblationRow",
    "Reports",
    "SchemeRow",
    "ablation_rows",
    "best_everywhere",
    "best_rows",
    "missing_cells",
    "scheme_rows",
]

SCHEME_TITLES = {
    "cutout": "Cutout",
    "mixup": "Mixup",
    "flip_rotate90": "Flip + 90° rotation",
    "flip_rotate_crop": "Flip + rotation + crop",
    "ours": "Our scheme",
}
"""As the paper's tables call them."""

Reports: TypeAlias = Mapping[str, CalibrationReport]
"""Of the finished cells, by their names."""

_FIELDS = tuple(field.name for field in dataclasses.fields(Scores))


@dataclasses.dataclass(frozen=True)
class SchemeRow:
    """A row of Tables I and II.

    Attributes:
        cell: scheme and size; ``n_members`` is the M of this row.
        members: mean and sd of M single members: PA and mIoU of the paper's Table I.
        ensemble: of the mean of the M members: BS and NLL of Table II.
        low, high: intervals of ``ensemble``, by bootstrap over images.
        lead_low, lead_high: of our scheme over this one, what is compared being PA and mIoU of members, BS and NLL
            of ensembles; positive is better for all four. Paired: both are judged on the same drawn images. None in
            the row of our scheme, and where ours is not finished.
        paper: the paper's row at this size; None at other sizes.
    """

    cell: Cell
    members: MeanAndSd
    ensemble: Scores
    low: Scores
    high: Scores
    lead_low: Scores | None
    lead_high: Scores | None
    paper: SchemeResult | None

    @property
    def compared(self) -> Scores:
        """What the paper's tables print: PA and mIoU of members, BS and NLL of the ensemble."""
        members, ensemble = self.members.mean, self.ensemble
        return Scores(members.pixel_accuracy, members.miou, ensemble.brier, ensemble.nll)


@dataclasses.dataclass(frozen=True)
class AblationRow:
    """What one method is worth.

    Attributes:
        cell: the method that was left out, and M.
        members: mean and sd of the M members without it.
        ensemble: of the mean of the M members without it.
        loss: how much worse it is without it, measured as in `SchemeRow.compared` on the same first M seeds; positive
            is worse without for all four. None where the whole scheme is not finished.
        loss_low, loss_high: interval of ``loss``, by paired bootstrap over images.
    """

    cell: Cell
    members: MeanAndSd
    ensemble: Scores
    loss: Scores | None
    loss_low: Scores | None
    loss_high: Scores | None


def scheme_rows(settings: StudySettings, reports: Reports) -> tuple[SchemeRow, ...]:
    """Finished rows of Tables I and II in the paper's order, all with the same M, ``settings.n_members``."""
    printed = {(row.scheme, row.n_images): row for row in AUGMENTATION_RESULTS}
    rows = []
    for cell in settings.schemes():
        if (report := reports.get(cell.name)) is None:
            continue
        m = settings.n_members
        ours = None if cell.scheme == "ours" else reports.get(Cell("ours", cell.n_images, m).name)
        lead = None if ours is None else _gain(ours, report, m)
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
    """Finished rows of the ablation, in the order of the methods."""
    whole, rows = reports.get(Cell("ours", settings.sizes[-1], settings.n_members).name), []
    for cell in settings.ablation():
        if (report := reports.get(cell.name)) is None:
            continue
        m = cell.n_members
        loss, low, high = None, None, None
        if whole is not None:
            point, drawn = _gain(whole, report, m)
            loss, (low, high) = Scores(*point.tolist()), percentile_interval(drawn, report.settings.level)
        members = mean_and_sd([member.scores for member in report.members[:m]])
        rows.append(AblationRow(cell, members, report.ensembles[m - 1].scores, loss, low, high))
    return tuple(rows)


def best_rows(rows: Sequence[SchemeRow], name: str) -> tuple[SchemeRow, ...]:
    """The best row of each size in the measure ``name``, as the tables print it."""
    sign = _SIGN[_FIELDS.index(name)]
    sizes = dict.fromkeys(row.cell.n_images for row in rows)
    return tuple(
        max((row for row in rows if row.cell.n_images == size), key=lambda row: sign * getattr(row.compared, name))
        for size in sizes
    )


def best_everywhere(rows: Sequence[SchemeRow], settings: StudySettings) -> bool | None:
    """Whether our scheme beats every other in all four measures at all sizes; None while a cell is missing."""
    if len(rows) < len(settings.schemes()):
        return None
    ours = {row.cell.n_images: row.compared for row in rows if row.cell.scheme == "ours"}
    others = [(ours[row.cell.n_images], row.compared) for row in rows if row.cell.scheme != "ours"]
    return all(bool((_signed(mine) > _signed(theirs)).all()) for mine, theirs in others)


def missing_cells(cells: Sequence[Cell], reports: Reports) -> tuple[str, ...]:
    """Names of those of ``cells`` that are not finished."""
    return tuple(cell.name for cell in cells if cell.name not in reports)


_SIGN = np.array([{"pixel_accuracy": 1.0, "miou": 1.0, "brier": -1.0, "nll": -1.0}[name] for name in _FIELDS])


def _signed(scores: Scores) -> NDArray[np.float64]:
    """As an array in which more is better."""
    return _SIGN * np.array(dataclasses.astuple(scores))


def _gain(
    better: CalibrationReport, other: CalibrationReport, m: int
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """(4,) by how much ``better`` is better with M members, and (R, 4) the same in each bootstrap sample."""
    settings, n_images = other.settings, len(other.image_ids)
    weights = bootstrap_weights(n_images, settings.n_bootstrap, settings.seed)
    point, drawn = (
        _compared(better, m, sample) - _compared(other, m, sample) for sample in (np.ones((1, n_images)), weights)
    )
    return _SIGN * point[0], _SIGN * drawn


def _compared(report: CalibrationReport, m: int, weights: NDArray[np.number]) -> NDArray[np.float64]:
    """(R, 4): PA and mIoU averaged over the first M members, BS and NLL of their ensemble."""
    members = np.mean([bootstrap_scores(member.images, weights) for member in report.members[:m]], axis=0)
    ensemble = bootstrap_scores(report.ensembles[m - 1].images, weights)
    of_members = [name in ("pixel_accuracy", "miou") for name in _FIELDS]
    return np.where(of_members, members, ensemble)
