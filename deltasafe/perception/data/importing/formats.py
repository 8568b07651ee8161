"""Recognition of the format of a source, and its reader."""

import pathlib
from typing import Any

from deltasafe.errors import DataError
from deltasafe.io.folder_entries import is_clutter
from deltasafe.perception.data.importing.coco import coco_images
from deltasafe.perception.data.importing.cvat import cvat_images, parse_xml
from deltasafe.perception.data.importing.label_studio import label_studio_images
from deltasafe.perception.data.importing.labelme import labelme_images
from deltasafe.perception.data.importing.mask_folders import (
    VOC_MASKS,
    folder_images,
    roboflow_images,
    unlabeled,
    voc_images,
)
from deltasafe.perception.data.importing.settings import ImportSettings
from deltasafe.perception.data.importing.source import Files, LabelSource, SourceImage, parse_labels

_DOCUMENTS = {"coco": coco_images, "labelme": labelme_images, "label-studio": label_studio_images, "cvat": cvat_images}


def read_source(source: pathlib.Path, settings: ImportSettings) -> LabelSource:
    """Read the labels of a file or folder.

    Images below the source that no label names are listed as unlabeled.

    Raises:
        DataError: the source is missing or malformed, or its format is not recognized or ambiguous.
    """
    if source.suffix.lower() in (".zip", ".tar", ".gz", ".7z"):
        raise DataError(source, "is an archive; unpack it and give the folder")
    if not (source.is_file() or source.is_dir()):
        raise DataError(source, "is missing; give the file or folder of the labels")
    found = _label_files(source)
    if settings.format == "roboflow" and "roboflow" not in found:
        found["roboflow"] = found.pop("coco", [])
    forms = [settings.format] if settings.format != "auto" else list(found)
    if len(forms) > 1 and set(forms) == {"voc", "cvat-masks"}:
        forms = ["cvat-masks"]
    if len(forms) > 1:
        raise DataError(source, f"fits several formats; give --format {' or --format '.join(forms)}")
    form = forms[0] if forms else "folder"
    labels = found.get(form, [])
    if form != "folder" and not labels:
        raise DataError(source, f"holds no labels of the format {form}; give another --format, or another folder")
    root = source if source.is_dir() else _root(source)
    files = Files(root if form == "folder" else root / settings.images)
    images = _read(form, labels, files, root, settings)
    has_mask_files = form in ("folder", "voc", "cvat-masks") or (form == "roboflow" and labels[0][1] is None)
    if not has_mask_files:
        for option in ("threshold", "alpha", "inverted"):
            if getattr(settings, option):
                raise DataError(source, f"has outlines of the format {form} and no mask files; remove --{option}")
        used = {image.image.resolve() for image in images if isinstance(image.image, pathlib.Path)}
        images += [unlabeled(path) for path in files.all() if path.resolve() not in used]
    return LabelSource(form, tuple(images), has_mask_files)


def _read(
    form: str, labels: list[tuple[pathlib.Path, Any]], files: Files, root: pathlib.Path, settings: ImportSettings
) -> list[SourceImage]:
    if form == "folder":
        return folder_images(root, settings)
    images: list[SourceImage] = []
    for path, document in labels:
        if form in ("voc", "cvat-masks"):
            images += voc_images(path, files, settings)
        elif form == "roboflow" and path.is_dir():
            images += roboflow_images(path, settings)
        else:
            images += _DOCUMENTS["coco" if form == "roboflow" else form](path, document, files, settings)
    return images


def _root(file: pathlib.Path) -> pathlib.Path:
    """Return the folder below which the images of a label file lie."""
    return file.parent.parent if file.parent.name.lower() == "annotations" else file.parent


def _label_files(source: pathlib.Path) -> dict[str, list[tuple[pathlib.Path, Any]]]:
    """Return the label files and folders below a source by format; JSON and XML are parsed."""
    found: dict[str, list[tuple[pathlib.Path, Any]]] = {}
    paths = [source] if source.is_file() else sorted(source.rglob("*"))
    for path in paths:
        form, document = None, None
        if is_clutter(*path.relative_to(source).parts):
            continue
        if path.is_dir() and path.name == VOC_MASKS:
            path = path.parent  # noqa: PLW2901
            form = "cvat-masks" if (path / "labelmap.txt").is_file() else "voc"
        elif path.name == "_classes.csv" and any(path.parent.glob("*_mask.png")):
            form, path = "roboflow", path.parent  # noqa: PLW2901
        elif path.suffix.lower() == ".json" and path.is_file():
            document = parse_labels(path)
            form = _json_format(document)
        elif path.suffix.lower() == ".xml" and path.is_file():
            document = parse_xml(path)
            form = "cvat" if document.tag == "annotations" else None
        if form is not None:
            found.setdefault(form, []).append((path, document))
        elif path == source and source.is_file():
            raise DataError(source, "is not a label file of COCO, labelme, Label Studio or CVAT; give one, or a folder")
    return found


def _json_format(document: Any) -> str | None:
    if isinstance(document, dict):
        if {"images", "annotations", "categories"} <= document.keys():
            return "coco"
        return "labelme" if {"shapes", "imagePath"} <= document.keys() else None
    is_task = isinstance(document, list) and document and isinstance(document[0], dict)
    return "label-studio" if is_task and {"data", "annotations"} <= document[0].keys() else None
