"""Labels in "CVAT for images 1.1": one XML file."""

import functools
import math
import pathlib
import re
from xml.etree import ElementTree

import numpy as np

from deltasafe.errors import DataError
from deltasafe.perception.data.importing.rasterize import ellipse, polygons, row_runs
from deltasafe.perception.data.importing.settings import ImportSettings
from deltasafe.perception.data.importing.source import (
    Drawing,
    Files,
    Mask,
    Shape,
    SourceImage,
    label_errors,
    shape_image,
)

_AREAS = ("polygon", "mask", "box", "ellipse")
_NO_AREAS = ("polyline", "points", "cuboid", "skeleton")


def parse_xml(path: pathlib.Path) -> ElementTree.Element:
    """Parse an XML file without a document type, whose entities could expand to any size.

    Raises:
        DataError: the file is missing or is not such XML.
    """
    try:
        data = path.read_bytes()
        if re.search(rb"<!(DOCTYPE|ENTITY)", data):
            raise DataError(path, "has a document type; export it again")
        return ElementTree.fromstring(data)
    except OSError as error:
        raise DataError(path, f"cannot be read ({error.strerror}); restore the file") from error
    except (ElementTree.ParseError, ValueError, LookupError) as error:
        if isinstance(error, DataError):
            raise
        raise DataError(path, f"is not valid XML ({error}); export it again") from error


def cvat_images(
    path: pathlib.Path, root: ElementTree.Element, files: Files, settings: ImportSettings
) -> list[SourceImage]:
    """Return the images of a document. Shapes are painted by their z order, as in CVAT's mask export.

    Raises:
        DataError: the document is malformed, or is CVAT for video.
    """
    if root.find("track") is not None:
        raise DataError(path, "is CVAT for video 1.1, which has no masks of single images; export CVAT for images 1.1")
    with label_errors(path):
        return [_image(element, files, path.parent, settings) for element in root.iter("image")]


def _image(element: ElementTree.Element, files: Files, folder: pathlib.Path, settings: ImportSettings) -> SourceImage:
    name, size = element.attrib["name"], (int(element.attrib["height"]), int(element.attrib["width"]))
    areas = sorted((child for child in element if child.tag in _AREAS), key=lambda a: int(a.attrib.get("z_order", 0)))
    others = sum(child.tag in _NO_AREAS for child in element)
    notes = (f"{others} lines or points left out",) if others else ()
    shapes = [Shape(area.attrib["label"], functools.partial(_draw, area), area.tag == "box") for area in areas]
    image = files.find(name, folder, folder / "images")
    return shape_image(
        name, image, Drawing(shapes, size, paints=True), settings, is_labeled=len(element) > 0, notes=notes
    )


def _draw(area: ElementTree.Element, height: int, width: int) -> Mask:
    values = area.attrib
    if area.tag == "polygon":
        points = [[float(x) for x in point.split(",")] for point in values["points"].split(";") if point.strip()]
        return polygons([points], height, width)
    if area.tag == "mask":
        box = tuple(int(values[key]) for key in ("left", "top", "width", "height"))
        return row_runs([int(count) for count in values["rle"].split(",")], box, height, width)  # type: ignore[arg-type]
    angle_rad = math.radians(float(values.get("rotation", 0)))
    if area.tag == "ellipse":
        center, radii = (float(values["cx"]), float(values["cy"])), (float(values["rx"]), float(values["ry"]))
        return ellipse(center, radii, angle_rad, height, width)
    x0, y0, x1, y1 = (float(values[key]) for key in ("xtl", "ytl", "xbr", "ybr"))
    center_xy, half = np.array([(x0 + x1) / 2, (y0 + y1) / 2]), np.array([(x1 - x0) / 2, (y1 - y0) / 2])
    turn = np.array([[math.cos(angle_rad), -math.sin(angle_rad)], [math.sin(angle_rad), math.cos(angle_rad)]])
    corners = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * half
    return polygons([center_xy + corners @ turn.T], height, width)
