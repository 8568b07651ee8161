"""Labels of Label Studio, exported as JSON: polygons, brush strokes, rectangles and ellipses."""

import functools
import math
import pathlib
import re
import urllib.parse
from collections import defaultdict
from typing import Any

import numpy as np

from deltasafe.perception.data.importing.rasterize import brush_alpha, ellipse, polygons
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

_AREAS = ("polygon", "brush", "magicwand", "rectangle", "ellipse")
_NO_AREAS = ("keypoint", "vector")
_IMAGE = re.compile(r"\.(jpe?g|png|webp|bmp|tiff?|hei[cf]|avif)$", re.IGNORECASE)


def label_studio_images(path: pathlib.Path, tasks: Any, files: Files, settings: ImportSettings) -> list[SourceImage]:
    """Return the images of an export. Regions may overlap; those of other labels hide nothing.

    Of several annotations of a task, the one marked as ground truth is used, else the newest.

    Raises:
        DataError: the export is malformed.
    """
    with label_errors(path):
        return [_image(task, files, path.parent, settings) for task in tasks]


def _image(task: dict[str, Any], files: Files, folder: pathlib.Path, settings: ImportSettings) -> SourceImage:
    reference = _reference(task["data"])
    name = reference.rsplit("/", 1)[-1]
    image = files.find(reference, folder) or files.find(re.sub(r"^[0-9a-f]{8}-", "", name), folder)
    submitted = [one for one in task["annotations"] if not one.get("was_cancelled")]
    submitted.sort(key=lambda one: (bool(one.get("ground_truth")), str(one.get("updated_at", "")), one.get("id", 0)))
    notes: tuple[str, ...] = ()
    if len(submitted) > 1:
        kind = "the ground truth" if submitted[-1].get("ground_truth") else "the newest"
        notes += (f"{kind} of {len(submitted)} annotations taken",)
    results = submitted[-1]["result"] if submitted else []
    areas = _regions(results)
    if others := sum(_kind(result) in _NO_AREAS for result in results):
        notes += (f"{others} lines or points left out",)
    sizes = {side_lengths(region, "original_height", "original_width") for _, region in areas}
    if len(sizes) > 1:
        raise ValueError(f"the regions of {name} belong to images of several sizes")
    shapes = [Shape(label, functools.partial(_draw, one), _kind(one) == "rectangle") for label, one in areas]
    drawing = Drawing(shapes, sizes.pop() if sizes else None, paints=False)
    return shape_image(name, image, drawing, settings, is_labeled=bool(submitted), notes=notes)


def _reference(data: dict[str, Any]) -> str:
    """Return the path of the image; tasks name it by an address, an upload, or a path after ``?d=``."""
    texts = [value for value in data.values() if isinstance(value, str)]
    parsed = [urllib.parse.urlsplit(text) for text in texts]
    paths = [urllib.parse.parse_qs(url.query).get("d", [urllib.parse.unquote(url.path)])[0] for url in parsed]
    images = [path for path in paths if _IMAGE.search(path)]
    if len(images) != 1:
        raise ValueError(f"a task has {len(images)} images in its data: {texts}")
    return images[0]


def _regions(results: list[dict[str, Any]]) -> list[tuple[str, dict[str, Any]]]:
    """Return the regions that cover an area, with each of their labels, or ``unlabeled``.

    A separate control for labels gives a region and its labels as two results with one id.
    """
    labels: dict[Any, list[str]] = defaultdict(list)
    regions: dict[Any, dict[str, Any]] = {}
    for number, result in enumerate(results):
        key = result.get("id", number)
        for name, value in result.get("value", {}).items():
            if name.endswith("labels"):
                labels[key] += [str(label) for label in value]
        if _kind(result) in _AREAS:
            regions.setdefault(key, result)
    return [(label, region) for key, region in regions.items() for label in labels[key] or ["unlabeled"]]


def _kind(result: dict[str, Any]) -> str:
    return str(result.get("type", "")).removesuffix("labels")


def _draw(region: dict[str, Any], height: int, width: int) -> Mask:
    if region.get("image_rotation"):
        raise ValueError(f"the image is turned by {region['image_rotation']} degrees in Label Studio; turn it back")
    value, scale = region["value"], np.array([width, height]) / 100
    if "rle" in value:
        return brush_alpha(value["rle"], height, width) > 127
    if "points" in value:
        return polygons([numbers(value["points"]) * scale], height, width)
    angle_rad = math.radians(value.get("rotation", 0))
    origin = np.array([value["x"], value["y"]]) * scale
    if "radiusX" in value:
        radii = (value["radiusX"] * scale[0], value["radiusY"] * scale[1])
        return ellipse((origin[0], origin[1]), radii, angle_rad, height, width)
    across, down = value["width"] * scale[0], value["height"] * scale[1]
    turn = np.array([[math.cos(angle_rad), math.sin(angle_rad)], [-math.sin(angle_rad), math.cos(angle_rad)]])
    return polygons([origin + np.array([[0, 0], [across, 0], [across, down], [0, down]]) @ turn], height, width)
