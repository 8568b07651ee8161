"""A sheet of labeled images with the outlines of their masks."""

import cv2
import numpy as np

from deltasafe.perception.data.labeled_images import LabeledImageSet

_SHOWN_PIXELS = 2**18
_OUTLINE_RGB = (0, 229, 255)


def evenly_spaced(n: int, at_most: int) -> list[int]:
    """Choose at most ``at_most`` of the indices below ``n``, evenly spaced and with the first and the last."""
    return np.unique(np.linspace(0, n - 1, min(at_most, n)).round().astype(int)).tolist()


def labeled_images_figure(images: LabeledImageSet, n_images: int = 12, columns: int = 4, width: int = 200) -> bytes:
    """Draw at most ``n_images`` of a set as a JPEG sheet. Images are not cropped; gaps are gray."""
    chosen = evenly_spaced(len(images), n_images)
    height = round(0.75 * width)
    sheet = np.full((-(-len(chosen) // columns) * height, min(columns, len(chosen)) * width, 3), 128, np.uint8)
    for place, index in enumerate(chosen):
        rgb, mask = images.read(index, _SHOWN_PIXELS)
        scale = min(width / rgb.shape[1], height / rgb.shape[0])
        size = max(1, round(rgb.shape[1] * scale)), max(1, round(rgb.shape[0] * scale))
        tile = np.ascontiguousarray(cv2.resize(rgb, size, interpolation=cv2.INTER_AREA))
        small_mask = cv2.resize(mask, size, interpolation=cv2.INTER_NEAREST)
        outlines, _ = cv2.findContours(small_mask, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
        cv2.drawContours(tile, outlines, -1, _OUTLINE_RGB, 1, cv2.LINE_AA)
        row, column = divmod(place, columns)
        sheet[row * height :][: size[1], column * width :][:, : size[0]] = tile
    return bytes(cv2.imencode(".jpg", sheet[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, 75])[1])
