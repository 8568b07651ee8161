"""Convert the labels of other tools to a set of images and masks."""

import collections
import dataclasses
import pathlib
import re
import shutil
import unicodedata
from collections.abc import Collection, Sequence
from typing import ClassVar

import cv2
import numpy as np

from deltasafe.errors import DataError, SettingsError
from deltasafe.io.storage import atomic_folder, digest_of, write_json
from deltasafe.perception.data.dataset_info import DatasetInfo, SetOptions
from deltasafe.perception.data.importing.formats import read_source
from deltasafe.perception.data.importing.mask_sheets import write_mask_sheets
from deltasafe.perception.data.importing.settings import ImportSettings
from deltasafe.perception.data.importing.source import LabelSource, SourceImage
from deltasafe.perception.data.labeled_images import LabeledImage, LabeledImageSet, read_labeled
from deltasafe.perception.data.masks import ANY_CLASS, polarity_defect
from deltasafe.reporting.markdown import table

_MAX_LISTED = 20


@dataclasses.dataclass(frozen=True)
class ImportedImage:
    """What became of one image of the source.

    Attributes:
        source: its name in the source.
        id: in the new set; empty if it was skipped.
        marked: fraction of the image that is obstacle.
        reason: why it was skipped; else notes.
    """

    source: str
    id: str = ""
    marked: float = 0.0
    reason: str = ""


@dataclasses.dataclass(frozen=True)
class ImportReport:
    """Result of a conversion.

    Attributes:
        folder: of the new set.
        format: of the source.
        classes: that are the obstacle.
        obstacle: what the new set calls them.
        images: of the source, in its order.
    """

    RECORD: ClassVar[str] = "import.json"
    TABLE: ClassVar[str] = "import.md"
    SHEET: ClassVar[str] = "contact_sheet.jpg"
    folder: pathlib.Path
    format: str
    classes: tuple[str, ...]
    obstacle: str
    images: tuple[ImportedImage, ...]

    @property
    def skipped(self) -> tuple[ImportedImage, ...]:
        """Return the images that were not converted."""
        return tuple(image for image in self.images if not image.id)

    def text(self) -> str:
        """Format the result as Markdown."""
        rows = [
            (image.source, image.id or "skipped", f"{image.marked:.1%}" if image.id else "", image.reason)
            for image in sorted(self.images, key=lambda image: bool(image.id))
        ]
        return f"{self.summary()}\n\n{table(('source', 'image', 'marked', 'note'), rows)}\n"

    def summary(self) -> str:
        """Say in one sentence what was converted."""
        n = len(self.images) - len(self.skipped)
        obstacle = f"{', '.join(self.classes)} (recorded as {self.obstacle})"
        return f"{n} images of the format {self.format}, obstacle: {obstacle}; {len(self.skipped)} skipped"


def import_hands(
    source: str | pathlib.Path, folder: str | pathlib.Path, settings: ImportSettings | None = None
) -> ImportReport:
    """Convert labels of another tool to a set that `LabeledImageSet.load` reads; writes it atomically.

    The new folder holds ``images/``, ``masks/``, a contact sheet of all masks over their images, and a table of what
    was converted and what was skipped (``import.md``, ``import.json``).

    Args:
        source: the label file, or the folder with labels and images.
        folder: to write; it must be missing or empty.
        settings: format, classes, and how masks are read.

    Raises:
        DataError: the source is unreadable or its meaning is ambiguous, nothing can be converted, or ``folder`` is
            in use.
        SettingsError: the obstacle cannot be named after its classes.
    """
    source, folder, settings = pathlib.Path(source), pathlib.Path(folder), settings or ImportSettings()
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise DataError(folder, "exists already; give a new folder")
    labels = read_source(source, settings)
    classes = _chosen_classes(source, labels, settings)
    own = (
        SetOptions.load(source) if labels.format == "folder" else SetOptions("" if labels.has_mask_files else "upright")
    )
    if not (settings.large_masks or own.large_masks):
        _check_polarity(source, labels, classes)
    info = _dataset_info(source, labels, classes, settings)
    # outlines and named classes cannot be inverted, and plain masks are checked above
    options = SetOptions(settings.masks_drawn_on or own.masks_drawn_on, large_masks=True)
    with atomic_folder(folder) as temporary:
        images = _convert(labels, classes, settings, options, temporary)
        report = ImportReport(folder, labels.format, tuple(classes), info.obstacle, images)
        if not any(image.marked for image in images):
            raise DataError(source, f"marks no obstacle that can be converted: {_reasons(images)}; label images")
        info.save(temporary, options)
        write_mask_sheets(LabeledImageSet.load(temporary), temporary / report.SHEET)
        (temporary / report.TABLE).write_text(report.text(), encoding="utf-8")
        record = {"format": labels.format, "settings": settings, "classes": classes, "images": images}
        write_json(temporary / report.RECORD, record)
    return report


