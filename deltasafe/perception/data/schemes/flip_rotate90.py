"""Flip and 90 degree rotation (Nanni et al. 2021, decision 9): the eight symmetries of the square."""

import dataclasses

import numpy as np

from deltasafe.perception.data.schemes.originals import Originals
from deltasafe.perception.data.schemes.settings import FlipRotate90Settings

__all__ = ["FlipRotate90", "padded_to_square", "symmetry"]


@dataclasses.dataclass(frozen=True)
class FlipRotate90:
    """One of the eight, uniformly and with replacement: 50 originals have at most 400 distinct variants.

    Every image is padded to a square before, by repeating its border in image and mask alike, so that the arm
    goes on in both; nothing is scaled, so the symmetries are exact.
    """

    originals: Originals
    settings: FlipRotate90Settings

    def make(self, i: int, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray, list[dict[str, object]]]:
        """Image, mask, and what was done, for one variant of the ``i``-th original."""
        flipped, quarter_turns = bool(rng.integers(2)), int(rng.integers(4))
        image, mask = (
            symmetry(padded_to_square(pixels[i]), flipped, quarter_turns)
            for pixels in (self.originals.images, self.originals.masks)
        )
        return image, mask, [{"method": "flip", "applied": flipped}, {"method": "rotation", "quarters": quarter_turns}]


def padded_to_square(pixels: np.ndarray) -> np.ndarray:
    """``(S, S, ...)`` with the ``(H, W, ...)`` pixels in the middle and their border repeated around them."""
    height, width = pixels.shape[:2]
    side = max(height, width)
    around = [((side - n) // 2, side - n - (side - n) // 2) for n in (height, width)]
    return np.pad(pixels, [*around, *[(0, 0)] * (pixels.ndim - 2)], mode="edge")


def symmetry(pixels: np.ndarray, flipped: bool, quarter_turns: int) -> np.ndarray:
    """Mirror left-right, or not, and turn counter-clockwise by quarters: all eight elements of D4."""
    return np.rot90(np.fliplr(pixels) if flipped else pixels, quarter_turns)
