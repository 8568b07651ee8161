"""How often is the network right when it says so? Counts per image first, curves and intervals from the
counts.

Every histogram has the image as its first axis: no step needs all pixels at once, and the bootstrap draws
images. Neighboring pixels are copies of one another, so that intervals over pixels would be far too narrow
(decision 4).
"""

import dataclasses

import numpy as np
from numpy.typing import NDArray

from deltasafe.errors import SettingsError
from deltasafe.perception.calibration.metrics import require_label, require_p_occupied

__all__ = [
    "CONFIDENCE_EDGES",
    "DELTA_GRID",
    "BinCounts",
    "Curve",
    "bootstrap_weights",
    "class_counts",
    "confidence_counts",
    "curve",
    "safety_counts",
    "stack_counts",
]

CONFIDENCE_EDGES = tuple(i / 20 for i in range(10, 21))
"""Ten equal bins on [0.5, 1] (Fig. 4 of the paper); the last is closed."""

DELTA_GRID = (
    *(1e-4, 2e-4, 5e-4),
    *(1e-3, 2e-3, 3e-3, 5e-3, 7e-3),
    *(0.01, 0.015, 0.02, 0.03, 0.05, 0.07),
    *(0.1, 0.15, 0.2, 0.3, 0.5),
)
"""The values of delta at which the support of the data is judged; also the bins of the safety diagram."""


@dataclasses.dataclass(frozen=True)
class BinCounts:
    """Sums per image and bin.

    Attributes:
        count: (N, B) int64, pixels.
        p_sum: (N, B) float64, sum of the stated probability of the event.
        event: (N, B) int64, pixels at which the event came true.
    """

    count: NDArray[np.int64]
    p_sum: NDArray[np.float64]
    event: NDArray[np.int64]

    def take(self, images: NDArray[np.intp]) -> "BinCounts":
        """The counts of some of the images."""
        return BinCounts(self.count[images], self.p_sum[images], self.event[images])


@dataclasses.dataclass(frozen=True)
class Curve:
    """A reliability curve of B bins; None where no pixel fell into a bin.

    Attributes:
        count: pixels per bin.
        stated: mean stated probability per bin (confidence, or p_occupied).
        observed: how often the event came true (accuracy, or share of occupied pixels).
        low, high: interval of ``observed``, by bootstrap over images; empty if none was asked for.
    """

    count: tuple[int, ...]
    stated: tuple[float | None, ...]
    observed: tuple[float | None, ...]
    low: tuple[float | None, ...] = ()
    high: tuple[float | None, ...] = ()


def confidence_counts(p_occupied: NDArray[np.floating], label: NDArray[np.generic]) -> BinCounts:
    """Counts of the paper's reliability diagram for one image: is the predicted class right, per confidence?

    Confidence is max(p_occupied, 1 - p_occupied); an exact 0.5 counts as predicted occupied (decision 4).

    Args:
        p_occupied: (H, W) probabilities.
        label: (H, W) bool or 0/255.

    Returns:
        counts with N = 1, B = 10.
    """
    occupied = require_label(label)
    p = require_p_occupied(p_occupied, occupied.shape)
    confidence = np.maximum(p, 1.0 - p)
    bins = np.searchsorted(CONFIDENCE_EDGES[1:-1], confidence, side="right")
    return _count(bins, confidence, (p >= 0.5) == occupied, len(CONFIDENCE_EDGES) - 1)


def class_counts(p_occupied: NDArray[np.floating], label: NDArray[np.generic]) -> tuple[BinCounts, BinCounts]:
    """The counts of `confidence_counts` apart for pixels predicted as hand and as background.

    A network may be overconfident where it sees a hand and under-confident where it sees none; pooled, the many
    background pixels hide it.

    Returns:
        counts of the pixels predicted as hand, and as background, each with N = 1, B = 10.
    """
    occupied = require_label(label)
    p = require_p_occupied(p_occupied, occupied.shape)
    confidence = np.maximum(p, 1.0 - p)
    bins = np.searchsorted(CONFIDENCE_EDGES[1:-1], confidence, side="right")
    n_bins = len(CONFIDENCE_EDGES) - 1
    hand = p >= 0.5
    return (
        _count(bins[hand], confidence[hand], occupied[hand], n_bins),
        _count(bins[~hand], confidence[~hand], ~occupied[~hand], n_bins),
    )