def source_digest(source: pathlib.Path, settings: ImportSettings) -> str:
    """Return a digest of a conversion: the settings, and path, size and time of every file of the source."""
    files = sorted(source.rglob("*")) if source.is_dir() else [source, *sorted(source.parent.rglob("*"))]
    states = [(path.as_posix(), path.stat().st_size, path.stat().st_mtime_ns) for path in files if path.is_file()]
    return digest_of([settings, str(source.resolve()), states])


def _chosen_classes(source: pathlib.Path, labels: LabelSource, settings: ImportSettings) -> list[str]:
    """Return the classes that are the obstacle.

    Raises:
        DataError: none is found, the choice is ambiguous, or a chosen one does not occur; lists what was found.
    """
    counts = collections.Counter(name for image in labels.images for name in image.classes)
    ranked = sorted(counts.items(), key=lambda entry: (-entry[1], entry[0]))
    listed = ", ".join(f"{name} ({n} images)" for name, n in ranked[:_MAX_LISTED]) or "none"
    if settings.threshold:
        return [f">= {settings.threshold:g}"]
    if ANY_CLASS in settings.classes:
        return sorted(counts)
    if unknown := [name for name in settings.classes if name not in counts and name != "void"]:
        raise DataError(source, f"has no class {', '.join(unknown)}; choose from those found: {listed}")
    if not settings.classes and len(counts) > 1:
        soft = ", or --threshold 0.5 if the masks are soft" if any(image.mask_file for image in labels.images) else ""
        raise DataError(source, f"has several classes: {listed}; give --class for each that is the obstacle{soft}")
    return list(settings.classes) or sorted(counts)


def _dataset_info(
    source: pathlib.Path, labels: LabelSource, classes: list[str], settings: ImportSettings
) -> DatasetInfo:
    """Return what the new set calls its obstacle; a source of our own format keeps its information.

    Raises:
        DataError: the ``dataset.json`` of the source is invalid.
        SettingsError: ``settings.obstacle`` is no identifier.
    """
    if settings.obstacle:
        return DatasetInfo(settings.obstacle)
    if labels.format == "folder":
        return DatasetInfo.load(source)
    names = [re.sub(r"[^a-z0-9]+", "_", name.lower()).strip("_") for name in classes]
    if all(re.search(r"(^|_)(left|right)?hands?($|_)", name) or name.isdigit() for name in names):
        return DatasetInfo()
    obstacle = "_or_".join(names)
    if not re.fullmatch(r"[a-z][a-z0-9_]{0,49}", obstacle):
        raise SettingsError(f"the obstacle needs a name for {', '.join(classes)}; give --obstacle, for example cup")
    return DatasetInfo(obstacle)


