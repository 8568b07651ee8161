"""Cutout (DeVries and Taylor 2017, arXiv 1708.04552): a square of the image is hidden, the labels stay."""

import dataclasses

import numpy as np

from deltasafe.perception.data.schemes.originals import Originals
from deltasafe.perception.data.schemes.settings import CutoutSettings

__all__ = ["Cutout"]


@dataclasses.dataclass(frozen=True)
class Cutout:
    """The square's middle is a pixel, uniform over the image, so part of the square may lie outside.

    What it hides gets the mean color of the originals. The mask is unchanged, as in the authors' code.
    """

    originals: Originals
    settings: CutoutSettings

    def make(self, i: int, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray, list[dict[str, object]]]:
        """Image, mask, and what was done, for one variant of the ``i``-th original."""
        image = self.originals.images[i].copy()
        height, width = image.shape[:2]
        side = round(self.settings.side * min(height, width))
        y, x = int(rng.integers(height)), int(rng.integers(width))
        top, left = y - side // 2, x - side // 2
        image[max(0, top) : top + side, max(0, left) : left + side] = self.originals.mean_color
        return image, self.originals.masks[i], [{"method": "cutout", "top": top, "left": left, "side": side}]
