"""Temperature scaling of the pooled probability: logit(p_occupied) / T, with T fitted by NLL (Guo et al. 2017).

The members are averaged first and the mean is calibrated (Rahaman and Thiery 2021). Calibrating each member first
leaves the mean under-confident.
"""

import dataclasses

import numpy as np
from numpy.typing import NDArray

from deltasafe.errors import SettingsError
from deltasafe.perception.calibration.metrics import NLL_CLIP, require_labeled_prediction, require_p_occupied

_MAX_LOGIT = float(np.log((1 - NLL_CLIP) / NLL_CLIP))
_BINS = 4096
_TEMPERATURE_LIMITS = (0.05, 20.0)


@dataclasses.dataclass(frozen=True)
class LogitCounts:
    """A histogram of the logits per image and class. Its bins are 0.008 wide, which is fine enough for the fit.

    Attributes:
        count: (N, 2, 4096) pixels; the second axis is the label (background, hand).
        logit_sum: (N, 2, 4096) sum of their logits, p clipped at 1e-7.
    """

    count: NDArray[np.int64]
    logit_sum: NDArray[np.float64]

    def without(self, images: NDArray[np.intp]) -> "LogitCounts":
        """Leave out images by index."""
        return LogitCounts(np.delete(self.count, images, axis=0), np.delete(self.logit_sum, images, axis=0))


def pooled_probability(member_probabilities: NDArray[np.floating], temperature: float = 1.0) -> NDArray[np.float64]:
    """Average the members' probabilities, then apply the temperature: the probability of the ensemble.

    Args:
        member_probabilities: (M, ...) p_occupied of M members. The mean has the precision of this array.
        temperature: divides the logit of the mean; 1 leaves the mean unchanged.

    Raises:
        SettingsError: values outside [0, 1], or T is not positive.
    """
    return apply_temperature(np.mean(member_probabilities, axis=0), temperature)


def apply_temperature(p_occupied: NDArray[np.floating], temperature: float) -> NDArray[np.float64]:
    """Compute sigmoid(logit(p_occupied) / T) with p clipped at 1e-7; for T = 1 return the input, not clipped.

    Raises:
        SettingsError: values outside [0, 1], or T is not positive.
    """
    if not temperature > 0.0:
        raise SettingsError(f"temperature must be positive, got {temperature}")
    p = require_p_occupied(p_occupied)
    if temperature == 1.0:
        return p
    clipped = p.clip(NLL_CLIP, 1.0 - NLL_CLIP)
    return np.asarray(1.0 / (1.0 + ((1.0 - clipped) / clipped) ** (1.0 / temperature)))  # a power, not log and exp


def logit_counts(p_occupied: NDArray[np.floating], label: NDArray[np.generic]) -> LogitCounts:
    """Build the histogram of one image (N = 1).

    Args:
        p_occupied: (H, W) pooled probabilities.
        label: (H, W) bool or 0/255.
    """
    p, occupied = require_labeled_prediction(p_occupied, label)
    clipped = p.clip(NLL_CLIP, 1.0 - NLL_CLIP)
    logit = (np.log(clipped) - np.log1p(-clipped)).ravel()
    bins = np.minimum((logit + _MAX_LOGIT) * (_BINS / (2 * _MAX_LOGIT)), _BINS - 1).astype(np.int64)
    bins += _BINS * occupied.ravel()
    shape = (1, 2, _BINS)
    return LogitCounts(
        count=np.bincount(bins, minlength=2 * _BINS).reshape(shape),
        logit_sum=np.bincount(bins, weights=logit, minlength=2 * _BINS).reshape(shape).astype(np.float64),
    )


def stack_logit_counts(images: list[LogitCounts]) -> LogitCounts:
    """Concatenate the counts of several images along the first axis."""
    return LogitCounts(
        np.concatenate([image.count for image in images]),
        np.concatenate([image.logit_sum for image in images]),
    )


def fit_temperature(counts: LogitCounts) -> float:
    """Find the T in [0.05, 20] that minimizes the mean NLL over all pixels of ``counts``.

    The NLL is convex in 1/T, so the root of its derivative is found by bisection. If every pixel is classified
    correctly, the NLL falls with T, and the result is the lower limit.

    Raises:
        SettingsError: there is no image to fit on.
    """
    if len(counts.count) == 0:
        raise SettingsError("a temperature needs at least one image to be fitted on")
    count = counts.count.sum(axis=0)
    filled = count > 0
    weight = count[filled].astype(np.float64)
    logit = counts.logit_sum.sum(axis=0)[filled] / weight
    margin = np.where(np.nonzero(filled)[0] == 1, 1.0, -1.0) * logit

    def slope(inverse: float) -> float:
        return float(-(weight * margin) @ (1.0 / (1.0 + np.exp(inverse * margin))))

    low, high = 1.0 / _TEMPERATURE_LIMITS[1], 1.0 / _TEMPERATURE_LIMITS[0]
    for _ in range(60):
        middle = (low * high) ** 0.5
        if slope(middle) < 0.0:
            low = middle
        else:
            high = middle
    return 1.0 / (low * high) ** 0.5


def cross_fitted_temperatures(counts: LogitCounts, n_folds: int = 0) -> NDArray[np.float64]:
    """Fit the temperature of each image on the images outside its fold.

    Scores computed with these temperatures are scores on images that the fit has not seen.

    Args:
        counts: of N images.
        n_folds: see `folds_of`.

    Returns:
        (N,) temperatures.

    Raises:
        SettingsError: see `folds_of`.
    """
    fold = folds_of(len(counts.count), n_folds)
    fitted = [fit_temperature(counts.without(np.nonzero(fold == k)[0])) for k in range(fold.max() + 1)]
    return np.array(fitted)[fold]


def folds_of(n_images: int, n_folds: int = 0) -> NDArray[np.intp]:
    """Assign image i to fold i mod ``n_folds``; 0 folds means leave-one-out.

    Returns:
        (N,) fold of each image.

    Raises:
        SettingsError: fewer than two folds, or more folds than images.
    """
    n_folds = n_folds or n_images
    if not 2 <= n_folds <= n_images:
        raise SettingsError(
            f"{n_images} images cannot be split into {n_folds} folds: at least 2 folds, and an image in each"
        )
    return np.arange(n_images) % n_folds
