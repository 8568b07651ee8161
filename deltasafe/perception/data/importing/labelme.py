"""Labels of labelme: one JSON file for each image."""

import base64
import functools
import io
import pathlib
from typing import Any

import numpy as np
from PIL import Image

from deltasafe.perception.data.importing.rasterize import outlined
from deltasafe.perception.data.importing.settings import ImportSettings
from deltasafe.perception.data.importing.source import (
    Drawing,
    Files,
    Mask,
    Shape,
    SourceImage,
    label_errors,
    numbers,
    shape_image,
    side_lengths,
)

_AREAS = ("polygon", "rectangle", "oriented_rectangle", "circle", "mask")


def labelme_images(path: pathlib.Path, document: Any, files: Files, settings: ImportSettings) -> list[SourceImage]:
    """Return the image of a labelme document. Shapes are painted in their order, as labelme's own conversions do.

    Raises:
        DataError: the document is malformed.
    """
    with label_errors(path):
        shapes = []
        for shape in document["shapes"]:
            kind = shape.get("shape_type") or "polygon"
            if kind in _AREAS:
                draw = functools.partial(_draw, kind, shape)
                shapes.append(Shape(str(shape["label"]), draw, kind in ("rectangle", "oriented_rectangle")))
        others = len(document["shapes"]) - len(shapes)
        notes = (f"{others} lines or points left out",) if others else ()
        name = str(document["imagePath"])
        image: pathlib.Path | bytes | None = files.find(name, path.parent)
        if image is None and document.get("imageData"):
            image = base64.b64decode(document["imageData"])
        has_size = document.get("imageHeight") and document.get("imageWidth")
        size = side_lengths(document, "imageHeight", "imageWidth") if has_size else None
        return [shape_image(name, image, Drawing(shapes, size, paints=True), settings, is_labeled=True, notes=notes)]


def _draw(kind: str, shape: dict[str, Any], height: int, width: int) -> Mask:
    if kind != "mask":
        return outlined(kind, shape["points"], height, width)
    (left, top), (right, bottom) = numbers(shape["points"]).astype(int)
    with Image.open(io.BytesIO(base64.b64decode(shape["mask"]))) as opened:
        part = np.asarray(opened.convert("L"), bool)
    if part.shape != (bottom - top + 1, right - left + 1) or left < 0 or top < 0 or right >= width or bottom >= height:
        raise ValueError(f"a mask of {part.shape[1]} x {part.shape[0]} does not fit the box of its shape")
    mask = np.zeros((height, width), bool)
    mask[top : bottom + 1, left : right + 1] = part
    return mask
