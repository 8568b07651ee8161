"""Which delta do labeled images support? (decision 5)

The planner treats a pixel as free if ``p_occupied <= delta`` and promises that the probability of occupancy is at most
delta. Only labeled images can show that the network keeps this promise.
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
from deltasafe.perception.calibration.conformal_margin import ConformalMargins
from deltasafe.perception.calibration.reliability import DELTA_GRID, BinCounts, bootstrap_weights, ratio


@dataclasses.dataclass(frozen=True)
class Calibration:
    """Calibration of an ensemble as it is used; stored with it as ``calibration.json``.

    It refers to `Ensemble.p_occupied`: the mean of all members, calibrated by ``temperature``. The scores are over all
    pixels of images that were used neither to train the members nor to fit the temperature they were evaluated with.

    Attributes:
        n_images: images on which the scores were measured.
        n_members: members of the ensemble.
        pixel_accuracy, miou, brier, nll: see `deltasafe.perception.calibration.metrics`.
        expected_calibration_error: over ten equal bins of confidence on [0.5, 1].
        smallest_supported_delta: None if the images support no delta.
        level: one-sided confidence of that support.
        temperature: divides the logit of the mean; 1.0 leaves the mean unchanged.
        n_calibration_images: images that temperature, delta and threshold were fitted on. 0 in old files: there, they
            were fitted on the ``n_images``.
        missed_hand_alpha: bound on the expected fraction of a hand's pixels with ``p_occupied <=
            missed_hand_threshold`` in a new image (conformal risk control); None in old files.
        missed_hand_threshold: None if there are too few images for a threshold.
        conformal_margins: margins around the pixels with p_occupied > delta that contain the whole hand in a new image;
            None in old files.
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
    conformal_margins: ConformalMargins | None = None

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
        """Read ``calibration.json``, including files without the later fields.

        Raises:
            DataError: the file is missing or holds no calibration.
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
    """Support of one delta by the images.

    Attributes:
        delta: the threshold.
        free_fraction: fraction of the pixels of all images with a hand that have p_occupied <= delta.
        occupied_fraction: fraction of those that are occupied; None without such pixels.
        upper_bound: upper confidence bound of ``occupied_fraction`` (see `delta_support`).
        miss_rate_mean: fraction of an image's hand pixels with p_occupied <= delta, mean over images with a hand.
        miss_rate_worst: the same in the worst image.
        supported: the bound is at most delta, for this and every larger delta of the grid.
    """

    delta: float
    free_fraction: float
    occupied_fraction: float | None
    upper_bound: float
    miss_rate_mean: float | None
    miss_rate_worst: float | None
    supported: bool


@dataclasses.dataclass(frozen=True)
class HeldOutDelta:
    """The smallest supported delta, evaluated on images that it was not fitted on.

    Attributes:
        n_fits: number of fits.
        n_without_delta: fits that supported no delta.
        lowest, highest: range of the fitted deltas.
        free_fraction: fraction of the pixels of all images with a hand that count as free at the delta of their fit.
        occupied_fraction: fraction of those that are occupied; it should be at most delta.
    """

    n_fits: int
    n_without_delta: int
    lowest: float | None
    highest: float | None
    free_fraction: float
    occupied_fraction: float | None


def delta_support(
    counts: BinCounts, *, n_bootstrap: int = 2000, level: float = 0.95, seed: int = 0
) -> tuple[DeltaSupport, ...]:
    """Test every delta of ``DELTA_GRID`` for support.

    The estimate is the fraction of occupied pixels among those with ``p_occupied <= delta``, pooled over the images.
    Its upper bound is the ``level`` quantile of a bootstrap over whole images. A Clopper-Pearson bound over pixels was
    rejected: it would treat strongly correlated pixels as independent trials.

    A plain bootstrap cannot produce misses that it has not observed: without a miss it would support any delta. The
    bootstrap therefore draws from the N images and **one additional image whose hand is missed completely** (of mean
    size and mean hand area), because N images cannot exclude that the next image is such a case. This corresponds to
    "+ B / (N + 1)" in conformal risk control. Without any miss it gives the rule of three: at 95 %, such an image
    occurs in up to 3 / (N + 1) of all cases. With 50 images in which the hand covers a quarter, a delta below about
    0.02 is out of reach, however good the network is.

    Only images with a hand count. Others cannot show a miss, and would lower the fraction without any evidence that
    hands are seen; without any image of a hand no delta is supported.

    The bound is an average over the pixels that count as free, most of which are far from any hand. The safety diagram
    and the miss rates per image show where the network is worse than this average.

    Args:
        counts: `safety_counts` of N images.
        n_bootstrap: number of bootstrap samples.
        level: one-sided confidence.
        seed: of the bootstrap.
    """
    counts = _with_hand(counts)
    if len(counts.count) == 0:
        return tuple(DeltaSupport(delta, 0.0, None, 1.0, None, None, False) for delta in DELTA_GRID)
    free, missed = cumulative_safety_counts(counts)
    pixels, hand = counts.count.sum(axis=1), counts.event.sum(axis=1)
    # the additional image
    free_samples = np.vstack([free, np.full((1, len(DELTA_GRID)), pixels.mean())])
    missed_samples = np.vstack([missed, np.full((1, len(DELTA_GRID)), hand.mean())])
    weights = bootstrap_weights(len(pixels) + 1, n_bootstrap, seed).astype(np.float64)
    # a sample without free pixels is no evidence for delta
    samples = np.nan_to_num(ratio(weights @ missed_samples, weights @ free_samples), nan=1.0)
    bound = np.quantile(samples, level, axis=0, method="higher")
    miss_rate = missed / hand[:, None]
    occupied = ratio(missed.sum(axis=0), free.sum(axis=0))
    holds = bound <= np.array(DELTA_GRID)
    supported = np.logical_and.accumulate(holds[::-1])[::-1]
    return tuple(
        DeltaSupport(
            delta=delta,
            free_fraction=float(free[:, k].sum() / pixels.sum()),
            occupied_fraction=None if np.isnan(occupied[k]) else float(occupied[k]),
            upper_bound=float(bound[k]),
            miss_rate_mean=float(miss_rate[:, k].mean()),
            miss_rate_worst=float(miss_rate[:, k].max()),
            supported=bool(supported[k]),
        )
        for k, delta in enumerate(DELTA_GRID)
    )


def held_out_support(
    counts: BinCounts,
    fits: Sequence[BinCounts],
    held_out: Sequence[NDArray[np.intp]],
    *,
    n_bootstrap: int = 2000,
    level: float = 0.95,
    seed: int = 0,
) -> HeldOutDelta:
    """Evaluate the smallest supported delta on images that it was not fitted on.

    Args:
        counts: `safety_counts` of N images; only those with a hand are evaluated.
        fits: counts of the images of each fit.
        held_out: for each fit, the indices into ``counts`` of the images to evaluate it on.
        n_bootstrap, level, seed: of `delta_support`.
    """
    free, missed = cumulative_safety_counts(counts)
    has_hand = counts.event.sum(axis=1) > 0
    deltas: list[float] = []
    n_free = n_missed = 0
    for fit, images in zip(fits, held_out, strict=True):
        delta = smallest_supported_delta(delta_support(fit, n_bootstrap=n_bootstrap, level=level, seed=seed))
        if delta is not None:
            k, counted = DELTA_GRID.index(delta), images[has_hand[images]]
            deltas.append(delta)
            n_free += int(free[counted, k].sum())
            n_missed += int(missed[counted, k].sum())
    return HeldOutDelta(
        n_fits=len(fits),
        n_without_delta=len(fits) - len(deltas),
        lowest=min(deltas, default=None),
        highest=max(deltas, default=None),
        free_fraction=n_free / max(int(counts.count[has_hand].sum()), 1),
        occupied_fraction=n_missed / n_free if n_free else None,
    )


def cumulative_safety_counts(counts: BinCounts) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Count, per image and delta, the pixels with p_occupied <= delta and how many of them are occupied.

    Args:
        counts: `safety_counts` of N images.

    Returns:
        two arrays (N, len(DELTA_GRID)).
    """
    free = np.cumsum(counts.count, axis=1, dtype=np.float64)[:, :-1]
    return free, np.cumsum(counts.event, axis=1, dtype=np.float64)[:, :-1]


def _with_hand(counts: BinCounts) -> BinCounts:
    return counts.take(np.flatnonzero(counts.event.sum(axis=1)))


def smallest_supported_delta(support: tuple[DeltaSupport, ...]) -> float | None:
    """Return the smallest delta that is supported together with all larger ones; None without one."""
    return min((row.delta for row in support if row.supported), default=None)


def require_supported_delta(delta: float, calibration: Calibration) -> None:
    """Refuse to plan with a smaller delta than the ensemble's test images support.

    Raises:
        SettingsError: names ``delta``, the smallest supported delta, and the remedy.
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
