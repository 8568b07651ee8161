"""Sheets for visual inspection: originals beside their augmented images, with the outlines of the masks."""

import pathlib
from collections.abc import Mapping
from typing import Any

import cv2
import matplotlib as mpl
import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from deltasafe.errors import DataError
from deltasafe.io.storage import atomic_file
from deltasafe.perception.data.augmented_set import AugmentedSet
from deltasafe.perception.data.labeled_images import LabeledImageSet
from deltasafe.perception.data.labeled_images_figure import evenly_spaced

_SHOWN_PIXELS = 2**18
OUTLINE_RGB = (0.0, 0.85, 1.0)
METHOD_LABELS = {
    "flip": "flip",
    "rotation": "turn",
    "grid_distortion": "grid",
    "cropping": "crop",
    "color": "color",
    "noise": "noise",
    "random_erase": "erase",
}


def contact_sheet(
    images: LabeledImageSet,
    augmented: AugmentedSet,
    destination: str | pathlib.Path,
    n_originals: int = 6,
    n_variants: int = 10,
) -> None:
    """Draw rows of an original and its first variants, for evenly spaced originals.

    Args:
        images: the originals.
        augmented: the augmented set that was made from them.
        destination: an image file, written atomically; its suffix selects the format.
        n_originals: number of rows, at most.
        n_variants: variants in a row, at most.

    Raises:
        DataError: ``augmented`` was made from other originals.
    """
    if augmented.source_digest != images.digest:
        raise DataError(augmented.folder, f"was not made from the set {images.name!r}; make the augmented set again")
    rows = evenly_spaced(len(images), n_originals)
    per_original = augmented.settings.n_variants
    n_columns = 1 + min(n_variants, per_original)
    cell_in, gap_in, label_in, title_in = 1.6, 0.04, 0.11, 0.2
    image_in = cell_in * augmented.settings.height / augmented.settings.width
    width_in = n_columns * (cell_in + gap_in) + gap_in
    height_in = len(rows) * (image_in + label_in + gap_in) + title_in + gap_in
    with mpl.rc_context({"font.size": 6.0}):
        figure = Figure(figsize=(width_in, height_in), dpi=180)
        FigureCanvasAgg(figure)
        title = f"{images.name}: {len(images)} originals (left), {augmented.n} new images; outlined: mask"
        figure.text(gap_in / width_in, 1 - 0.5 * title_in / height_in, title, fontsize=7, va="center")
        grid = {
            "left": gap_in / width_in,
            "right": 1 - gap_in / width_in,
            "bottom": 2 * gap_in / height_in,
            "top": 1 - (title_in + label_in) / height_in,
            "wspace": gap_in / cell_in,
            "hspace": (label_in + gap_in) / image_in,
        }
        axes = figure.subplots(len(rows), n_columns, squeeze=False, gridspec_kw=grid)
        for row, original in zip(axes, rows, strict=True):
            _draw(row[0], *images.read(original, _SHOWN_PIXELS), images.items[original].id)
            for i, axis in enumerate(row[1:], start=original * per_original):
                _draw(axis, augmented.images[i], augmented.masks[i], _methods_label(augmented.recipes[i]))
        with atomic_file(destination) as temporary:
            figure.savefig(temporary, facecolor="white")


def scheme_sheet(sets: Mapping[str, AugmentedSet], n_images: int = 8) -> Figure:
    """Draw a row of evenly spaced images of each augmented set; soft masks are outlined at 0.5.

    Args:
        sets: by title, at least one.
        n_images: images in a row.
    """
    aspect = max(augmented.settings.height / augmented.settings.width for augmented in sets.values())
    with mpl.rc_context({"font.size": 7.0}):
        figure = Figure(figsize=(1.5 * n_images, 1.5 * aspect * len(sets) + 0.25 * len(sets)), layout="constrained")
        all_axes = figure.subplots(len(sets), n_images, squeeze=False)
        for row, (title, augmented) in zip(all_axes, sets.items(), strict=True):
            chosen = np.linspace(0, augmented.n - 1, n_images).round().astype(int)
            for axis, image, mask in zip(row, augmented.images[chosen], augmented.labels(chosen), strict=True):
                _draw(axis, image, mask, "")
            heading = f"{title}, {augmented.n_distinct} different of {augmented.n}"
            row[0].set_title(heading, fontsize=8, loc="left", pad=3)
    return figure


def _draw(axis: Any, image: np.ndarray, mask: np.ndarray, title: str) -> None:
    height, width = mask.shape
    axis.imshow(image, interpolation="lanczos", extent=(0, width, height, 0), aspect="equal")
    padded = cv2.copyMakeBorder(np.ascontiguousarray(mask), 1, 1, 1, 1, cv2.BORDER_CONSTANT, value=0)
    if padded.any():
        x, y = np.arange(-0.5, width + 1), np.arange(-0.5, height + 1)
        axis.contour(x, y, padded, levels=[0.5], colors=[OUTLINE_RGB], linewidths=0.45)
    axis.set(xlim=(0, width), ylim=(height, 0), xticks=[], yticks=[])
    axis.set_title(title, fontsize=4.6, pad=1.5, color="0.25")
    axis.spines[:].set_visible(False)


def _methods_label(recipe: dict[str, Any]) -> str:
    methods = [step["method"] for step in recipe["operations"]]
    return " ".join(label for name, label in METHOD_LABELS.items() if name in methods) or "background only"
