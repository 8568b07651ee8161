"""One labeled image: photograph and mask, both upright and of one size."""

import pathlib

import cv2
import numpy as np
from numpy.typing import NDArray

from deltasafe.errors import DataError
from deltasafe.io.images import ImageHeader
from deltasafe.perception.data.dataset_info import SetOptions


def aligned_mask(
    image: ImageHeader, mask: NDArray[np.uint8], options: SetOptions, paths: tuple[pathlib.Path, pathlib.Path]
) -> NDArray[np.uint8]:
    """Turn a mask (H, W) upright as its image, if it was drawn on the stored pixels.

    Args:
        image: size and orientation.
        mask: as stored, of the size of the whole image.
        options: of the set.
        paths: of image and mask, for messages.

    Raises:
        DataError: the sizes differ; or the image has an EXIF orientation, and neither the size of the mask nor the
            options tell whether the mask was drawn on the upright picture.
    """
    size, found = image.size, mask.shape[::-1]
    stored = size[::-1] if image.orientation >= 5 else size
    if found not in (size, stored):
        sizes = f"is {found[0]} x {found[1]} but its image is {size[0]} x {size[1]}"
        raise DataError(paths[1], f"{sizes}; export both at the same size")
    if image.orientation == 1:
        return mask
    drawn_on = options.masks_drawn_on if size == stored else ("stored", "upright")[found == size]
    if not drawn_on:
        file = paths[0].parents[1] / "dataset.json"
        raise DataError(
            paths[0],
            f"has the EXIF orientation {image.orientation}, and its mask has the same size either way; write "
            f'{{"masks_drawn_on": "upright"}} into the file {file} if the masks fit the picture as viewers show it, or '
            '"stored" if they fit the pixels as they are stored',
        )
    return _turned_upright(mask, image.orientation) if drawn_on == "stored" else mask


def resize_labeled(
    rgb: np.ndarray, mask: np.ndarray, size: tuple[int, int], interpolation: int
) -> tuple[np.ndarray, np.ndarray]:
    """Resize an image and its mask to ``size`` (width, height), see `scaled_mask`."""
    return cv2.resize(rgb, size, interpolation=interpolation), scaled_mask(mask, size, interpolation)


def scaled_mask(mask: np.ndarray, size: tuple[int, int], interpolation: int = cv2.INTER_AREA) -> NDArray[np.uint8]:
    """Resize a mask with values from 0 to 1; a pixel is hand if at least half of it is covered."""
    coverage = cv2.resize(mask.astype(np.float32), size, interpolation=interpolation)
    return (coverage >= 0.5).astype(np.uint8)


def _turned_upright(pixels: NDArray[np.uint8], orientation: int) -> NDArray[np.uint8]:
    """Turn stored pixels (H, W) as the EXIF orientation says."""
    if orientation >= 5:
        pixels = pixels.T
    rows = -1 if orientation in (3, 4, 7, 8) else 1
    columns = -1 if orientation in (2, 3, 6, 7) else 1
    return np.ascontiguousarray(pixels[::rows, ::columns])
