"""The four measures of section V-A (PA, mIoU, BS, NLL), scored per image on all pixels and then aggregated.

The definitions of this project live here and nowhere else (decision 3):

- a pixel is *predicted occupied* when ``p_occupied >= 0.5`` (an exact 0.5 counts as occupied);
- PA, pixel accuracy: share of pixels predicted right; mean over images;
- mIoU: mean of the IoU of hand and of background in an image; mean over images. A class that neither label
  nor prediction shows agrees perfectly and has IoU 1; one that only the other shows has IoU 0;
- BS, Brier score: mean over all pixels of (p_occupied - occupied)^2, one class;
- NLL: mean over all pixels of -log of the probability given to the true class, in nats, with ``p_occupied``
  clipped to [1e-7, 1 - 1e-7];
- missed-hand rate: share of an image's hand pixels that are predicted free; undefined without a hand;
- "+-" is one standard deviation over members (n - 1 in the denominator).

Hence BS >= (1 - PA) / 4 whenever all images are equally large: a wrong pixel costs at least 1/4.
"""

import dataclasses
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from deltasafe.errors import SettingsError

__all__ = [
    "NLL_CLIP",
    "ImageScores",
    "MeanAndSd",
    "Scores",
    "bootstrap_scores",
    "mean_and_sd",
    "percentile_interval",
    "pool_scores",
    "require_label",
    "require_p_occupied",
    "score_image",
]

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
        missed_hand_rate: share of hand pixels predicted free; None without hand pixels.
        false_alarm_rate: share of background pixels predicted occupied; None without background.
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
    """PA, mIoU, BS and NLL of one predictor over a set of images (see the module for their definitions)."""

    pixel_accuracy: float
    miou: float
    brier: float
    nll: float


@dataclasses.dataclass(frozen=True)
class MeanAndSd:
    """Mean and standard deviation of ``n`` members' scores; the deviation is None for one member."""

    n: int
    mean: Scores
    sd: Scores | None


def require_label(label: NDArray[np.generic]) -> NDArray[np.bool_]:
    """(H, W) bool, True = hand, of a mask given as bool, as 0/1 or as 0/255.

    Raises:
        SettingsError: the mask is not two-dimensional, is empty, or has another value.
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
    """``p_occupied`` as float64.

    Raises:
        SettingsError: a shape other than the label's, a value that is not finite or outside [0, 1].
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


def score_image(p_occupied: NDArray[np.floating], label: NDArray[np.generic]) -> ImageScores:
    """Score one prediction on one image, on all pixels, accumulated in float64.

    Args:
        p_occupied: (H, W) probability of each pixel to be hand.
        label: (H, W) bool, or uint8 with 255 (or 1) for hand.

    Raises:
        SettingsError: see `require_label` and `require_p_occupied`.
    """
    occupied = require_label(label)
    p = require_p_occupied(p_occupied, occupied.shape)
    predicted = p >= 0.5
    n, n_hand, n_predicted = p.size, int(occupied.sum()), int(predicted.sum())
    hit = int((occupied & predicted).sum())
    missed, false_alarm = n_hand - hit, n_predicted - hit
    clear = n - hit - missed - false_alarm
    p_true = np.where(occupied, p, 1.0 - p).clip(NLL_CLIP, 1.0 - NLL_CLIP)
    return ImageScores(
        n_pixels=n,
        n_hand_pixels=n_hand,
        pixel_accuracy=(hit + clear) / n,
        miou=(_iou(hit, n - clear) + _iou(clear, n - hit)) / 2,
        brier=float(np.square(p - occupied).mean()),
        nll=float(-np.log(p_true).mean()),
        missed_hand_rate=missed / n_hand if n_hand else None,
        false_alarm_rate=false_alarm / (n - n_hand) if n > n_hand else None,
    )


def pool_scores(images: Sequence[ImageScores], weights: Sequence[float] | None = None) -> Scores:
    """Aggregate over images: PA and mIoU as means over images, BS and NLL as means over all pixels.

    Args:
        images: scores of N >= 1 images.
        weights: (N,) how often each image counts (the multiplicities of a bootstrap sample); once by default.
    """
    weight = np.ones(len(images)) if weights is None else np.asarray(weights, dtype=np.float64)
    return Scores(*bootstrap_scores(images, weight[None])[0].tolist())


def bootstrap_scores(images: Sequence[ImageScores], weights: NDArray[np.number]) -> NDArray[np.float64]:
    """(R, 4) PA, mIoU, BS and NLL, as `pool_scores`, of R bootstrap samples of the images.

    The rows of two predictors on the same images and weights are paired: their difference is the sample of the
    difference.

    Args:
        images: scores of N >= 1 images.
        weights: (R, N) how often each image occurs in each sample.
    """
    if not images:
        raise SettingsError("scores need at least one image")
    n_pixels, *table = np.transpose(
        [(image.n_pixels, image.pixel_accuracy, image.miou, image.brier, image.nll) for image in images]
    )
    each_image = weights @ np.transpose(table[:2]) / weights.sum(axis=1, keepdims=True)
    pixels = weights * n_pixels
    each_pixel = pixels @ np.transpose(table[2:]) / pixels.sum(axis=1, keepdims=True)
    return np.hstack([each_image, each_pixel])


def percentile_interval(drawn: NDArray[np.float64], level: float) -> tuple[Scores, Scores]:
    """Two-sided percentile interval of ``drawn`` (R, 4), the rows of `bootstrap_scores`: its lower and upper ends."""
    low, high = np.quantile(drawn, [(1 - level) / 2, (1 + level) / 2], axis=0)
    return Scores(*low.tolist()), Scores(*high.tolist())


def mean_and_sd(members: Sequence[Scores]) -> MeanAndSd:
    """Mean and one standard deviation over M >= 1 members."""
    table = np.array([dataclasses.astuple(scores) for scores in members], dtype=np.float64)
    if len(table) == 0:
        raise SettingsError("the mean over members needs at least one member")
    sd = Scores(*(float(value) for value in table.std(axis=0, ddof=1))) if len(table) > 1 else None
    return MeanAndSd(len(table), Scores(*(float(value) for value in table.mean(axis=0))), sd)


def _iou(intersection: int, union: int) -> float:
    return intersection / union if union else 1.0
