"""Flip and 90 degree rotation (Nanni et al. 2021, decision 9): the eight symmetries of the square."""

import numpy as np

from deltasafe.perception.data.schemes.originals import Originals, Variant
from deltasafe.perception.data.schemes.settings import FlipRotate90Settings


def flip_rotate90(originals: Originals, i: int, settings: FlipRotate90Settings, rng: np.random.Generator) -> Variant:
    """Apply one of the eight symmetries, uniform and with replacement: 50 originals have at most 400 variants.

    Images are first padded to a square by repeating their border, in image and mask alike, so that the arm continues
    in both. Nothing is scaled, so the symmetries are exact.
    """
    flipped, quarter_turns = bool(rng.integers(2)), int(rng.integers(4))
    image, mask = (
        apply_symmetry(pad_to_square(pixels[i]), flipped, quarter_turns)
        for pixels in (originals.images, originals.masks)
    )
    return image, mask, [{"method": "flip", "applied": flipped}, {"method": "rotation", "quarters": quarter_turns}]


def pad_to_square(pixels: np.ndarray) -> np.ndarray:
    """Center ``(H, W, ...)`` pixels in a square and repeat their border around them."""
    height, width = pixels.shape[:2]
    side = max(height, width)
    padding = [((side - n) // 2, side - n - (side - n) // 2) for n in (height, width)]
    return np.pad(pixels, [*padding, *[(0, 0)] * (pixels.ndim - 2)], mode="edge")


def apply_symmetry(pixels: np.ndarray, flipped: bool, quarter_turns: int) -> np.ndarray:
    """Mirror left-right if ``flipped``, then rotate counter-clockwise: all eight elements of the group D4."""
    return np.rot90(np.fliplr(pixels) if flipped else pixels, quarter_turns)
