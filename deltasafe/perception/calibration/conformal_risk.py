"""How much of a hand may a planner drive through? Conformal risk control (Angelopoulos et al. 2022).

A pixel counts as free when ``p_occupied <= threshold``. An image's loss is the share of its hand pixels that count as
free: it lies in [0, 1] and never falls as the threshold rises. The largest threshold with

    n / (n + 1) * (mean loss of n images) + 1 / (n + 1)  <=  alpha

has an expected loss of at most alpha in one further image, whatever the network and the images, as long as that image
is exchangeable with the n (theorem 1 there). The expectation is over the n images as well: it is a mean over images
and over repetitions, no bound for each image. ``alpha`` is chosen before the images are looked at. Since the further
image may be missed entirely, n images certify nothing below 1 / (n + 1), however good the network is.

An increasing function of p_occupied, such as a temperature, changes the threshold but not the pixels below it. The
threshold is therefore fitted on the pooled probability as it is and carried through the temperature: the guarantee
does not care where the temperature comes from.
"""

import dataclasses

import numpy as np
from numpy.typing import NDArray
from scipy.special import expit

from deltasafe.errors import SettingsError
from deltasafe.perception.calibration.metrics import require_label, require_p_occupied

__all__ = [
    "THRESHOLD_GRID",
    "RiskControl",
    "conformal_threshold",
    "control_risk",
    "leave_one_out_loss",
    "missed_hand_shares",
]

THRESHOLD_GRID: NDArray[np.float64] = expit(np.arange(-1600, 1601) / 100)
"""(3201,) thresholds that are tried, 1 % apart in odds, from 1e-7 to 1 - 1e-7. The theorem holds for any fixed grid."""


@dataclasses.dataclass(frozen=True)
class RiskControl:
    """A threshold and what it promises.

    Attributes:
        alpha: bound on the expected share of a hand's pixels with ``p_occupied <= threshold``.
        n_images: images with a hand that the threshold was fitted on.
        threshold: None if alpha is below 1 / (n + 1), or the hand is missed too often at any threshold.
        held_out_mean: mean share on images that the threshold was not fitted on; None without one.
        held_out_worst: the same, in the worst of them.
    """

    alpha: float
    n_images: int
    threshold: float | None
    held_out_mean: float | None
    held_out_worst: float | None


def missed_hand_shares(p_occupied: NDArray[np.floating], label: NDArray[np.generic]) -> NDArray[np.float64] | None:
    """(K,) share of the hand's pixels with ``p_occupied <= THRESHOLD_GRID[k]`` in one image; None without a hand."""
    occupied = require_label(label)
    hand = require_p_occupied(p_occupied, occupied.shape)[occupied]
    if hand.size == 0:
        return None
    bins = np.searchsorted(THRESHOLD_GRID, hand, side="left")
    below: NDArray[np.float64] = np.cumsum(np.bincount(bins, minlength=len(THRESHOLD_GRID) + 1))[:-1] / hand.size
    return below


def conformal_threshold(losses: NDArray[np.float64], alpha: float) -> float | None:
    """The largest threshold of the grid whose expected loss in a further image is at most ``alpha``.

    Args:
        losses: (n, K) `missed_hand_shares` of n images.
        alpha: target, chosen beforehand.

    Returns:
        None if no threshold of the grid will do, as always for alpha < 1 / (n + 1).

    Raises:
        SettingsError: alpha outside (0, 1).
    """
    index = _largest(np.sum(losses, axis=0), len(losses), alpha)
    return None if index < 0 else float(THRESHOLD_GRID[index])


def leave_one_out_loss(losses: NDArray[np.float64], alpha: float) -> NDArray[np.float64]:
    """(n,) loss of each image at the threshold that the n - 1 others give; 0 where they give none.

    Each is a draw of what the theorem is about, so that their mean should be at most alpha.
    """
    total = losses.sum(axis=0)
    chosen = [_largest(total - loss, len(losses) - 1, alpha) for loss in losses]
    return np.array([loss[index] if index >= 0 else 0.0 for loss, index in zip(losses, chosen, strict=True)])


def control_risk(losses: NDArray[np.float64], alpha: float, held_out: NDArray[np.float64] | None = None) -> RiskControl:
    """Fit a threshold and show what became of it on images that it was not fitted on.

    Args:
        losses: (n, K) of the images to fit on.
        alpha: target.
        held_out: (m, K) of further images; without them each of the n is judged by the threshold of the others.
    """
    threshold = conformal_threshold(losses, alpha)
    seen = None
    if threshold is not None and held_out is not None:
        seen = held_out[:, int(np.searchsorted(THRESHOLD_GRID, threshold))]
    elif held_out is None and alpha * len(losses) >= 1:
        seen = leave_one_out_loss(losses, alpha)
    if seen is None or len(seen) == 0:
        return RiskControl(alpha, len(losses), threshold, None, None)
    return RiskControl(alpha, len(losses), threshold, float(seen.mean()), float(seen.max()))


def _largest(total: NDArray[np.float64], n_images: int, alpha: float) -> int:
    """Index of the largest threshold at which ``total`` loss of n images is small enough; -1 without one."""
    if not 0.0 < alpha < 1.0:
        raise SettingsError(f"alpha must lie in (0, 1), got {alpha}")
    allowed = (total + 1.0) / (n_images + 1) <= alpha
    return int(np.argmin(allowed)) - 1 if not allowed.all() else len(allowed) - 1
