"""Labels as one mask file per image: Pascal VOC, CVAT's segmentation mask, Roboflow's PNG masks, plain folders."""

import csv
import dataclasses
import functools
import pathlib
import re
from collections.abc import Collection, Iterable, Mapping

import numpy as np

from deltasafe.errors import DataError
from deltasafe.io.folder_entries import IMAGE_SUFFIXES, FolderEntries
from deltasafe.perception.data.importing.settings import ImportSettings
from deltasafe.perception.data.importing.source import BACKGROUND, Files, Mask, SourceImage, image_size
from deltasafe.perception.data.masks import MaskPlane, read_mask_plane

VOC_MASKS = "SegmentationClass"
_VOC_CLASSES = (
    *("background", "aeroplane", "bicycle", "bird", "boat", "bottle", "bus", "car", "cat", "chair", "cow"),
    *("diningtable", "dog", "horse", "motorbike", "person", "pottedplant", "sheep", "sofa", "train", "tvmonitor"),
)
_VOC_VOID = 255
IMAGE_FOLDERS = ("images", "image", "imgs", "img", "rgb", "jpegimages")
MASK_FOLDERS = ("masks", "mask", "labels", "label", "annotations", "segmentation", "segmentationclass", "gt")
_MASK_NAME = re.compile(r"(\.(jpe?g|png))?([_-](mask|label|labels|seg|segmentation|gt))?$", re.IGNORECASE)
_BLACK_CLASS = 1 << 24
"""Code of black pixels where black is a class and another color is the background."""


def voc_images(folder: pathlib.Path, files: Files, settings: ImportSettings) -> list[SourceImage]:
    """Return the images of a VOC folder with ``SegmentationClass/``.

    Names of classes are those of ``labelmap.txt`` (CVAT), else the twenty of VOC. The border of VOC's objects is the
    class ``void``.

    Raises:
        DataError: ``labelmap.txt`` is malformed.
    """
    table = folder / "labelmap.txt"
    colors = _label_map(table) if table.is_file() else {_voc_color(i): name for i, name in enumerate(_VOC_CLASSES)}
    colors.setdefault(_voc_color(_VOC_VOID), "void")
    values = (
        dict(enumerate(colors.values())) if table.is_file() else dict(enumerate(_VOC_CLASSES)) | {_VOC_VOID: "void"}
    )
    masks = {path.stem: path for path in sorted((folder / VOC_MASKS).iterdir()) if path.suffix.lower() == ".png"}
    near = [folder / "JPEGImages", folder]
    pairs = {mask: _image_of(stem, files, near) for stem, mask in masks.items()}
    return [_mask_image(mask, image, settings, colors, values) for mask, image in pairs.items()]


def roboflow_images(folder: pathlib.Path, settings: ImportSettings) -> list[SourceImage]:
    """Return the images of a folder of Roboflow's mask export: ``NAME.jpg``, ``NAME_mask.png``, ``_classes.csv``.

    Raises:
        DataError: ``_classes.csv`` is malformed.
    """
    table = folder / "_classes.csv"
    try:
        rows = list(csv.reader(table.read_text(encoding="utf-8-sig").splitlines()))
        values = {int(value): name.strip() for value, name in (row[:2] for row in rows[1:] if row)}
    except (OSError, ValueError) as error:
        raise DataError(table, f"is not a table of pixel values and classes ({error}); export it again") from error
    images = []
    for mask in sorted(folder.glob("*_mask.png")):
        stem = mask.name.removesuffix("_mask.png")
        image = next((path for suffix in IMAGE_SUFFIXES if (path := folder / f"{stem}{suffix}").is_file()), None)
        images.append(_mask_image(mask, image, settings, {}, values))
    return images


def folder_images(root: pathlib.Path, settings: ImportSettings) -> list[SourceImage]:
    """Return the images of plain folders, and of masks beside their images (``a.jpg``, ``a_mask.png``).

    Raises:
        DataError: no masks are found.
    """
    images: list[SourceImage] = []
    for image_folder, mask_folder in folder_pairs(root, settings):
        by_stem: dict[str, pathlib.Path] = {}
        for path in FolderEntries.of(image_folder).images:
            if image_folder != mask_folder or not _is_mask(path):
                by_stem[path.stem] = path
        for path in FolderEntries.of(mask_folder).images:
            if image_folder == mask_folder and not _is_mask(path):
                continue
            image = by_stem.pop(path.stem, None) or by_stem.pop(_MASK_NAME.sub("", path.stem), None)
            images.append(dataclasses.replace(_mask_image(path, image, settings), mask_file=True))
        images += [unlabeled(path) for path in by_stem.values()]
    return images


