"""Which delta do the test images support? (decision 5)

The planner takes a pixel for free when ``p_occupied <= delta`` and promises that it is occupied with a
probability of at most delta. That promise is a statement about the network, and only labeled images can back
it.
"""

import dataclasses
import math
import pathlib
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from deltasafe.errors import DataError, SettingsError
from deltasafe.io.records import from_json
from deltasafe.io.storage import read_json
from deltasafe.perception.calibration.reliability import DELTA_GRID, BinCounts, bootstrap_weights, ratio

__all__ = [
    "Calibration",
    "DeltaSupport",
    "HeldOutDelta",
    "delta_support",
    "held_out_support",
    "require_supported_delta",
    "smallest_supported_delta",
]


@dataclasses.dataclass(frozen=True)
class Calibration:
    """What an ensemble states about its own probabilities; stored with it as ``calibration.json``.

    The statement is about `Ensemble.p_occupied` as it is used: the mean of all members, recalibrated by
    ``temperature``, on all pixels of images that neither the members nor the temperature they were judged with
    have seen.

    Attributes:
        n_images: images on which the scores were measured.
        n_members: members of the ensemble.
        pixel_accuracy, miou, brier, nll: see `deltasafe.perception.calibration.metrics`.
        expected_calibration_error: of the ten bins on [0.5, 1].
        smallest_supported_delta: None if the data supports no delta at all.
        level: one-sided confidence of that support.
        temperature: divides the logit of the mean; 1.0 leaves it as it is.
        n_calibration_images: images that temperature, delta and threshold were fitted on; 0 in old files, in which
            they are the ``n_images``.
        missed_hand_alpha: bound on the expected share of a hand's pixels with ``p_occupied <=
            missed_hand_threshold`` in a new image (conformal risk control); None in old files.
        missed_hand_threshold: None if so few images support no threshold.
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
    n_calibration_images: int = 0
    missed_hand_alpha: float | None = None
    missed_hand_threshold: float | None = None

    def __post_init__(self) -> None:
        for name in ("n_images", "n_members"):
            if getattr(self, name) < 1:
                raise SettingsError(f"{name} must be at least 1, got {getattr(self, name)}")
        for name in ("pixel_accuracy", "miou", "brier", "expected_calibration_error", "level"):
            if not 0.0 <= getattr(self, name) <= 1.0:
                raise SettingsError(f"{name} must lie in [0, 1], got {getattr(self, name)}")
        supported = self.smallest_supported_delta
        if supported is not None and not 0.0 < supported < 1.0:
            raise SettingsError(f"smallest_supported_delta must lie in (0, 1) or be None, got {supported}")
        if not (math.isfinite(self.temperature) and self.temperature > 0.0):
            raise SettingsError(f"temperature must be positive, got {self.temperature}")

    @classmethod
    def load(cls, path: str | pathlib.Path) -> "Calibration":
        """Read ``calibration.json``, also one of the first format, which knows no threshold.

        Raises:
            DataError: the file is missing or no calibration.
        """
        value = read_json(path)
        try:
            if not isinstance(value, dict):
                raise TypeError("not an object")
            found: Calibration = from_json(cls, value)
            return found
        except (TypeError, ValueError) as error:
            raise DataError(path, f"is not a calibration ({error}); freeze the ensemble again") from error


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


@dataclasses.dataclass(frozen=True)
class HeldOutDelta:
    """The smallest supported delta, fitted and judged on different images.

    Attributes:
        n_fits: how often it was fitted.
        n_without_delta: fits that supported no delta.
        lowest, highest: range of the deltas fitted.
        clear_share: share of all judged pixels that count as free at the delta of their fit.
        occupied_share: share of those that are occupied; it should be at most delta.
    """

    n_fits: int
    n_without_delta: int
    lowest: float | None
    highest: float | None
    clear_share: float
    occupied_share: float | None


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
    clear, missed = _taken_for_free(counts)
    pixels, hand = counts.count.sum(axis=1), counts.event.sum(axis=1)
    # the one more image
    clear_drawn = np.vstack([clear, np.full((1, len(DELTA_GRID)), pixels.mean())])
    missed_drawn = np.vstack([missed, np.full((1, len(DELTA_GRID)), hand.mean())])
    weights = bootstrap_weights(len(pixels) + 1, n_bootstrap, seed).astype(np.float64)
    # a sample without any clear pixel says nothing in favor of delta
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


def held_out_support(
    counts: BinCounts,
    fits: Sequence[BinCounts],
    judged: Sequence[NDArray[np.intp]],
    *,
    n_bootstrap: int = 2000,
    level: float = 0.95,
    seed: int = 0,
) -> HeldOutDelta:
    """What becomes of the smallest supported delta on images that it was not fitted on.

    Args:
        counts: `safety_counts` of N images, drawn upon by ``judged``.
        fits: images to fit on, once or fold by fold.
        judged: for each fit the indices into ``counts`` of the images that it has not seen.
        n_bootstrap, level, seed: of `delta_support`.
    """
    clear, missed = _taken_for_free(counts)
    deltas: list[float] = []
    n_clear = n_missed = 0
    for fit, unseen in zip(fits, judged, strict=True):
        delta = smallest_supported_delta(delta_support(fit, n_bootstrap=n_bootstrap, level=level, seed=seed))
        if delta is not None:
            k = DELTA_GRID.index(delta)
            deltas.append(delta)
            n_clear += int(clear[unseen, k].sum())
            n_missed += int(missed[unseen, k].sum())
    return HeldOutDelta(
        n_fits=len(fits),
        n_without_delta=len(fits) - len(deltas),
        lowest=min(deltas, default=None),
        highest=max(deltas, default=None),
        clear_share=n_clear / int(counts.count.sum()),
        occupied_share=n_missed / n_clear if n_clear else None,
    )


def _taken_for_free(counts: BinCounts) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """(N, len(DELTA_GRID)) pixels with p_occupied <= delta, and how many of them are occupied."""
    clear = np.cumsum(counts.count, axis=1, dtype=np.float64)[:, :-1]
    return clear, np.cumsum(counts.event, axis=1, dtype=np.float64)[:, :-1]


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
