"""The labeled images at the working size of a compared scheme."""

import dataclasses
import functools
from typing import TypeAlias

import cv2
import numpy as np

from deltasafe.perception.data.labeled_images import LabeledImageSet
from deltasafe.perception.data.labeled_pair import resize_labeled

MAX_PIXELS = 2**21
"""Of an original in memory; every preset makes smaller images."""

Variant: TypeAlias = tuple[np.ndarray, np.ndarray, list[dict[str, object]]]
"""Image, mask, and the operations that were applied, as a compared scheme returns them."""


@dataclasses.dataclass(frozen=True)
class Originals:
    """All originals, resized.

    Attributes:
        ids: of the labeled images, in their order.
        images: ``(n, H, W, 3)`` uint8, RGB.
        masks: ``(n, H, W)`` uint8, 1 = hand.
    """

    ids: tuple[str, ...]
    images: np.ndarray
    masks: np.ndarray

    @classmethod
    def load(cls, labeled: LabeledImageSet, width: int, height: int) -> "Originals":
        """Read all labeled images at ``width`` x ``height``.

        Raises:
            DataError: an image is missing or defective.
        """
        pairs = [crop_and_resize(*labeled.read(i, MAX_PIXELS), width, height) for i in range(len(labeled))]
        images, masks = (np.stack(arrays) for arrays in zip(*pairs, strict=True))
        return cls(tuple(item.id for item in labeled.items), images, masks)

    @functools.cached_property
    def mean_color(self) -> np.ndarray:
        """``(3,)`` uint8: the mean over all pixels of all originals."""
        return np.rint(self.images.reshape(-1, 3).mean(axis=0)).astype(np.uint8)


def crop_and_resize(rgb: np.ndarray, mask: np.ndarray, width: int, height: int) -> tuple[np.ndarray, np.ndarray]:
    """Crop image and mask to the largest region of the new aspect ratio around the hand; resize it.

    Args:
        rgb: ``(H, W, 3)``.
        mask: ``(H, W)``; without a hand, the region is centered in the image.
        width: of the result, in pixels.
        height: of the result, in pixels.
    """
    rows, columns = mask.shape
    scale = min(columns / width, rows / height)
    w, h = min(columns, round(width * scale)), min(rows, round(height * scale))
    x, y = _start(np.flatnonzero(mask.any(axis=0)), columns, w), _start(np.flatnonzero(mask.any(axis=1)), rows, h)
    crop = np.s_[y : y + h, x : x + w]
    interpolation = cv2.INTER_AREA if scale > 1 else cv2.INTER_LINEAR
    return resize_labeled(rgb[crop], mask[crop], (width, height), interpolation)


def _start(marked: np.ndarray, size: int, length: int) -> int:
    """Start of the part of ``length`` of a line of ``size`` that is centered at its ``marked`` indices, if any."""
    middle = (int(marked[0]) + int(marked[-1]) + 1) // 2 if marked.size else size // 2
    return min(max(middle - length // 2, 0), size - length)
