"""The four metrics of section V-A (PA, mIoU, BS, NLL): scored per image on all pixels, then aggregated over images.

All metrics of this project are defined here (decision 3):

- a pixel is *predicted occupied* if ``p_occupied >= 0.5`` (an exact 0.5 counts as occupied);
- PA, pixel accuracy: fraction of correctly classified pixels; mean over images;
- mIoU: mean of the IoU of hand and of background in an image; mean over images. A class that appears in neither label
  nor prediction has IoU 1; a class that appears in only one of them has IoU 0;
- BS, Brier score: mean over all pixels of (p_occupied - occupied)^2, one class;
- NLL: mean over all pixels of -log of the probability of the true class, in nats, with ``p_occupied`` clipped to
  [1e-7, 1 - 1e-7];
- an image without a hand counts in PA, mIoU, BS and NLL: its IoU of hand is 1 without false alarms, else 0;
- missed-hand rate: fraction of an image's hand pixels that are predicted free; undefined without a hand;
- "+-" is one standard deviation over members (n - 1 in the denominator).

If all images have the same size, BS >= (1 - PA) / 4, because a misclassified pixel contributes at least 1/4.
"""

import dataclasses
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from deltasafe.errors import SettingsError

NLL_CLIP = 1e-7


@dataclasses.dataclass(frozen=True)
class ImageScores:
    """Scores of one prediction on one image.

    Attributes:
        n_pixels: pixels of the image.
        n_hand_pixels: pixels whose label is occupied.
        pixel_accuracy: PA of the image, in [0, 1].
        miou: mean IoU of hand and background, in [0, 1].
        brier: mean squared error over the pixels of the image.
        nll: mean negative log-likelihood over the pixels of the image, nats.
        missed_hand_rate: fraction of hand pixels predicted free; None without hand pixels.
        false_alarm_rate: fraction of background pixels predicted occupied; None without background.
    """

    n_pixels: int
    n_hand_pixels: int
    pixel_accuracy: float
    miou: float
    brier: float
    nll: float
    missed_hand_rate: float | None
    false_alarm_rate: float | None


@dataclasses.dataclass(frozen=True)
class Scores:
    """PA, mIoU, BS and NLL of one predictor over a set of images (definitions: module docstring)."""

    pixel_accuracy: float
    miou: float
    brier: float
    nll: float


@dataclasses.dataclass(frozen=True)
class MeanAndSd:
    """Mean and standard deviation of the scores of ``n`` members; ``sd`` is None for a single member."""

    n: int
    mean: Scores
    sd: Scores | None


def require_label(label: NDArray[np.generic]) -> NDArray[np.bool_]:
    """Convert a mask of bool, 0/1 or 0/255 to (H, W) bool, True = hand.

    Raises:
        SettingsError: the mask is not two-dimensional, is empty, or contains another value.
    """
    label = np.asarray(label)
    if label.ndim != 2 or label.size == 0:
        raise SettingsError(f"a label must have shape (H, W), got {label.shape}")
    if label.dtype == np.bool_:
        return np.asarray(label, dtype=np.bool_)
    occupied = label != 0
    if not np.isin(label[occupied], (1, 255)).all() or len(np.unique(label[occupied])) > 1:
        raise SettingsError(
            f"a label holds 0 for background and 255 (or 1) for hand, got {np.unique(label)[:8].tolist()}; "
            "threshold the mask, and store it without lossy compression"
        )
    return occupied


def require_p_occupied(p_occupied: NDArray[np.floating], shape: tuple[int, ...] | None = None) -> NDArray[np.float64]:
    """Convert ``p_occupied`` to float64.

    Raises:
        SettingsError: the shape is not that of the label; a value is not finite or outside [0, 1].
    """
    if not np.issubdtype(np.asarray(p_occupied).dtype, np.floating):
        raise SettingsError(f"p_occupied must be floating point, got {np.asarray(p_occupied).dtype}")
    p = np.asarray(p_occupied, dtype=np.float64)
    if shape is not None and p.shape != shape:
        raise SettingsError(f"p_occupied has shape {p.shape}, its label {shape}: predict at the label's resolution")
    if not (p.min() >= 0.0 and p.max() <= 1.0):
        raise SettingsError(
            f"p_occupied must lie in [0, 1], got [{p.min():g}, {p.max():g}]: pass probabilities, not logits"
        )
    return p


