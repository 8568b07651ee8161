"""Contact sheets of a set: every mask over its image, with the image's name."""

import pathlib

import cv2
import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from deltasafe.io.storage import atomic_file
from deltasafe.perception.data.labeled_images import LabeledImageSet

_COLUMNS, _ROWS = 6, 10
_WIDTH, _HEIGHT, _CAPTION, _GAP = 240, 180, 18, 6
_FILL_RGB, _FILL_OPACITY = (0, 229, 255), 0.35
_MAX_PIXELS = 16 * _WIDTH * _HEIGHT


def write_mask_sheets(images: LabeledImageSet, destination: pathlib.Path) -> None:
    """Write JPEG sheets of all images: ``destination``, and ``NAME-2``, ``NAME-3`` and so on beside it."""
    per_sheet = _COLUMNS * _ROWS
    for first in range(0, len(images), per_sheet):
        number = first // per_sheet + 1
        path = destination if first == 0 else destination.with_stem(f"{destination.stem}-{number}")
        with atomic_file(path) as temporary:
            _sheet(images, range(first, min(first + per_sheet, len(images)))).save(temporary, "JPEG", quality=88)


def _sheet(images: LabeledImageSet, indices: range) -> Image.Image:
    n_rows, n_columns = -(-len(indices) // _COLUMNS), min(_COLUMNS, len(indices))
    size = n_columns * (_WIDTH + _GAP) + _GAP, n_rows * (_HEIGHT + _CAPTION + _GAP) + _GAP
    sheet = Image.new("RGB", size, "white")
    draw, font = ImageDraw.Draw(sheet), ImageFont.load_default(size=11)
    for place, index in enumerate(indices):
        rgb, mask = images.read(index, max_pixels=_MAX_PIXELS)
        row, column = divmod(place, _COLUMNS)
        left, top = _GAP + column * (_WIDTH + _GAP), _GAP + row * (_HEIGHT + _CAPTION + _GAP)
        tile = Image.fromarray(_marked(rgb, mask))
        sheet.paste(tile, (left + (_WIDTH - tile.width) // 2, top + _CAPTION + (_HEIGHT - tile.height) // 2))
        name = images.items[index].id
        share = f"{mask.mean():.0%}" if mask.any() else "none"
        while draw.textlength(f"{name}  {share}", font=font) > _WIDTH and len(name) > 4:
            name = f"{name[:-4]}..."
        draw.text((left, top), f"{name}  {share}", fill="black", font=font)
    return sheet


def _marked(rgb: NDArray[np.uint8], mask: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Scale an image to fit its tile, and draw its mask as a tint with an outline."""
    scale = min(_WIDTH / rgb.shape[1], _HEIGHT / rgb.shape[0])
    size = max(1, round(rgb.shape[1] * scale)), max(1, round(rgb.shape[0] * scale))
    way = cv2.INTER_AREA if scale < 1 else cv2.INTER_NEAREST
    tile, coverage = (
        cv2.resize(rgb, size, interpolation=way),
        cv2.resize(mask.astype(np.float32), size, interpolation=way),
    )
    tint = _FILL_OPACITY * coverage[..., None]
    tile = np.ascontiguousarray((tile * (1 - tint) + np.array(_FILL_RGB) * tint).astype(np.uint8))
    outlines, _ = cv2.findContours((coverage >= 0.5).astype(np.uint8), cv2.RETR_CCOMP, cv2.CHAIN_APPROX_NONE)
    cv2.drawContours(tile, outlines, -1, (255, 255, 255), 1)
    return np.asarray(tile, np.uint8)
