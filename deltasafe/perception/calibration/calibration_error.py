"""How far are confidence and accuracy apart, in one number? Three answers (Guo et al. 2017; Nixon et al. 2019).

- *expected* (ECE): mean over pixels of the gap between confidence and accuracy in the pixel's bin, ten equal bins on
  [0.5, 1]. Where nearly all pixels are sure, nearly all of them share the last bin.
- *adaptive*: the same over 15 bins that hold equally many pixels each, so that the sure pixels are told apart.
- *signed*: mean confidence minus accuracy. Above 0 the network is overconfident, below 0 under-confident; gaps of
  opposite signs cancel, which is why it stands beside the other two.
"""

import dataclasses

import numpy as np
from numpy.typing import NDArray

from deltasafe.perception.calibration.metrics import NLL_CLIP, require_label, require_p_occupied
from deltasafe.perception.calibration.reliability import BinCounts

__all__ = ["ADAPTIVE_BINS", "CalibrationErrors", "calibration_errors", "equal_mass_bins", "margin_counts"]

ADAPTIVE_BINS = 15
_FINE_BINS = 4096
_LIMIT = float(np.log((1 - NLL_CLIP) / NLL_CLIP))


@dataclasses.dataclass(frozen=True)
class CalibrationErrors:
    """The three numbers, and the interval of the one that a bootstrap can bound.

    An absolute gap is above zero in every bootstrap sample, however well calibrated the network is, so that a
    percentile interval of the first two would lie above them.
    """

    expected: float
    adaptive: float
    signed: float
    signed_low: float
    signed_high: float


def margin_counts(p_occupied: NDArray[np.floating], label: NDArray[np.generic]) -> BinCounts:
    """One image's pixels in 4096 equal bins of |logit(p_occupied)|, fine enough to cut bins of equal mass from.

    Stated is the confidence max(p, 1 - p), the event is that the predicted class is right. |logit| spreads out the
    confidences that crowd just below 1; p is clipped at 1e-7 for the choice of the bin alone.

    Returns:
        counts with N = 1, B = 4096.
    """
    occupied = require_label(label)
    p = require_p_occupied(p_occupied, occupied.shape)
    confidence = np.maximum(p, 1.0 - p).ravel()
    doubt = np.maximum(1.0 - confidence, NLL_CLIP)
    margin = np.log1p(-doubt) - np.log(doubt)
    bins = np.minimum(margin * (_FINE_BINS / _LIMIT), _FINE_BINS - 1).astype(np.int64)
    right = ((p >= 0.5) == occupied).ravel()
    return BinCounts(
        count=np.bincount(bins, minlength=_FINE_BINS)[None],
        p_sum=np.bincount(bins, weights=confidence, minlength=_FINE_BINS)[None].astype(np.float64),
        event=np.bincount(bins[right], minlength=_FINE_BINS)[None],
    )


def equal_mass_bins(count: NDArray[np.integer], n_bins: int) -> NDArray[np.int64]:
    """(B,) the bin of nearly equal mass that each of B fine bins falls into, by the middle of its mass.

    A fine bin is never cut: one that holds more than its share leaves neighbors empty.
    """
    count = np.asarray(count, dtype=np.float64)
    middle = np.cumsum(count) - count / 2
    return np.minimum(middle * n_bins / count.sum(), n_bins - 1).astype(np.int64)


def calibration_errors(
    confidence: BinCounts, margins: BinCounts, weights: NDArray[np.int64], level: float = 0.95
) -> CalibrationErrors:
    """The errors of one predictor over N images.

    Args:
        confidence: `confidence_counts` of the images.
        margins: `margin_counts` of the same images.
        weights: (R, N) multiplicities of R bootstrap samples of the images.
        level: coverage of the two-sided percentile interval of the signed error.
    """
    n_pixels = confidence.count.sum(axis=1)
    gap = (confidence.p_sum - confidence.event).sum(axis=1)
    fine = (margins.p_sum - margins.event).sum(axis=0)
    equal_mass = np.bincount(equal_mass_bins(margins.count.sum(axis=0), ADAPTIVE_BINS), weights=fine)
    low, high = np.quantile((weights @ gap) / (weights @ n_pixels), [(1 - level) / 2, (1 + level) / 2])
    return CalibrationErrors(
        expected=float(np.abs((confidence.p_sum - confidence.event).sum(axis=0)).sum() / n_pixels.sum()),
        adaptive=float(np.abs(equal_mass).sum() / n_pixels.sum()),
        signed=float(gap.sum() / n_pixels.sum()),
        signed_low=float(low),
        signed_high=float(high),
    )
