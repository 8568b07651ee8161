"""Cutout (DeVries and Taylor 2017, arXiv 1708.04552): a square of the image is hidden, the labels do not change."""

import numpy as np

from deltasafe.perception.data.schemes.originals import Originals, Variant
from deltasafe.perception.data.schemes.settings import CutoutSettings


def cutout(originals: Originals, i: int, settings: CutoutSettings, rng: np.random.Generator) -> Variant:
    """Fill a square of the ``i``-th original with the mean color of all originals.

    The center is a pixel drawn uniformly, so part of the square may lie outside. The mask does not change, as in the
    authors' code.
    """
    image = originals.images[i].copy()
    height, width = image.shape[:2]
    side = round(settings.side * min(height, width))
    y, x = int(rng.integers(height)), int(rng.integers(width))
    top, left = y - side // 2, x - side // 2
    image[max(0, top) : top + side, max(0, left) : left + side] = originals.mean_color
    return image, originals.masks[i], [{"method": "cutout", "top": top, "left": left, "side": side}]
