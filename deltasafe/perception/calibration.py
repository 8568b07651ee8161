"""Which delta do the test images support? (decision 5)

The planner takes a pixel for free when ``p_occupied <= delta`` and promises that it is occupied with a
probability of at most delta. That promise is a statement about the network, and only labelled images can back
it.
"""

import dataclasses
import math

import numpy as np

from deltasafe.errors import SettingsError
from deltasafe.perception.reliability import DELTA_GRID, BinCounts, bootstrap_weights, ratio

__all__ = [
    "Calibration",
    "DeltaSupport",
    "delta_support",
    "require_supported_delta",
    "smallest_supported_delta",
]


@dataclasses.dataclass(frozen=True)
class Calibration:
    """What an ensemble states about its own probabilities; stored with it as ``calibration.json``.

    The statement is about the mean of all members as it is (T = 1), on all pixels of the test images.

    Attributes:
        n_images: images on which everything below was measured.
        n_members: members of the ensemble.
        pixel_accuracy, miou, brier, nll: see `deltasafe.perception.metrics`.
        expected_calibration_error: of the ten bins on [0.5, 1].
        smallest_supported_delta: None if the data supports no delta at all.
        level: one-sided confidence of that support.
        temperature: what recalibration would use; 1.0 means as it is. Nothing above was computed with it.
    """

    n_images: int
    n_members: int
    pixel_accuracy: float
    miou: float
    brier: float
    nll: float
    expected_calibration_error: float
    smallest_supported_delta: float | None
    level: float = 0.95
    temperature: float = 1.0

    def __post_init__(self) -> None:
        supported = self.smallest_supported_delta
        if supported is not None and not 0.0 < supported < 1.0:
            raise SettingsError(f"smallest_supported_delta must lie in (0, 1) or be None, got {supported}")
        if not (math.isfinite(self.temperature) and self.temperature > 0.0):
            raise SettingsError(f"temperature must be positive, got {self.temperature}")


@dataclasses.dataclass(frozen=True)
class DeltaSupport:
    """What the data says about one delta.

    Attributes:
        delta: the threshold.
        clear_share: share of all pixels with p_occupied <= delta.
        occupied_share: share of those that are occupied after all; None if there is no such pixel.
        upper_bound: upper bound of that share (see `delta_support`).
        missed_hand_rate_mean: share of an image's hand pixels with p_occupied <= delta, mean over images with
            a hand.
        missed_hand_rate_worst: the same, in the worst image.
        supported: the bound is at most delta, here and at every larger delta of the grid.
    """

    delta: float
    clear_share: float
    occupied_share: float | None
    upper_bound: float
    missed_hand_rate_mean: float | None
    missed_hand_rate_worst: float | None
    supported: bool


def delta_support(
    counts: BinCounts, *, n_bootstrap: int = 2000, level: float = 0.95, seed: int = 0
) -> tuple[DeltaSupport, ...]:
    """Judge every delta of ``DELTA_GRID``.

    The estimate is the share of occupied pixels among those with ``p_occupied <= delta``, pooled over the
    images. Its upper bound is the ``level`` quantile of a bootstrap that draws whole images, since the pixels
    of an image depend on one another and a Clopper-Pearson bound on pixels would claim the evidence of
    millions of independent trials. A plain bootstrap, however, can only repeat what it has seen: without a
    single miss it would support any delta. Therefore it draws from the N images and **one more, whose hand
    the network misses entirely** (an image of mean size and mean hand area), because N images cannot exclude
    that the next one is such a case. That is the idea of conformal risk control's "+ B / (N + 1)", and
    without any miss it gives the rule of three: such an image occurs in up to 3 / (N + 1) of all cases at 95
    %. With 50 images of which the hand covers a quarter, a delta below about 0.02 is therefore out of reach
    however good the network is.

    The bound is on average over the pixels that count as free, of which most lie far from any hand; the rows
    of the safety diagram and the missed-hand rates show where it is worse than on average.

    Args:
        counts: `safety_counts` of N images.
        n_bootstrap: samples.
        level: one-sided confidence.
        seed: of the bootstrap.
    """
    clear = np.cumsum(counts.count, axis=1)[:, :-1]
    missed = np.cumsum(counts.event, axis=1)[:, :-1]
    pixels, hand = counts.count.sum(axis=1), counts.event.sum(axis=1)
    # the one more image
    clear_drawn = np.vstack([clear, np.full((1, len(DELTA_GRID)), pixels.mean())])
    missed_drawn = np.vstack([missed, np.full((1, len(DELTA_GRID)), hand.mean())])
    weights = bootstrap_weights(len(pixels) + 1, n_bootstrap, seed)
    # a sample without any clear pixel says nothing in favour of delta
    drawn = np.nan_to_num(ratio(weights @ missed_drawn, weights @ clear_drawn), nan=1.0)
    bound = np.quantile(drawn, level, axis=0, method="higher")
    rate = missed[hand > 0] / hand[hand > 0, None]
    share = ratio(missed.sum(axis=0), clear.sum(axis=0))
    holds = bound <= np.array(DELTA_GRID)
    supported = np.logical_and.accumulate(holds[::-1])[::-1]
    return tuple(
        DeltaSupport(
            delta=delta,
            clear_share=float(clear[:, k].sum() / pixels.sum()),
            occupied_share=None if np.isnan(share[k]) else float(share[k]),
            upper_bound=float(bound[k]),
            missed_hand_rate_mean=float(rate[:, k].mean()) if len(rate) else None,
            missed_hand_rate_worst=float(rate[:, k].max()) if len(rate) else None,
            supported=bool(supported[k]),
        )
        for k, delta in enumerate(DELTA_GRID)
    )


def smallest_supported_delta(support: tuple[DeltaSupport, ...]) -> float | None:
    """The smallest delta of the grid that is supported together with all larger ones; None without one."""
    return min((row.delta for row in support if row.supported), default=None)


def require_supported_delta(delta: float, calibration: Calibration) -> None:
    """Refuse to plan with a smaller delta than the ensemble's test images support.

    Raises:
        SettingsError: naming ``delta``, the smallest supported one, and the remedy.
    """
    if not 0.0 < delta < 1.0:
        raise SettingsError(f"delta must lie in (0, 1), got {delta}")
    supported = calibration.smallest_supported_delta
    basis = f"{calibration.n_images} test images at {calibration.level:.0%} confidence"
    if supported is None:
        raise SettingsError(
            f"delta = {delta:g} is refused: {basis} support no delta of at most {DELTA_GRID[-1]:g}; "
            "improve the ensemble or measure it on more images"
        )
    if delta < supported:
        raise SettingsError(
            f"delta = {delta:g} is refused: the smallest delta that {basis} support is {supported:g}; "
            f"plan with delta >= {supported:g}, or calibrate on more images"
        )