def folder_pairs(root: pathlib.Path, settings: ImportSettings) -> list[tuple[pathlib.Path, pathlib.Path]]:
    """Return the folders of images with their folders of masks.

    Raises:
        DataError: there are none.
    """
    if settings.images or settings.masks:
        chosen = root / (settings.images or "."), root / (settings.masks or ".")
        for folder in chosen:
            if not folder.is_dir():
                raise DataError(folder, "is not a folder; give --images and --masks below the source")
        return [chosen]
    pairs = []
    for folder in [root, *sorted(path for path in root.rglob("*") if path.is_dir())]:
        inside = {path.name.lower(): path for path in folder.iterdir() if path.is_dir()}
        image_folders = [inside[name] for name in IMAGE_FOLDERS if name in inside]
        mask_folders = [inside[name] for name in MASK_FOLDERS if name in inside]
        if image_folders and mask_folders:
            pairs.append((image_folders[0], mask_folders[0]))
        elif any(_is_mask(path) for path in FolderEntries.of(folder).images):
            pairs.append((folder, folder))
    if not pairs:
        raise DataError(
            root,
            "holds no images/ with masks/, nor NAME.jpg with NAME_mask.png; give --images and --masks",
        )
    return pairs


def unlabeled(image: pathlib.Path) -> SourceImage:
    """Return an image that the source says nothing about."""
    return SourceImage(image.name, image, frozenset(), lambda _: np.zeros(image_size(image), bool), is_labeled=False)


def _mask_image(
    mask: pathlib.Path,
    image: pathlib.Path | None,
    settings: ImportSettings,
    colors: Mapping[int, str] | None = None,
    values: Mapping[int, str] | None = None,
) -> SourceImage:
    plane = functools.partial(_plane, mask, settings.alpha, colors, values)
    name = image.name if image else mask.name
    try:
        counts = plane().classes
    except DataError:  # the mask is skipped with this error when it is read again
        counts = {}
    notes = (f"{counts['void']} void pixels",) if "void" in counts else ()
    select = functools.partial(_select, plane, settings)
    return SourceImage(name, image, frozenset(counts) - {"void"}, select, notes=notes)


def _plane(
    path: pathlib.Path, alpha: bool, colors: Mapping[int, str] | None, values: Mapping[int, str] | None
) -> MaskPlane:
    """Read a mask so that code 0 is the background, whatever its color."""
    plane = read_mask_plane(path, alpha, colors, values)
    codes, names = plane.codes.astype(np.uint32), dict(plane.names)
    if names.get(0, "background").lower() not in BACKGROUND:
        codes[plane.codes == 0] = _BLACK_CLASS
        names[_BLACK_CLASS] = names.pop(0)
    backgrounds = [code for code, name in names.items() if name.lower() in BACKGROUND]
    codes[np.isin(codes, backgrounds)] = 0
    return dataclasses.replace(plane, codes=codes, names=names)


def _select(plane: "functools.partial[MaskPlane]", settings: ImportSettings, classes: Collection[str]) -> Mask:
    mask = plane().above(settings.threshold) if settings.threshold else plane().select(classes)
    return ~mask if settings.inverted else mask


def _is_mask(path: pathlib.Path) -> bool:
    return re.search(r"[_-](mask|label|labels|seg|segmentation|gt)$", path.stem, re.IGNORECASE) is not None


def _image_of(stem: str, files: Files, near: Iterable[pathlib.Path]) -> pathlib.Path | None:
    for suffix in IMAGE_SUFFIXES:
        for folder in near:
            if (path := folder / f"{stem}{suffix}").is_file():
                return path
    found = [path for path in files.all() if path.stem == stem and not path.parent.name.startswith("Segmentation")]
    return found[0] if len(found) == 1 else None


def _label_map(path: pathlib.Path) -> dict[int, str]:
    """Read CVAT's table of classes: lines ``name:r,g,b:parts:actions``."""
    colors = {}
    try:
        for line in path.read_text(encoding="utf-8-sig").splitlines():
            if line.strip() and not line.startswith("#"):
                name, color = line.split(":")[:2]
                red, green, blue = (int(value) for value in color.split(","))
                colors[red << 16 | green << 8 | blue] = name
    except (OSError, ValueError) as error:
        raise DataError(path, f"is not a table of classes and colors ({error}); export it again") from error
    return colors


def _voc_color(index: int) -> int:
    """Return the color of a VOC class: the bits of the index, three at a time, are the high bits of the channels."""
    channels = [0, 0, 0]
    for level in range(8):
        for channel in range(3):
            channels[channel] |= (index >> (3 * level + channel) & 1) << (7 - level)
    return channels[0] << 16 | channels[1] << 8 | channels[2]
