"""Mixup (Zhang et al. 2018): two images are blended, and so are their labels. Also the format of soft masks."""

import numpy as np
from numpy.typing import NDArray

from deltasafe.perception.data.schemes.originals import Originals, Variant
from deltasafe.perception.data.schemes.settings import MixupSettings

SOFT_MASK_MAX = np.uint16(65535)
"""Soft masks are 16-bit fixed point: 0 = no hand, 65535 = hand."""


def mixup(originals: Originals, i: int, settings: MixupSettings, rng: np.random.Generator) -> Variant:
    """Return lambda x_i + (1 - lambda) x_j, with lambda from Beta(alpha, alpha) and another original j, uniform.

    Cross-entropy is linear in the label, so training on the soft mask minimizes the authors' loss,
    lambda CE(y_i) + (1 - lambda) CE(y_j).
    """
    n = len(originals.ids)
    j = (i + 1 + int(rng.integers(n - 1))) % n if n > 1 else i
    weight = float(rng.beta(settings.alpha, settings.alpha))
    image = np.rint(_blend(originals.images, i, j, weight)).astype(np.uint8)
    mask = np.rint(_blend(originals.masks, i, j, weight) * SOFT_MASK_MAX).astype(np.uint16)
    return image, mask, [{"method": "mixup", "partner": originals.ids[j], "share": weight}]


def soft_labels(masks: NDArray[np.generic]) -> NDArray[np.float32]:
    """Labels in [0, 1] (float32) of hard masks (uint8, 0 or 1) or soft masks (uint16)."""
    labels = masks.astype(np.float32)
    return labels / np.float32(SOFT_MASK_MAX) if masks.dtype == np.uint16 else labels


def _blend(pixels: np.ndarray, i: int, j: int, weight: float) -> np.ndarray:
    return np.asarray(weight * pixels[i].astype(np.float64) + (1 - weight) * pixels[j])