def safety_counts(p_occupied: NDArray[np.floating], label: NDArray[np.generic]) -> BinCounts:
    """Counts of the diagram that matters to safety for one image: is a pixel occupied, per p_occupied = 1 -
    p_free?

    Bin k holds ``DELTA_GRID[k - 1] < p_occupied <= DELTA_GRID[k]``, the first one starts at 0, the last one
    ends at 1: sums over the first bins are the pixels that a planner with that delta takes for free.

    Returns:
        counts with N = 1, B = len(DELTA_GRID) + 1.
    """
    occupied = require_label(label)
    p = require_p_occupied(p_occupied, occupied.shape)
    return _count(np.searchsorted(DELTA_GRID, p, side="left"), p, occupied, len(DELTA_GRID) + 1)


def stack_counts(images: list[BinCounts]) -> BinCounts:
    """The counts of several images as one, along the first axis."""
    if not images:
        raise SettingsError("reliability needs at least one image")
    return BinCounts(
        *(np.concatenate([getattr(image, name) for image in images]) for name in ("count", "p_sum", "event"))
    )


def curve(counts: BinCounts, weights: NDArray[np.int64] | None = None, level: float = 0.95) -> Curve:
    """Pool the images' counts into a curve.

    Args:
        counts: N images, B bins.
        weights: (R, N) multiplicities of R bootstrap samples of the images (`bootstrap_weights`); intervals
            if given.
        level: coverage of the two-sided percentile interval.
    """
    count = counts.count.sum(axis=0)
    low: tuple[float | None, ...] = ()
    high: tuple[float | None, ...] = ()
    if weights is not None:
        drawn = ratio(weights @ counts.event, weights @ counts.count)
        tails = [(1 - level) / 2, (1 + level) / 2]
        bounds = [
            np.quantile(column[~np.isnan(column)], tails) if pixels else np.full(2, np.nan)
            for column, pixels in zip(drawn.T, count, strict=True)
        ]
        low, high = (_optional(side) for side in np.transpose(bounds))
    return Curve(
        count=tuple(int(pixels) for pixels in count),
        stated=_optional(ratio(counts.p_sum.sum(axis=0), count)),
        observed=_optional(ratio(counts.event.sum(axis=0), count)),
        low=low,
        high=high,
    )


def bootstrap_weights(n_images: int, n_bootstrap: int, seed: int) -> NDArray[np.int64]:
    """(n_bootstrap, n_images) how often each image occurs in each sample drawn with replacement."""
    rng = np.random.default_rng(seed)
    return rng.multinomial(n_images, np.full(n_images, 1.0 / n_images), size=n_bootstrap)


def ratio(numerator: NDArray[np.generic], denominator: NDArray[np.generic]) -> NDArray[np.float64]:
    """Quotient that is NaN, silently, where the denominator is zero."""
    result = np.full(np.shape(denominator), np.nan)
    return np.divide(numerator, denominator, out=result, where=np.asarray(denominator) > 0)


def _count(bins: NDArray[np.intp], stated: NDArray[np.float64], event: NDArray[np.bool_], n_bins: int) -> BinCounts:
    bins = bins.ravel()
    return BinCounts(
        count=np.bincount(bins, minlength=n_bins)[None],
        p_sum=np.bincount(bins, weights=stated.ravel(), minlength=n_bins)[None].astype(np.float64),
        event=np.bincount(bins[event.ravel()], minlength=n_bins)[None],
    )


def _optional(values: NDArray[np.float64]) -> tuple[float | None, ...]:
    return tuple(None if np.isnan(value) else float(value) for value in values)
