"""Originals beside what the augmentation made of them, every mask outlined: for a person to judge."""

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

__all__ = ["contact_sheet", "scheme_sheet"]

OUTLINE = (0.0, 0.85, 1.0)
LETTERS = {
    "flip": "flip",
    "rotation": "turn",
    "grid_distortion": "grid",
    "cropping": "crop",
    "color": "color",
    "noise": "noise",
    "random_erase": "erase",
}


def contact_sheet(
    hands: LabeledImageSet,
    augmented: AugmentedSet,
    destination: str | pathlib.Path,
    n_originals: int = 6,
    n_variants: int = 10,
) -> pathlib.Path:
    """Draw ``n_originals`` rows, evenly chosen: the original, then its first ``n_variants`` new images.

    Args:
        hands: the originals.
        augmented: what was made of them.
        destination: a picture file, written atomically; its suffix chooses the format.
        n_originals: rows; at most as many as there are originals.
        n_variants: new images in a row; at most as many as each original has.

    Returns:
        ``destination``.

    Raises:
        DataError: ``augmented`` was made from other originals.
    """
    destination = pathlib.Path(destination)
    if augmented.source_digest != hands.digest:
        raise DataError(augmented.folder, f"was not made from the set {hands.name!r}; write the augmented set again")
    rows = np.unique(np.linspace(0, len(hands) - 1, min(n_originals, len(hands))).round().astype(int))
    columns = min(n_variants, augmented.settings.n_variants)
    aspect = augmented.settings.height / augmented.settings.width
    cell_in, gap_in, label_in, head_in = 1.6, 0.04, 0.11, 0.2
    width_in = (columns + 1) * (cell_in + gap_in) + gap_in
    row_in = cell_in * aspect + label_in
    height_in = len(rows) * (row_in + gap_in) + head_in + gap_in
    with mpl.rc_context({"font.size": 6.0}):
        figure = Figure(figsize=(width_in, height_in), dpi=180)
        FigureCanvasAgg(figure)
        title = f"{hands.name}: {len(hands)} originals (left), {augmented.n} new images; outlined: mask"
        figure.text(gap_in / width_in, 1 - 0.5 * head_in / height_in, title, fontsize=7, va="center")
        axes = np.empty((len(rows), columns + 1), dtype=object)
        for r, c in np.ndindex(axes.shape):
            left, bottom = (
                gap_in + c * (cell_in + gap_in),
                height_in - head_in - r * (row_in + gap_in) - row_in,
            )
            box = (left / width_in, bottom / height_in, cell_in / width_in, cell_in * aspect / height_in)
            axes[r, c] = figure.add_axes(box)
        for row, original in zip(axes, rows, strict=True):
            _draw(row[0], *hands.read(int(original)), hands.items[original].id)
            first = int(original) * augmented.settings.n_variants
            for column, axis in enumerate(row[1:]):
                i = first + column
                _draw(axis, augmented.images[i], augmented.masks[i], _label(augmented.recipes[i]))
        with atomic_file(destination) as temporary:
            figure.savefig(temporary, facecolor="white")
    return destination


def scheme_sheet(sets: Mapping[str, AugmentedSet], n_images: int = 8) -> Figure:
    """A row for each scheme: new images of evenly chosen originals, the share of hand outlined at one half.

    Args:
        sets: by title, at least one.
        n_images: in a row.
    """
    aspect = max(made.settings.height / made.settings.width for made in sets.values())
    with mpl.rc_context({"font.size": 7.0}):
        figure = Figure(figsize=(1.5 * n_images, 1.5 * aspect * len(sets) + 0.25 * len(sets)), layout="constrained")
        all_axes = figure.subplots(len(sets), n_images, squeeze=False)
        for row, (title, made) in zip(all_axes, sets.items(), strict=True):
            chosen = np.linspace(0, made.n - 1, n_images).round().astype(int)
            shares = made.labels(chosen)
            for axis, image, share in zip(row, made.images[chosen], shares, strict=True):
                _draw(axis, image, share, "")
            row[0].set_title(f"{title}, {made.n_distinct} different of {made.n}", fontsize=8, loc="left", pad=3)
    return figure


def _draw(axis: Any, image: np.ndarray, mask: np.ndarray, title: str) -> None:
    height, width = mask.shape
    axis.imshow(image, interpolation="lanczos", extent=(0, width, height, 0), aspect="equal")
    padded = cv2.copyMakeBorder(np.ascontiguousarray(mask), 1, 1, 1, 1, cv2.BORDER_CONSTANT, value=0)
    if padded.any():
        x, y = np.arange(-0.5, width + 1), np.arange(-0.5, height + 1)
        axis.contour(x, y, padded, levels=[0.5], colors=[OUTLINE], linewidths=0.45)
    axis.set(xlim=(0, width), ylim=(height, 0), xticks=[], yticks=[])
    axis.set_title(title, fontsize=4.6, pad=1.5, color="0.25")
    for spine in axis.spines.values():
        spine.set_visible(False)


def _label(recipe: dict[str, Any]) -> str:
    steps = [step["method"] for step in recipe["operations"]]
    return " ".join(word for name, word in LETTERS.items() if name in steps) or "background only"
