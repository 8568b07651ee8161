"""Conformal risk control: bound the missed fraction of a hand in a new image (Angelopoulos et al. 2022).

A pixel counts as free if ``p_occupied <= threshold``. The loss of an image is the fraction of its hand pixels that
count as free. It lies in [0, 1] and is non-decreasing in the threshold. For the largest threshold with

    n / (n + 1) * (mean loss of n images) + 1 / (n + 1)  <=  alpha

the expected loss in one further image is at most alpha, for any network, if that image is exchangeable with the n
images (theorem 1 of the source). The expectation is also over the n images, so this is no bound for each image.
``alpha`` is chosen before the images are evaluated. The further image may be missed completely, therefore n images
certify no alpha below 1 / (n + 1), however good the network is.

An increasing function of p_occupied, such as a temperature, changes the threshold but not the set of pixels below it.
The threshold is therefore fitted on the uncalibrated probability and mapped through the temperature. The guarantee does
not depend on how the temperature was fitted.
"""

import dataclasses

import numpy as np
from numpy.typing import NDArray
from scipy.special import expit

from deltasafe.errors import SettingsError
from deltasafe.perception.calibration.metrics import require_labeled_prediction

THRESHOLD_GRID: NDArray[np.float64] = expit(np.arange(-1600, 1601) / 100)
"""(3201,) candidate thresholds, 1 % apart in odds, from 1e-7 to 1 - 1e-7. The theorem holds for any fixed grid."""


@dataclasses.dataclass(frozen=True)
class RiskControl:
    """A threshold and its guarantee.

    Attributes:
        alpha: bound on the expected fraction of a hand's pixels with ``p_occupied <= threshold``.
        n_images: images with a hand that the threshold was fitted on.
        threshold: None if alpha is below 1 / (n + 1), or the loss is too large at every threshold.
        held_out_mean: mean loss on images that the threshold was not fitted on; None without such images.
        held_out_worst: largest loss on these images.
    """

    alpha: float
    n_images: int
    threshold: float | None
    held_out_mean: float | None
    held_out_worst: float | None


def missed_fractions(p_occupied: NDArray[np.floating], label: NDArray[np.generic]) -> NDArray[np.float64] | None:
    """Compute the loss of one image at every threshold.

    Returns:
        (K,) fraction of the hand's pixels with ``p_occupied <= THRESHOLD_GRID[k]``; None without a hand.
    """
    p, occupied = require_labeled_prediction(p_occupied, label)
    hand = p[occupied]
    if hand.size == 0:
        return None
    bins = np.searchsorted(THRESHOLD_GRID, hand, side="left")
    below: NDArray[np.float64] = np.cumsum(np.bincount(bins, minlength=len(THRESHOLD_GRID) + 1))[:-1] / hand.size
    return below


def conformal_threshold(losses: NDArray[np.float64], alpha: float) -> float | None:
    """Find the largest threshold of the grid whose expected loss in a further image is at most ``alpha``.

    Args:
        losses: (n, K) `missed_fractions` of n images.
        alpha: target, chosen in advance.

    Returns:
        None if no threshold of the grid satisfies the bound, as always for alpha < 1 / (n + 1).

    Raises:
        SettingsError: alpha outside (0, 1).
    """
    index = _threshold_index(np.sum(losses, axis=0), len(losses), alpha)
    return None if index < 0 else float(THRESHOLD_GRID[index])


def leave_one_out_loss(losses: NDArray[np.float64], alpha: float) -> NDArray[np.float64]:
    """Evaluate each image at the threshold fitted on the n - 1 others.

    By the theorem the mean should be at most alpha.

    Returns:
        (n,) losses; 0 where the others give no threshold.
    """
    total = losses.sum(axis=0)
    chosen = [_threshold_index(total - loss, len(losses) - 1, alpha) for loss in losses]
    return np.array([loss[index] if index >= 0 else 0.0 for loss, index in zip(losses, chosen, strict=True)])


def control_risk(losses: NDArray[np.float64], alpha: float, held_out: NDArray[np.float64] | None = None) -> RiskControl:
    """Fit a threshold and evaluate it on images that it was not fitted on.

    Args:
        losses: (n, K) of the images to fit on.
        alpha: target.
        held_out: (m, K) of further images. Without them, each of the n images is evaluated by leave-one-out.
    """
    threshold = conformal_threshold(losses, alpha)
    held_out_losses = None
    if threshold is not None and held_out is not None:
        held_out_losses = held_out[:, int(np.searchsorted(THRESHOLD_GRID, threshold))]
    elif held_out is None and alpha * len(losses) >= 1:
        held_out_losses = leave_one_out_loss(losses, alpha)
    if held_out_losses is None or len(held_out_losses) == 0:
        return RiskControl(alpha, len(losses), threshold, None, None)
    return RiskControl(alpha, len(losses), threshold, float(held_out_losses.mean()), float(held_out_losses.max()))


def _threshold_index(total: NDArray[np.float64], n_images: int, alpha: float) -> int:
    """Find the largest threshold that satisfies the bound, given the summed loss of n images; -1 without one."""
    if not 0.0 < alpha < 1.0:
        raise SettingsError(f"alpha must lie in (0, 1), got {alpha}")
    allowed = (total + 1.0) / (n_images + 1) <= alpha
    return int(np.argmin(allowed)) - 1 if not allowed.all() else len(allowed) - 1
