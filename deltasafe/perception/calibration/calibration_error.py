"""Three scalar calibration errors: gaps between confidence and accuracy (Guo et al. 2017; Nixon et al. 2019).

- *expected* (ECE): mean over pixels of the absolute gap in the pixel's bin; ten equal bins on [0.5, 1]. If the network
  is confident at nearly all pixels, nearly all of them are in the last bin.
- *adaptive*: the same over 15 bins of equal mass, which resolve the confident pixels.
- *signed*: mean confidence minus accuracy. Positive: overconfident; negative: under-confident. Gaps of opposite sign
  cancel, therefore it is reported with the other two.
"""

import dataclasses

import numpy as np
from numpy.typing import NDArray

from deltasafe.perception.calibration.metrics import NLL_CLIP, require_labeled_prediction
from deltasafe.perception.calibration.reliability import BinCounts, bin_pixels

_ADAPTIVE_BINS = 15
_FINE_BINS = 4096
_MAX_LOGIT = float(np.log((1 - NLL_CLIP) / NLL_CLIP))


@dataclasses.dataclass(frozen=True)
class CalibrationErrors:
    """The three errors, and a bootstrap interval of the signed one.

    The absolute errors have no interval: they are biased upwards in every bootstrap sample, so that a percentile
    interval would lie above the estimate (decision 34).
    """

    expected: float
    adaptive: float
    signed: float
    signed_low: float
    signed_high: float


def margin_counts(p_occupied: NDArray[np.floating], label: NDArray[np.generic]) -> BinCounts:
    """Count correct predictions of one image in 4096 equal bins of |logit(p_occupied)|.

    Bins of equal mass are merged from these. |logit| is binned because it spreads the confidences just below 1. p is
    clipped at 1e-7 to choose the bin only. The predicted probability is the confidence max(p, 1 - p).

    Returns:
        counts with N = 1, B = 4096.
    """
    p, occupied = require_labeled_prediction(p_occupied, label)
    confidence = np.maximum(p, 1.0 - p)
    complement = np.maximum(1.0 - confidence, NLL_CLIP)
    margin = np.log1p(-complement) - np.log(complement)
    bins = np.minimum(margin * (_FINE_BINS / _MAX_LOGIT), _FINE_BINS - 1).astype(np.int64)
    return bin_pixels(bins, confidence, (p >= 0.5) == occupied, _FINE_BINS)


def equal_mass_bins(count: NDArray[np.integer], n_bins: int) -> NDArray[np.int64]:
    """Merge B fine bins into ``n_bins`` of nearly equal mass, each fine bin by the middle of its mass.

    Fine bins are not divided. One that holds more than 1 / ``n_bins`` of the mass leaves neighboring bins empty.

    Returns:
        (B,) index of the merged bin of each fine bin.
    """
    count = np.asarray(count, dtype=np.float64)
    middle = np.cumsum(count) - count / 2
    return np.minimum(middle * n_bins / count.sum(), n_bins - 1).astype(np.int64)


def calibration_errors(
    confidence: BinCounts, margins: BinCounts, weights: NDArray[np.int64], level: float = 0.95
) -> CalibrationErrors:
    """Compute the errors of one predictor over N images.

    Args:
        confidence: `confidence_counts` of the images.
        margins: `margin_counts` of the same images.
        weights: (R, N) multiplicities of R bootstrap samples of the images.
        level: coverage of the two-sided percentile interval of the signed error.
    """
    n_pixels = confidence.count.sum(axis=1)
    gap = (confidence.p_sum - confidence.event).sum(axis=1)
    fine = (margins.p_sum - margins.event).sum(axis=0)
    equal_mass = np.bincount(equal_mass_bins(margins.count.sum(axis=0), _ADAPTIVE_BINS), weights=fine)
    low, high = np.quantile((weights @ gap) / (weights @ n_pixels), [(1 - level) / 2, (1 + level) / 2])
    return CalibrationErrors(
        expected=float(np.abs((confidence.p_sum - confidence.event).sum(axis=0)).sum() / n_pixels.sum()),
        adaptive=float(np.abs(equal_mass).sum() / n_pixels.sum()),
        signed=float(gap.sum() / n_pixels.sum()),
        signed_low=float(low),
        signed_high=float(high),
    )
