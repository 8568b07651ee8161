"""Flip, rotation by a small angle, and crop (Uzun et al. 2021), all applied to every image."""

import cv2
import numpy as np

from deltasafe.perception.data.labeled_pair import resize_labeled
from deltasafe.perception.data.schemes.originals import Originals, Variant
from deltasafe.perception.data.schemes.settings import FlipRotateCropSettings


def flip_rotate_crop(
    originals: Originals, i: int, settings: FlipRotateCropSettings, rng: np.random.Generator
) -> Variant:
    """Mirror the ``i``-th original or not, rotate it about its center, crop it anywhere, and scale the crop back.

    The three are one affine map, sampled once at a multiple of the stored size. At the corners that the rotation
    leaves open, the border is repeated, in image and mask alike.
    """
    flipped = bool(rng.integers(2))
    angle_deg = float(rng.uniform(-settings.largest_angle_deg, settings.largest_angle_deg))
    side = float(rng.uniform(settings.smallest_crop, 1.0))
    x, y = (float(value) for value in rng.uniform(0.0, 1.0 - side, 2))
    image, mask = originals.images[i], originals.masks[i].astype(np.float32)
    size = (image.shape[1], image.shape[0])
    matrix = crop_matrix(size, flipped, angle_deg, side, (x, y))
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    image, mask = (
        cv2.warpAffine(pixels, matrix, size, flags=flags, borderMode=cv2.BORDER_REPLICATE) for pixels in (image, mask)
    )
    image, mask = resize_labeled(image, mask, (settings.width, settings.height), cv2.INTER_AREA)
    operations: list[dict[str, object]] = [
        {"method": "flip", "applied": flipped},
        {"method": "rotation", "angle_deg": angle_deg},
        {"method": "cropping", "side": side, "x": x, "y": y},
    ]
    return image, mask, operations


def crop_matrix(
    size: tuple[int, int], flipped: bool, angle_deg: float, side: float, corner: tuple[float, float]
) -> np.ndarray:
    """Affine matrix (2, 3) from pixels of the new image to pixels of the old one, both of the same size.

    Args:
        size: width and height in pixels.
        flipped: mirror left-right.
        angle_deg: counter-clockwise in the image, about its center.
        side: of the crop, as a fraction of the image's side.
        corner: upper left corner of the crop, as fractions of width and height.
    """
    center = (np.array(size) - 1) / 2
    angle_rad = np.deg2rad(angle_deg)
    rotate = np.array([[np.cos(angle_rad), -np.sin(angle_rad)], [np.sin(angle_rad), np.cos(angle_rad)]])
    mirror = np.diag([-1.0 if flipped else 1.0, 1.0])
    # pixel centers: new p -> rotated image (p + 1/2) side + corner * size - 1/2 -> mirrored image -> old image
    shift = 0.5 * side + np.array(corner) * size - 0.5
    linear = mirror @ rotate
    return np.column_stack([linear * side, linear @ (shift - center) + center])