def require_labeled_prediction(
    p_occupied: NDArray[np.floating], label: NDArray[np.generic]
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Return (H, W) probabilities and labels of one image, checked by `require_p_occupied` and `require_label`."""
    occupied = require_label(label)
    return require_p_occupied(p_occupied, occupied.shape), occupied


def score_image(p_occupied: NDArray[np.floating], label: NDArray[np.generic]) -> ImageScores:
    """Score one prediction on all pixels of one image, accumulated in float64.

    Args:
        p_occupied: (H, W) probability of each pixel to be hand.
        label: (H, W) bool, or uint8 with 255 (or 1) for hand.

    Raises:
        SettingsError: see `require_label` and `require_p_occupied`.
    """
    p, occupied = require_labeled_prediction(p_occupied, label)
    predicted = p >= 0.5
    n, n_hand = p.size, int(occupied.sum())
    true_positives = int((occupied & predicted).sum())
    false_negatives = n_hand - true_positives
    false_positives = int(predicted.sum()) - true_positives
    true_negatives = n - n_hand - false_positives
    p_true = np.where(occupied, p, 1.0 - p).clip(NLL_CLIP, 1.0 - NLL_CLIP)
    return ImageScores(
        n_pixels=n,
        n_hand_pixels=n_hand,
        pixel_accuracy=(true_positives + true_negatives) / n,
        miou=(_iou(true_positives, n - true_negatives) + _iou(true_negatives, n - true_positives)) / 2,
        brier=float(np.square(p - occupied).mean()),
        nll=float(-np.log(p_true).mean()),
        missed_hand_rate=false_negatives / n_hand if n_hand else None,
        false_alarm_rate=false_positives / (n - n_hand) if n > n_hand else None,
    )


def pool_scores(images: Sequence[ImageScores]) -> Scores:
    """Aggregate over N >= 1 images: PA and mIoU as means over images, BS and NLL as means over all pixels."""
    return Scores(*bootstrap_scores(images, np.ones((1, len(images))))[0].tolist())


def bootstrap_scores(images: Sequence[ImageScores], weights: NDArray[np.number]) -> NDArray[np.float64]:
    """Aggregate as `pool_scores` in R bootstrap samples of the images.

    For two predictors on the same images and weights, the difference of the results is the paired bootstrap of the
    difference.

    Args:
        images: scores of N >= 1 images.
        weights: (R, N) multiplicity of each image in each sample.

    Returns:
        (R, 4) PA, mIoU, BS and NLL.
    """
    if not images:
        raise SettingsError("scores need at least one image")
    n_pixels, *table = np.transpose(
        [(image.n_pixels, image.pixel_accuracy, image.miou, image.brier, image.nll) for image in images]
    )
    image_means = weights @ np.transpose(table[:2]) / weights.sum(axis=1, keepdims=True)
    pixels = weights * n_pixels
    pixel_means = pixels @ np.transpose(table[2:]) / pixels.sum(axis=1, keepdims=True)
    return np.hstack([image_means, pixel_means])


def percentile_interval(samples: NDArray[np.float64], level: float) -> tuple[Scores, Scores]:
    """Compute both ends of the two-sided percentile interval of ``samples`` (R, 4), rows of `bootstrap_scores`."""
    low, high = np.quantile(samples, [(1 - level) / 2, (1 + level) / 2], axis=0)
    return Scores(*low.tolist()), Scores(*high.tolist())


def mean_and_sd(members: Sequence[Scores]) -> MeanAndSd:
    """Compute mean and one standard deviation over M >= 1 members."""
    if not members:
        raise SettingsError("the mean over members needs at least one member")
    table = np.array([dataclasses.astuple(scores) for scores in members], dtype=np.float64)
    sd = Scores(*table.std(axis=0, ddof=1).tolist()) if len(table) > 1 else None
    return MeanAndSd(len(table), Scores(*table.mean(axis=0).tolist()), sd)


def _iou(intersection: int, union: int) -> float:
    return intersection / union if union else 1.0
