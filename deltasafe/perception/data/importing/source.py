"""Labels of a source, before conversion: images with the classes that are marked in them."""

import contextlib
import dataclasses
import io
import pathlib
import unicodedata
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from deltasafe.errors import DataError
from deltasafe.io.folder_entries import IMAGE_SUFFIXES, is_clutter
from deltasafe.io.images import decode_image
from deltasafe.io.storage import parse_json
from deltasafe.perception.data.importing.settings import ImportSettings

Mask = NDArray[np.bool_]
BACKGROUND = frozenset({"_background_", "background", "__ignore__"})
"""Labels that mark the background: a shape with one of them is painted over others, and is no class."""


@dataclasses.dataclass(frozen=True)
class SourceImage:
    """An image as its source names it.

    Attributes:
        name: of the image in the source.
        image: the file, its bytes if the label file contains it, or None if it is missing.
        classes: that are marked in it.
        mask: returns the pixels ``(H, W)`` of some classes.
        is_labeled: whether the source says what the image shows, even if it is nothing.
        notes: what was left out or decided, for the table.
        mask_file: whether the label is a mask file without class names, which may be inverted.
    """

    name: str
    image: pathlib.Path | bytes | None
    classes: frozenset[str]
    mask: Callable[[Collection[str]], Mask]
    is_labeled: bool = True
    notes: tuple[str, ...] = ()
    mask_file: bool = False


@dataclasses.dataclass(frozen=True)
class LabelSource:
    """All images of a source.

    Attributes:
        format: that was read.
        images: in the order of the source.
        has_mask_files: whether the labels are mask files, and not outlines.
    """

    format: str
    images: tuple[SourceImage, ...]
    has_mask_files: bool


@dataclasses.dataclass(frozen=True)
class Shape:
    """A marked region.

    Attributes:
        label: its class.
        draw: returns its pixels for a height and a width; a ValueError says why it has none.
        is_rectangle: whether it is only a box around something.
    """

    label: str
    draw: Callable[[int, int], Mask]
    is_rectangle: bool = False


@dataclasses.dataclass(frozen=True)
class Drawing:
    """The shapes of an image.

    Attributes:
        shapes: in the order in which they are drawn.
        size: height and width that they refer to; None: that of the image file.
        paints: whether a shape hides those before it, also those of other classes; else shapes may overlap.
    """

    shapes: Sequence[Shape]
    size: tuple[int, int] | None
    paints: bool


def shape_image(
    name: str,
    image: pathlib.Path | bytes | None,
    drawing: Drawing,
    settings: ImportSettings,
    *,
    is_labeled: bool,
    notes: tuple[str, ...] = (),
) -> SourceImage:
    """Return an image whose label is a drawing; see `SourceImage`. The settings say what rectangles mean."""
    shapes = drawing.shapes
    if settings.rectangles == "ignore":
        shapes = [shape for shape in shapes if not shape.is_rectangle]
    classes = frozenset(shape.label for shape in shapes) - BACKGROUND
    fills = settings.rectangles == "fill"

    def mask(chosen: Collection[str]) -> Mask:
        height, width = drawing.size or image_size(image)
        marked = np.zeros((height, width), bool)
        for shape in shapes:
            is_chosen = shape.label in chosen
            if shape.is_rectangle and not fills:
                if is_chosen:
                    raise ValueError(f"a rectangle of {shape.label}; give --rectangles fill, or ignore")
            elif is_chosen or drawing.paints:
                marked[shape.draw(height, width)] = is_chosen
        return marked

    return SourceImage(name, image, classes, mask, is_labeled, notes)


class Files:
    """The image files below a folder, found by the references of label files."""

    def __init__(self, root: pathlib.Path) -> None:
        self.root = root
        self._by_name: dict[str, list[pathlib.Path]] = {}
        for path in sorted(root.rglob("*")):
            is_image = path.suffix.lower() in IMAGE_SUFFIXES and not is_clutter(*path.relative_to(root).parts)
            if is_image and path.is_file():
                self._by_name.setdefault(_normal(path.name), []).append(path)

    def all(self) -> list[pathlib.Path]:
        """Return all image files."""
        return sorted(path for paths in self._by_name.values() for path in paths)

    def find(self, reference: str, *near: pathlib.Path) -> pathlib.Path | None:
        """Return the file that ``reference`` names: relative to a folder of ``near``, or the only one that ends so.

        Of several files with the same name, the one with the longest common end of the path is taken; None if there is
        no file, or if two fit equally.
        """
        parts = [_normal(part) for part in reference.replace("\\", "/").split("/") if part not in ("", ".", "..")]
        if not parts:
            return None
        for folder in near:
            if (direct := folder / reference.replace("\\", "/")).is_file():
                return direct
        found = self._by_name.get(parts[-1], [])
        matches = [_common_end([_normal(part) for part in path.parts], parts) for path in found]
        best = [path for path, match in zip(found, matches, strict=True) if match == max(matches)]
        return best[0] if len(best) == 1 else None


def parse_labels(path: pathlib.Path) -> Any:
    """Parse a JSON file of labels, in UTF-8 or UTF-16, with or without a byte order mark.

    Raises:
        DataError: the file is missing or is not JSON.
    """
    with label_errors(path):
        try:
            return parse_json(path.read_bytes())
        except OSError as error:
            raise DataError(path, f"cannot be read ({error.strerror}); restore the file") from error


@contextlib.contextmanager
def label_errors(path: pathlib.Path) -> Iterator[None]:
    """Translate the errors of malformed records to a DataError about the label file."""
    try:
        yield
    except DataError:
        raise
    except (AttributeError, KeyError, IndexError, TypeError, ValueError, OverflowError) as error:
        reason = f"{type(error).__name__}: {' '.join(str(error).split())[:120]}"
        raise DataError(path, f"cannot be read as labels ({reason}); export it again") from error


def image_size(image: pathlib.Path | bytes | None) -> tuple[int, int]:
    """Return height and width of an image, upright.

    Raises:
        DataError: the file cannot be read.
        ValueError: the image is missing, or its bytes cannot be read.
    """
    if isinstance(image, pathlib.Path):
        width, height = decode_image(image).size
        return height, width
    if image is None:
        raise ValueError("the image is missing, and the label file does not give its size")
    try:
        with Image.open(io.BytesIO(image)) as opened:
            return opened.height, opened.width
    except (OSError, Image.DecompressionBombError) as error:
        raise ValueError("the image in the label file cannot be read") from error


def numbers(value: Any, columns: int = 2) -> NDArray[np.float64]:
    """Convert nested lists of numbers to an array with the given number of columns.

    Raises:
        ValueError: it is none, or a number is not finite.
    """
    array = np.asarray(value, dtype=np.float64).reshape(-1, columns)
    if not np.isfinite(array).all():
        raise ValueError("a coordinate is not finite")
    return array


def side_lengths(value: Mapping[str, Any], height: str = "height", width: str = "width") -> tuple[int, int]:
    """Return height and width of a record.

    Raises:
        ValueError: one is missing, or is not a positive integer.
    """
    found = value.get(height), value.get(width)
    if not all(isinstance(side, int) and not isinstance(side, bool) and 0 < side < 100_000 for side in found):
        raise ValueError(f"{height} and {width} must be positive integers, got {found[0]!r} and {found[1]!r}")
    return int(found[0]), int(found[1])  # type: ignore[arg-type]


def _normal(name: str) -> str:
    return unicodedata.normalize("NFC", name)


def _common_end(one: list[str], other: list[str]) -> int:
    n = 0
    while n < min(len(one), len(other)) and one[-1 - n] == other[-1 - n]:
        n += 1
    return n
