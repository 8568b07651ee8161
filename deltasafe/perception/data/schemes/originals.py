"""The labeled images at the size that a compared scheme works at."""

import dataclasses
import functools

import cv2
import numpy as np

from deltasafe.perception.data.labeled_images import LabeledImageSet

__all__ = ["Originals", "mask_of_coverage", "reduced"]


@dataclasses.dataclass(frozen=True)
class Originals:
    """All originals, reduced.

    Attributes:
        ids: names, in the order of the hand set.
        images: ``(n, H, W, 3)`` uint8, RGB.
        masks: ``(n, H, W)`` uint8, 1 = hand.
    """

    ids: tuple[str, ...]
    images: np.ndarray
    masks: np.ndarray

    @classmethod
    def of(cls, hands: LabeledImageSet, width: int, height: int) -> "Originals":
        """Read all of ``hands`` at ``width`` x ``height``.

        Raises:
            DataError: an image is missing or defective.
        """
        pairs = [reduced(*hands.read(i), width, height) for i in range(len(hands))]
        images, masks = (np.stack(arrays) for arrays in zip(*pairs, strict=True))
        return cls(tuple(item.id for item in hands.items), images, masks)

    @functools.cached_property
    def mean_color(self) -> np.ndarray:
        """``(3,)`` uint8: the mean over all pixels of all originals."""
        return np.rint(self.images.reshape(-1, 3).mean(axis=0)).astype(np.uint8)


def reduced(rgb: np.ndarray, mask: np.ndarray, width: int, height: int) -> tuple[np.ndarray, np.ndarray]:
    """Image and mask at ``width`` x ``height``: the largest middle section of that aspect ratio, scaled.

    A pixel of the mask is hand where at least half of it is covered by hand.
    """
    rows, columns = mask.shape
    scale = min(columns / width, rows / height)
    w, h = min(columns, round(width * scale)), min(rows, round(height * scale))
    x, y = (columns - w) // 2, (rows - h) // 2
    how = cv2.INTER_AREA if scale > 1 else cv2.INTER_LINEAR
    small = cv2.resize(rgb[y : y + h, x : x + w], (width, height), interpolation=how)
    coverage = cv2.resize(mask[y : y + h, x : x + w].astype(np.float32), (width, height), interpolation=how)
    return small, mask_of_coverage(coverage)


def mask_of_coverage(coverage: np.ndarray) -> np.ndarray:
    """uint8, 1 where at least half of a pixel is hand."""
    return (coverage >= 0.5).astype(np.uint8)
