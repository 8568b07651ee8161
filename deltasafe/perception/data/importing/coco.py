"""Labels in COCO's JSON, also as Roboflow and other tools export it: polygons and run lengths."""

import functools
import pathlib
from collections import defaultdict
from typing import Any

from deltasafe.perception.data.importing.rasterize import polygons, run_lengths
from deltasafe.perception.data.importing.source import (
    Files,
    Mask,
    Shape,
    SourceImage,
    image_size,
    label_errors,
    side_lengths,
    union,
)


def coco_images(path: pathlib.Path, document: Any, files: Files) -> list[SourceImage]:
    """Return the images of a COCO document. Instances may overlap; those of other classes hide nothing.

    Raises:
        DataError: the document is malformed.
    """
    with label_errors(path):
        names = {category["id"]: str(category["name"]) for category in document["categories"]}
        annotations = defaultdict(list)
        for annotation in document["annotations"]:
            if (category := annotation["category_id"]) not in names:
                raise ValueError(f"annotation {annotation.get('id')} has the unknown category {category}")
            annotations[annotation["image_id"]].append(annotation)
        listed = [image["id"] for image in document["images"]]
        if len(set(listed)) < len(listed):
            raise ValueError("two images have the same id")
        if unknown := annotations.keys() - set(listed):
            raise ValueError(f"annotations belong to the images {sorted(unknown, key=str)[:5]}, which are not listed")
        near = _folders_near(path)
        return [_image(record, annotations[record["id"]], names, files, near) for record in document["images"]]


def _image(
    record: dict[str, Any], annotations: list[Any], names: dict[Any, str], files: Files, near: list[pathlib.Path]
) -> SourceImage:
    file = files.find(str(record["file_name"]), *near)
    has_size = record.get("height") and record.get("width")
    size = side_lengths(record) if has_size else None
    labels = frozenset(names[annotation["category_id"]] for annotation in annotations)
    mask = functools.partial(_mask, annotations, names, size, file)
    return SourceImage(str(record["file_name"]), file, labels, mask, is_labeled=bool(annotations))


def _mask(
    annotations: list[Any],
    names: dict[Any, str],
    size: tuple[int, int] | None,
    file: pathlib.Path | None,
    classes: frozenset[str],
) -> Mask:
    height, width = size or image_size(file)
    shapes = [Shape(names[one["category_id"]], functools.partial(_pixels, one, height, width)) for one in annotations]
    return union(shapes, height, width, classes)


def _pixels(annotation: dict[str, Any], height: int, width: int) -> Mask:
    segmentation = annotation.get("segmentation")
    if not segmentation:
        raise ValueError(f"annotation {annotation.get('id')} has no outline, only a box")
    if isinstance(segmentation, dict):
        return run_lengths(segmentation, height, width)
    return polygons([segmentation] if isinstance(segmentation[0], int | float) else segmentation, height, width)


def _folders_near(path: pathlib.Path) -> list[pathlib.Path]:
    """Return where the images of ``annotations/instances_NAME.json`` may be; elsewhere, the folder of the file."""
    subset, root = path.stem.split("_", 1)[-1], path.parent.parent
    if path.parent.name != "annotations":
        return [path.parent]
    return [path.parent, root / "images" / subset, root / subset, root / "images", root]
