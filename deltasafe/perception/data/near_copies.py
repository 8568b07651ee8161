"""Find near copies: one photograph re-encoded, scaled, brightened, turned gray, mirrored or cropped by a few percent.

Compared are thumbnails of 16 x 16 pixels, of the gray image and of the mask, by normalized correlation. The mask has to
agree as well: a mounted camera sees the same table in all its photographs, and only the hand is elsewhere.
"""

import dataclasses

import numpy as np
from numpy.typing import NDArray

from deltasafe.perception.data.labeled_images import LabeledImage, LabeledImageSet

IMAGE_CORRELATION, MASK_CORRELATION = 0.95, 0.8
"""Smallest correlations of a near copy. Different packaged images reach at most 0.82 across the two sets (D77)."""
_SHOWN = 5


@dataclasses.dataclass(frozen=True)
class NearCopy:
    """Two images that show nearly the same.

    Attributes:
        image, original: of the one set and the other.
        correlation: of their gray thumbnails.
        mirrored: whether one has to be mirrored.
    """

    image: LabeledImage
    original: LabeledImage
    correlation: float
    mirrored: bool

    def __str__(self) -> str:
        mirrored = " mirrored" if self.mirrored else ""
        return f"{self.image.image.name} of {self.original.image.name}{mirrored} ({self.correlation:.3f})"


def near_copies(images: LabeledImageSet, others: LabeledImageSet | None = None) -> list[NearCopy]:
    """List images that are near copies of one in ``others``, each with the most similar one.

    Args:
        images: for example a test set.
        others: for example a training set; without it, near copies within ``images`` are listed.
    """
    one, two = images.thumbnails, (images if others is None else others).thumbnails
    both = np.stack([_similarity(one, two), _similarity(one, two[..., ::-1])])
    if others is None:
        both = np.where(np.tri(len(one), len(one), -1, dtype=bool), both, 0.0)
    if both.size == 0:
        return []
    best = both.max(axis=0).argmax(axis=1)
    return [
        NearCopy(
            images.items[i],
            (images if others is None else others).items[j],
            float(both[:, i, j].max()),
            bool(both[1, i, j] > both[0, i, j]),
        )
        for i, j in enumerate(best)
        if both[:, i, j].max() > 0.0
    ]


def listed(pairs: list[NearCopy]) -> str:
    """Join the first pairs to one line."""
    rest = f"; and {len(pairs) - _SHOWN} more" if len(pairs) > _SHOWN else ""
    return "; ".join(map(str, pairs[:_SHOWN])) + rest


def _similarity(one: NDArray[np.float32], two: NDArray[np.float32]) -> NDArray[np.float64]:
    """Return (N, K): the correlation of the images, 0 where image or mask correlate too little."""
    image, mask = (_correlation(one[:, part], two[:, part]) for part in (0, 1))
    largest_one, largest_two = (thumbnails[:, 1].max(axis=(1, 2), initial=0.0) for thumbnails in (one, two))
    empty = np.maximum.outer(largest_one, largest_two) == 0.0
    return np.where((image >= IMAGE_CORRELATION) & (empty | (mask >= MASK_CORRELATION)), image, 0.0)


def _correlation(one: NDArray[np.float32], two: NDArray[np.float32]) -> NDArray[np.float64]:
    """Return the normalized correlation (N, K) of pictures (N, H, W) and (K, H, W); 0 with a uniform one."""
    a, b = (_standardized(pictures) for pictures in (one, two))
    return np.asarray(a @ b.T)


def _standardized(pictures: NDArray[np.float32]) -> NDArray[np.float64]:
    flat = pictures.reshape(len(pictures), -1).astype(np.float64)
    flat -= flat.mean(axis=1, keepdims=True)
    norm = np.linalg.norm(flat, axis=1, keepdims=True)
    return np.divide(flat, norm, out=np.zeros_like(flat), where=norm > 0)
