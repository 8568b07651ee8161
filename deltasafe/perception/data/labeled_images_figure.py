"""A look at a set of labeled images: evenly chosen ones, with the border of the label."""

import cv2
import numpy as np

from deltasafe.perception.data.labeled_images import LabeledImageSet

__all__ = ["labeled_images_figure"]

_BORDER_RGB = (0, 229, 255)


def labeled_images_figure(hands: LabeledImageSet, n_images: int = 12, columns: int = 4, width: int = 200) -> bytes:
    """At most ``n_images`` of a set side by side, as JPEG; shown whole, on gray where their shapes differ."""
    chosen = np.unique(np.linspace(0, len(hands) - 1, min(n_images, len(hands))).round().astype(int))
    height = round(0.75 * width)
    sheet = np.full((-(-len(chosen) // columns) * height, min(columns, len(chosen)) * width, 3), 128, np.uint8)
    for place, index in enumerate(chosen):
        rgb, mask = hands.read(int(index))
        scale = min(width / rgb.shape[1], height / rgb.shape[0])
        size = max(1, round(rgb.shape[1] * scale)), max(1, round(rgb.shape[0] * scale))
        tile = np.ascontiguousarray(cv2.resize(rgb, size, interpolation=cv2.INTER_AREA))
        label = cv2.resize(mask, size, interpolation=cv2.INTER_NEAREST)
        borders, _ = cv2.findContours(label, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
        cv2.drawContours(tile, borders, -1, _BORDER_RGB, 1, cv2.LINE_AA)
        row, column = divmod(place, columns)
        sheet[row * height :][: size[1], column * width :][:, : size[0]] = tile
    return bytes(cv2.imencode(".jpg", sheet[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, 75])[1])
