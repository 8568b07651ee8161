"""Reliability: how often a prediction of given probability is correct. Counts per image, then curves with intervals.

The first axis of every histogram is the image. No step needs all pixels at once, and the bootstrap draws images.
Neighboring pixels are strongly correlated, so that intervals over pixels would be far too narrow (decision 4).
"""

import dataclasses

import numpy as np
from numpy.typing import NDArray

from deltasafe.errors import SettingsError
from deltasafe.perception.calibration.metrics import require_labeled_prediction

CONFIDENCE_EDGES = tuple(i / 20 for i in range(10, 21))
"""Ten equal bins on [0.5, 1] (Fig. 4 of the paper); the last one is closed."""

DELTA_GRID = (
    *(1e-4, 2e-4, 5e-4),
    *(1e-3, 2e-3, 3e-3, 5e-3, 7e-3),
    *(0.01, 0.015, 0.02, 0.03, 0.05, 0.07),
    *(0.1, 0.15, 0.2, 0.3, 0.5),
)
"""The values of delta that are tested for support; also the upper edges of the bins of the safety diagram."""


@dataclasses.dataclass(frozen=True)
class BinCounts:
    """Sums per image and bin.

    Attributes:
        count: (N, B) int64, pixels.
        p_sum: (N, B) float64, sum of the predicted probability of the event.
        event: (N, B) int64, pixels at which the event occurred.
    """

    count: NDArray[np.int64]
    p_sum: NDArray[np.float64]
    event: NDArray[np.int64]

    def take(self, images: NDArray[np.intp]) -> "BinCounts":
        """Select images by index."""
        return BinCounts(self.count[images], self.p_sum[images], self.event[images])


@dataclasses.dataclass(frozen=True)
class ReliabilityCurve:
    """A reliability curve of B bins; None for bins without pixels.

    Attributes:
        count: pixels per bin.
        predicted: mean predicted probability per bin (confidence, or p_occupied).
        observed: frequency of the event per bin (accuracy, or fraction of occupied pixels).
        low, high: interval of ``observed`` by bootstrap over images; empty without bootstrap weights.
    """

    count: tuple[int, ...]
    predicted: tuple[float | None, ...]
    observed: tuple[float | None, ...]
    low: tuple[float | None, ...] = ()
    high: tuple[float | None, ...] = ()


def delta_index(delta: float) -> int:
    """Return the index of the smallest value of ``DELTA_GRID`` that is at least ``delta``; at most the last index."""
    return min(int(np.searchsorted(DELTA_GRID, delta)), len(DELTA_GRID) - 1)


def confidence_counts(p_occupied: NDArray[np.floating], label: NDArray[np.generic]) -> BinCounts:
    """Count correct predictions per bin of confidence in one image, for the reliability diagram of the paper.

    Confidence is max(p_occupied, 1 - p_occupied); an exact 0.5 counts as predicted occupied (decision 4).

    Args:
        p_occupied: (H, W) probabilities.
        label: (H, W) bool or 0/255.

    Returns:
        counts with N = 1, B = 10.
    """
    p, occupied = require_labeled_prediction(p_occupied, label)
    return _bin_by_confidence(p, (p >= 0.5) == occupied)


def class_counts(p_occupied: NDArray[np.floating], label: NDArray[np.generic]) -> tuple[BinCounts, BinCounts]:
    """Count as `confidence_counts`, separately for pixels predicted as hand and as background.

    A network can be overconfident for hand and under-confident for background. Pooled counts hide it, because most
    pixels are background.

    Returns:
        counts of the pixels predicted as hand, and as background, each with N = 1, B = 10.
    """
    p, occupied = require_labeled_prediction(p_occupied, label)
    hand = p >= 0.5
    return _bin_by_confidence(p[hand], occupied[hand]), _bin_by_confidence(p[~hand], ~occupied[~hand])


