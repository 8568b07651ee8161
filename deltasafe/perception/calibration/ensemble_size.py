"""Scores over ensemble size: Table III of the paper, from a calibration report and with the paper's figures.

An ensemble of size M is the mean of the first M members (T = 1). The stored predictions of ten members therefore
contain all ten sizes.
"""

import dataclasses

import numpy as np

from deltasafe.perception.calibration.metrics import Scores, bootstrap_scores, percentile_interval
from deltasafe.perception.calibration.paper_results import ENSEMBLE_SIZE_RESULTS
from deltasafe.perception.calibration.reliability import bootstrap_weights
from deltasafe.perception.calibration.report import CalibrationReport
from deltasafe.reporting.templates import render


@dataclasses.dataclass(frozen=True)
class EnsembleSize:
    """Scores of the mean of the first M members (a column of Table III).

    Attributes:
        n_members: M.
        scores: PA, mIoU, BS and NLL over all images.
        low, high: their intervals, by bootstrap over images.
        change_low, change_high: interval of the change against M = 1 by paired bootstrap, that is, both sizes on the
            same samples of images. Scores vary more between images than between sizes. Whether members help is
            therefore decided by this interval, not by the overlap of ``low`` and ``high``.
        paper_brier, paper_nll: Table III of the paper; None beyond M = 10.
    """

    n_members: int
    scores: Scores
    low: Scores
    high: Scores
    change_low: Scores
    change_high: Scores
    paper_brier: float | None
    paper_nll: float | None


def ensemble_size_rows(report: CalibrationReport) -> tuple[EnsembleSize, ...]:
    """Compute one row for each M = 1, 2, .., with the bootstrap samples of the report."""
    settings = report.settings
    weights = bootstrap_weights(len(report.image_ids), settings.n_bootstrap, settings.seed)
    samples = np.array([bootstrap_scores(ensemble.images, weights) for ensemble in report.ensembles])
    rows = []
    for m, (ensemble, change) in enumerate(zip(report.ensembles, samples - samples[0], strict=True), 1):
        change_interval = percentile_interval(change, settings.level)
        paper = ENSEMBLE_SIZE_RESULTS.get(m, (None, None))
        rows.append(EnsembleSize(m, ensemble.scores, ensemble.low, ensemble.high, *change_interval, *paper))
    return tuple(rows)


def ensemble_size_values(report: CalibrationReport) -> dict[str, float]:
    """List PA, mIoU, BS and NLL of every M by short name: ``bs_m5``, ``bs_m5_low``, ``bs_m5_high``, ...

    As in the paper, without a temperature. For the largest M also as the ensemble is used: ``bs_m10_as_used``.
    """
    names = {"pa": "pixel_accuracy", "miou": "miou", "bs": "brier", "nll": "nll"}
    used, last = report.figures(), f"m{report.n_members}_as_used"
    values = {f"{name}_{last}": used[name] for name in ("bs", "nll", "ece", "temperature")}
    return values | {
        f"{short}_m{row.n_members}{suffix}": getattr(scores, name)
        for row in ensemble_size_rows(report)
        for short, name in names.items()
        for suffix, scores in (("", row.scores), ("_low", row.low), ("_high", row.high))
    }


def ensemble_size_table(report: CalibrationReport) -> str:
    """Write Table III as Markdown in the paper's units (BS x 10^3, NLL x 10^2), with intervals and its values."""
    return render(
        "deltasafe.perception.calibration",
        "ensemble_size.md.j2",
        report=report,
        used=report.figures(),
        rows=ensemble_size_rows(report),
    )
