"""Temperature of the pooled probability: logit(p_occupied) / T, with T fitted by NLL (Guo et al. 2017).

Pool first, then calibrate (Rahaman and Thiery 2021): calibrating the members first leaves their mean
under-confident.
"""

import dataclasses

import numpy as np
from numpy.typing import NDArray

from deltasafe.errors import SettingsError
from deltasafe.perception.calibration.metrics import NLL_CLIP, require_label, require_p_occupied

__all__ = [
    "LogitCounts",
    "apply_temperature",
    "cross_fitted_temperatures",
    "fit_temperature",
    "folds_of",
    "logit_counts",
    "stack_logit_counts",
]

_LIMIT = float(np.log((1 - NLL_CLIP) / NLL_CLIP))
_BINS = 4096
_TEMPERATURE_LIMITS = (0.05, 20.0)


@dataclasses.dataclass(frozen=True)
class LogitCounts:
    """A fine histogram of the logits, per image and class; the fit needs no more (bins are 0.008 wide).

    Attributes:
        count: (N, 2, 4096) pixels; the second axis is the label (background, hand).
        logit_sum: (N, 2, 4096) sum of their logits, p clipped at 1e-7.
    """

    count: NDArray[np.int64]
    logit_sum: NDArray[np.float64]

    def without(self, image: int | NDArray[np.intp]) -> "LogitCounts":
        """The counts of all other images."""
        return LogitCounts(np.delete(self.count, image, axis=0), np.delete(self.logit_sum, image, axis=0))


def logit_counts(p_occupied: NDArray[np.floating], label: NDArray[np.generic]) -> LogitCounts:
    """Histogram of one image's logits (N = 1).

    Args:
        p_occupied: (H, W) pooled probabilities.
        label: (H, W) bool or 0/255.
    """
    occupied = require_label(label)
    logit = _logit(require_p_occupied(p_occupied, occupied.shape)).ravel()
    bins = np.minimum((logit + _LIMIT) * (_BINS / (2 * _LIMIT)), _BINS - 1).astype(np.int64)
    bins += _BINS * occupied.ravel()
    shape = (1, 2, _BINS)
    return LogitCounts(
        count=np.bincount(bins, minlength=2 * _BINS).reshape(shape),
        logit_sum=np.bincount(bins, weights=logit, minlength=2 * _BINS).reshape(shape).astype(np.float64),
    )


def stack_logit_counts(images: list[LogitCounts]) -> LogitCounts:
    """The counts of several images as one, along the first axis."""
    return LogitCounts(
        np.concatenate([image.count for image in images]),
        np.concatenate([image.logit_sum for image in images]),
    )


def fit_temperature(counts: LogitCounts) -> float:
    """The T that minimizes the mean NLL over all pixels of ``counts``.

    The NLL is convex in 1/T: the root of its derivative is bisected. T stays in [0.05, 20]; the lower end is
    returned when every pixel is classified right, for then no T is sharp enough.

    Raises:
        SettingsError: no image is left to fit on.
    """
    if len(counts.count) == 0:
        raise SettingsError("a temperature needs at least one image to be fitted on")
    count = counts.count.sum(axis=0)
    filled = count > 0
    weight = count[filled].astype(np.float64)
    logit = counts.logit_sum.sum(axis=0)[filled] / weight
    sign = np.where(np.nonzero(filled)[0] == 1, 1.0, -1.0)

    def slope(inverse: float) -> float:
        margin = sign * logit
        return float(-(weight * margin) @ (1.0 / (1.0 + np.exp(inverse * margin))))

    low, high = 1.0 / _TEMPERATURE_LIMITS[1], 1.0 / _TEMPERATURE_LIMITS[0]
    for _ in range(60):
        middle = (low * high) ** 0.5
        if slope(middle) < 0.0:
            low = middle
        else:
            high = middle
    return 1.0 / (low * high) ** 0.5


def cross_fitted_temperatures(counts: LogitCounts, n_folds: int | None = None) -> NDArray[np.float64]:
    """(N,) for each image the temperature fitted on the images outside its fold.

    Image i belongs to fold i mod ``n_folds``; by default every image is its own fold (leave one image out).
    Figures computed with these temperatures are figures on images that the fit has not seen.

    Raises:
        SettingsError: fewer than two images, or folds that do not split them.
    """
    fold = folds_of(len(counts.count), n_folds)
    fitted = [fit_temperature(counts.without(np.nonzero(fold == k)[0])) for k in range(fold.max() + 1)]
    return np.array(fitted)[fold]


def folds_of(n_images: int, n_folds: int | None = None) -> NDArray[np.intp]:
    """(N,) the fold of each image; by default every image is its own.

    Raises:
        SettingsError: fewer than two images, or folds that do not split them.
    """
    n_folds = n_images if n_folds is None else n_folds
    if not 2 <= n_folds <= n_images:
        raise SettingsError(
            f"{n_images} images cannot be split into {n_folds} folds: at least 2 folds, and an image in each"
        )
    return np.arange(n_images) % n_folds


def apply_temperature(p_occupied: NDArray[np.floating], temperature: float) -> NDArray[np.float64]:
    """sigmoid(logit(p_occupied) / T) with p clipped at 1e-7; the input, unclipped, for T = 1.

    Raises:
        SettingsError: T is not positive.
    """
    if not temperature > 0.0:
        raise SettingsError(f"temperature must be positive, got {temperature}")
    p = require_p_occupied(p_occupied)
    if temperature == 1.0:
        return p
    clipped = p.clip(NLL_CLIP, 1.0 - NLL_CLIP)
    return np.asarray(1.0 / (1.0 + ((1.0 - clipped) / clipped) ** (1.0 / temperature)))  # a power, not log and exp


def _logit(p: NDArray[np.float64]) -> NDArray[np.float64]:
    clipped = p.clip(NLL_CLIP, 1.0 - NLL_CLIP)
    return np.asarray(np.log(clipped) - np.log1p(-clipped))