def safety_counts(p_occupied: NDArray[np.floating], label: NDArray[np.generic]) -> BinCounts:
    """Count occupied pixels per bin of p_occupied in one image, for the safety diagram.

    Bin k holds ``DELTA_GRID[k - 1] < p_occupied <= DELTA_GRID[k]``. The first bin starts at 0, the last one ends at 1.
    Hence the first k + 1 bins hold the pixels that a planner with ``DELTA_GRID[k]`` treats as free.

    Returns:
        counts with N = 1, B = len(DELTA_GRID) + 1.
    """
    p, occupied = require_labeled_prediction(p_occupied, label)
    return bin_pixels(np.searchsorted(DELTA_GRID, p, side="left"), p, occupied, len(DELTA_GRID) + 1)


def bin_pixels(
    bins: NDArray[np.intp], p_event: NDArray[np.float64], event: NDArray[np.bool_], n_bins: int
) -> BinCounts:
    """Sum pixels, predicted probability of the event, and events per bin; the arguments have one entry per pixel."""
    bins = bins.ravel()
    return BinCounts(
        count=np.bincount(bins, minlength=n_bins)[None],
        p_sum=np.bincount(bins, weights=p_event.ravel(), minlength=n_bins)[None].astype(np.float64),
        event=np.bincount(bins[event.ravel()], minlength=n_bins)[None],
    )


def stack_counts(images: list[BinCounts]) -> BinCounts:
    """Concatenate the counts of several images along the first axis."""
    if not images:
        raise SettingsError("reliability needs at least one image")
    return BinCounts(
        *(np.concatenate([getattr(image, name) for image in images]) for name in ("count", "p_sum", "event"))
    )


def reliability_curve(
    counts: BinCounts, weights: NDArray[np.int64] | None = None, level: float = 0.95
) -> ReliabilityCurve:
    """Pool the counts of N images into a curve.

    Args:
        counts: N images, B bins.
        weights: (R, N) multiplicities of R bootstrap samples (`bootstrap_weights`); without them, no intervals.
        level: coverage of the two-sided percentile interval.
    """
    count = counts.count.sum(axis=0)
    low: tuple[float | None, ...] = ()
    high: tuple[float | None, ...] = ()
    if weights is not None:
        samples = ratio(weights @ counts.event, weights @ counts.count)
        tails = [(1 - level) / 2, (1 + level) / 2]
        bounds = [
            np.quantile(column[~np.isnan(column)], tails) if pixels else np.full(2, np.nan)
            for column, pixels in zip(samples.T, count, strict=True)
        ]
        low, high = (_none_for_nan(side) for side in np.transpose(bounds))
    return ReliabilityCurve(
        count=tuple(int(pixels) for pixels in count),
        predicted=_none_for_nan(ratio(counts.p_sum.sum(axis=0), count)),
        observed=_none_for_nan(ratio(counts.event.sum(axis=0), count)),
        low=low,
        high=high,
    )


def bootstrap_weights(n_images: int, n_bootstrap: int, seed: int) -> NDArray[np.int64]:
    """Draw ``n_bootstrap`` samples of the images with replacement.

    Returns:
        (n_bootstrap, n_images) multiplicity of each image in each sample.
    """
    rng = np.random.default_rng(seed)
    return rng.multinomial(n_images, np.full(n_images, 1.0 / n_images), size=n_bootstrap)


def ratio(numerator: NDArray[np.generic], denominator: NDArray[np.generic]) -> NDArray[np.float64]:
    """Divide; NaN, without a warning, where the denominator is zero."""
    result = np.full(np.shape(denominator), np.nan)
    return np.divide(numerator, denominator, out=result, where=np.asarray(denominator) > 0)


def _bin_by_confidence(p_occupied: NDArray[np.float64], correct: NDArray[np.bool_]) -> BinCounts:
    confidence = np.maximum(p_occupied, 1.0 - p_occupied)
    bins = np.searchsorted(CONFIDENCE_EDGES[1:-1], confidence, side="right")
    return bin_pixels(bins, confidence, correct, len(CONFIDENCE_EDGES) - 1)


def _none_for_nan(values: NDArray[np.float64]) -> tuple[float | None, ...]:
    return tuple(None if np.isnan(value) else float(value) for value in values)
