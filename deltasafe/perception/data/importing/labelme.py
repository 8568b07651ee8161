"""Labels of labelme: one JSON file for each image."""

import base64
import functools
import io
import pathlib
from typing import Any

import numpy as np
from PIL import Image

from deltasafe.perception.data.importing.rasterize import outlined
from deltasafe.perception.data.importing.source import (
    BACKGROUND,
    Files,
    Mask,
    Shape,
    SourceImage,
    image_size,
    label_errors,
    numbers,
    painted,
    side_lengths,
)

_AREAS = ("polygon", "rectangle", "oriented_rectangle", "circle", "mask")


def labelme_images(path: pathlib.Path, document: Any, files: Files) -> list[SourceImage]:
    """Return the image of a labelme document. Shapes are painted in their order, as labelme's own conversions do.

    Raises:
        DataError: the document is malformed.
    """
    with label_errors(path):
        shapes = [(str(shape["label"]), shape.get("shape_type") or "polygon", shape) for shape in document["shapes"]]
        image: pathlib.Path | bytes | None = files.find(str(document["imagePath"]), path.parent)
        if image is None and document.get("imageData"):
            image = base64.b64decode(document["imageData"])
        size = None
        if document.get("imageHeight") and document.get("imageWidth"):
            size = side_lengths(document, "imageHeight", "imageWidth")
        areas = [(label, kind, shape) for label, kind, shape in shapes if kind in _AREAS]
        others = len(shapes) - len(areas)
        notes: tuple[str, ...] = (f"{others} lines or points left out",) if others else ()
        if rectangles := sum(kind in ("rectangle", "oriented_rectangle") for _, kind, _ in areas):
            notes += (f"{rectangles} rectangles filled",)
        classes = frozenset(label for label, _, _ in areas) - BACKGROUND
        mask = functools.partial(_mask, areas, size, image)
        return [SourceImage(str(document["imagePath"]), image, classes, mask, notes=notes)]


def _mask(
    areas: list[tuple[str, str, dict[str, Any]]],
    size: tuple[int, int] | None,
    image: pathlib.Path | bytes | None,
    classes: frozenset[str],
) -> Mask:
    height, width = size or image_size(image)
    shapes = [Shape(label, functools.partial(_pixels, kind, shape, height, width)) for label, kind, shape in areas]
    return painted(shapes, height, width, classes)


def _pixels(kind: str, shape: dict[str, Any], height: int, width: int) -> Mask:
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