def _check_polarity(source: pathlib.Path, labels: LabelSource, classes: list[str]) -> None:
    """Refuse mask files that are probably inverted.

    Raises:
        DataError: lists them.
    """
    found = []
    for image in labels.images:
        if image.mask_file and (defect := polarity_defect(image.mask(classes))):
            found.append(f"{image.name} {defect}")
    if found:
        more = f"\n- and {len(found) - _MAX_LISTED} more" if len(found) > _MAX_LISTED else ""
        listed = "".join(f"\n- {text}" for text in found[:_MAX_LISTED])
        raise DataError(source, f"give --inverted if they are, --large-masks if they are right:{listed}{more}")


def _convert(
    labels: LabelSource, classes: list[str], settings: ImportSettings, options: SetOptions, folder: pathlib.Path
) -> tuple[ImportedImage, ...]:
    for name in ("images", "masks"):
        (folder / name).mkdir()
    converted = []
    for image, stem in zip(labels.images, _stems(labels.images), strict=True):
        suffix = image.image.suffix.lower() if isinstance(image.image, pathlib.Path) else ".png"
        item = LabeledImage(stem, folder / "images" / f"{stem}{suffix}", folder / "masks" / f"{stem}.png")
        if reason := _reason_to_skip(image, settings):
            converted.append(ImportedImage(image.name, reason=reason))
            continue
        try:
            marked = _convert_image(image, item, classes, options)
            converted.append(ImportedImage(image.name, stem, marked, "; ".join(image.notes)))
        except (KeyError, IndexError, TypeError, ValueError, AttributeError, OSError) as error:  # a malformed region
            item.image.unlink(missing_ok=True)
            item.mask.unlink(missing_ok=True)
            reason = error.reason if isinstance(error, DataError) else f"has a label that cannot be used: {error}"
            if "masks_drawn_on" in reason:
                reason = "has an EXIF orientation; give --masks-drawn-on upright, or stored"
            converted.append(ImportedImage(image.name, reason=" ".join(reason.split())[:300]))
    return tuple(converted)


def _reason_to_skip(image: SourceImage, settings: ImportSettings) -> str:
    if image.image is None:
        return "the image is missing, or its name fits two files; give the folder of the images by --images"
    if not image.is_labeled and not settings.keep_unlabeled:
        return "has no annotation; --keep-unlabeled takes it as free of the obstacle"
    return ""


def _convert_image(image: SourceImage, item: LabeledImage, classes: Collection[str], options: SetOptions) -> float:
    """Write image and mask, and read them as a set is read; return the fraction that is marked."""
    mask = image.mask(classes)
    if isinstance(image.image, pathlib.Path):
        shutil.copyfile(image.image, item.image)
    else:
        item.image.write_bytes(image.image or b"")
    item.mask.write_bytes(cv2.imencode(".png", mask.astype(np.uint8) * 255)[1].tobytes())
    read_labeled(item, options)
    return float(mask.mean())


def _stems(images: Sequence[SourceImage]) -> list[str]:
    """Return a distinct file name for each image: its own, with that of its folder where two are equal."""
    short = [_clean(pathlib.PurePosixPath(image.name.replace("\\", "/")).stem) for image in images]
    counts = collections.Counter(name.casefold() for name in short)
    taken: set[str] = set()
    stems = []
    for image, name in zip(images, short, strict=True):
        parent = image.image.parent.name if isinstance(image.image, pathlib.Path) else ""
        stem = name if counts[name.casefold()] == 1 or not parent else f"{_clean(parent)}_{name}"
        candidate, n = stem, 2
        while candidate.casefold() in taken:
            candidate, n = f"{stem}_{n}", n + 1
        taken.add(candidate.casefold())
        stems.append(candidate)
    return stems


def _clean(name: str) -> str:
    return re.sub(r"[\x00-\x1f/\\:*?\"<>|]", "_", unicodedata.normalize("NFC", name)).lstrip(".") or "image"


def _reasons(images: Sequence[ImportedImage]) -> str:
    reasons = collections.Counter(image.reason for image in images)
    return ", ".join(f"{n} x {reason}" for reason, n in reasons.most_common(5)) or "no image"
