"""Flip, rotation by a small angle and crop (Uzun et al. 2021), each drawn for every image."""

import dataclasses

import cv2
import numpy as np

from deltasafe.perception.data.schemes.originals import Originals, mask_of_coverage
from deltasafe.perception.data.schemes.settings import FlipRotateCropSettings

__all__ = ["FlipRotateCrop", "section"]


@dataclasses.dataclass(frozen=True)
class FlipRotateCrop:
    """Mirrored or not, turned about its middle, then a section of it anywhere inside, scaled back.

    One affine map, sampled once at a multiple of the stored size. Corners that the turned image leaves open get
    its border, repeated, in image and mask alike.
    """

    originals: Originals
    settings: FlipRotateCropSettings

    def make(self, i: int, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray, list[dict[str, object]]]:
        """Image, mask, and what was done, for one variant of the ``i``-th original."""
        settings = self.settings
        flipped = bool(rng.integers(2))
        angle_deg = float(rng.uniform(-settings.largest_angle_deg, settings.largest_angle_deg))
        side = float(rng.uniform(settings.smallest_crop, 1.0))
        x, y = (float(value) for value in rng.uniform(0.0, 1.0 - side, 2))
        image, mask = self.originals.images[i], self.originals.masks[i]
        matrix = section(image.shape[1], image.shape[0], flipped, angle_deg, side, (x, y))
        image = self._stored(image, matrix)
        mask = mask_of_coverage(self._stored(mask.astype(np.float32), matrix))
        done: list[dict[str, object]] = [
            {"method": "flip", "applied": flipped},
            {"method": "rotation", "angle_deg": angle_deg},
            {"method": "cropping", "side": side, "x": x, "y": y},
        ]
        return image, mask, done

    def _stored(self, pixels: np.ndarray, matrix: np.ndarray) -> np.ndarray:
        size = (pixels.shape[1], pixels.shape[0])
        how = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
        warped = cv2.warpAffine(pixels, matrix, size, flags=how, borderMode=cv2.BORDER_REPLICATE)
        return cv2.resize(warped, (self.settings.width, self.settings.height), interpolation=cv2.INTER_AREA)


def section(
    width: int, height: int, flipped: bool, angle_deg: float, side: float, corner: tuple[float, float]
) -> np.ndarray:
    """(2, 3): where a pixel of the new picture comes from in the old one, both ``width`` x ``height``.

    Args:
        angle_deg: counter-clockwise as seen, about the middle.
        side: of the section, as a share of the picture's.
        corner: upper left corner of the section, as shares of width and height.
    """
    size, middle = np.array([width, height], float), np.array([width - 1, height - 1]) / 2
    angle = np.deg2rad(angle_deg)
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    mirror = np.diag([-1.0 if flipped else 1.0, 1.0])
    # pixel centers: new p -> turned picture (p + 1/2) side + corner * size - 1/2 -> mirrored picture -> old picture
    shift = 0.5 * side + np.array(corner) * size - 0.5
    linear = mirror @ turn
    return np.column_stack([linear * side, linear @ (shift - middle) + middle])
