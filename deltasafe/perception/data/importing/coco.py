"""Labels in COCO's JSON, also as Roboflow and other tools export it: polygons and run lengths."""

import functools
import pathlib
from collections import defaultdict
from typing import Any

from deltasafe.perception.data.importing.rasterize import polygons, run_lengths
from deltasafe.perception.data.importing.settings import ImportSettings
from deltasafe.perception.data.importing.source import (
    Drawing,
    Files,
    Mask,
    Shape,
    SourceImage,
    label_errors,
    shape_image,
    side_lengths,
)


def coco_images(path: pathlib.Path, document: Any, files: Files, settings: ImportSettings) -> list[SourceImage]:
    """Return the images of a COCO document. Instances may overlap; those of other classes hide nothing.

    Raises:
        DataError: the document is malformed.
    """
    with label_errors(path):
        names = {category["id"]: str(category["name"]) for category in document["categories"]}
        shapes = defaultdict(list)
        for annotation in document["annotations"]:
            if (category := annotation["category_id"]) not in names:
                raise ValueError(f"annotation {annotation.get('id')} has the unknown category {category}")
            draw, is_box = functools.partial(_draw, annotation), not annotation.get("segmentation")
            shapes[annotation["image_id"]].append(Shape(names[category], draw, is_box))
        listed = [image["id"] for image in document["images"]]
        if len(set(listed)) < len(listed):
            raise ValueError("two images have the same id")
        if unknown := shapes.keys() - set(listed):
            raise ValueError(f"annotations belong to the images {sorted(unknown, key=str)[:5]}, which are not listed")
        images = []
        for record in document["images"]:
            name, found = str(record["file_name"]), shapes[record["id"]]
            size = side_lengths(record) if record.get("height") and record.get("width") else None
            file = files.find(name, *_folders_near(path))
            images.append(shape_image(name, file, Drawing(found, size, paints=False), settings, is_labeled=bool(found)))
        return images


def _draw(annotation: dict[str, Any], height: int, width: int) -> Mask:
    segmentation = annotation.get("segmentation")
    if not segmentation:
        x, y, across, down = annotation["bbox"]
        return polygons([[x, y, x + across, y, x + across, y + down, x, y + down]], height, width)
    if isinstance(segmentation, dict):
        return run_lengths(segmentation, height, width)
    return polygons([segmentation] if isinstance(segmentation[0], int | float) else segmentation, height, width)


def _folders_near(path: pathlib.Path) -> list[pathlib.Path]:
    """Return where the images of ``annotations/instances_NAME.json`` may be; elsewhere, the folder of the file."""
    subset, root = path.stem.split("_", 1)[-1], path.parent.parent
    if path.parent.name != "annotations":
        return [path.parent]
    return [path.parent, root / "images" / subset, root / subset, root / "images", root]
