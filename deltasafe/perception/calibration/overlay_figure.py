"""The figure of evaluated images: label, p_occupied, and the misclassified pixels in color."""

import dataclasses
from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.image import AxesImage
from matplotlib.layout_engine import ConstrainedLayoutEngine
from matplotlib.patches import Patch
from numpy.typing import NDArray

from deltasafe.errors import SettingsError
from deltasafe.perception.calibration.accumulators import valid_pixels
from deltasafe.perception.calibration.metrics import require_label, require_p_occupied, score_image

_LABEL = "#00E5FF"
_MISS = "#FF9F1C"
_CONFIDENT_MISS = "#E4002B"
_FALSE_ALARM = "#4DA3FF"
_IGNORED = "#7A6F8F"


@dataclasses.dataclass(frozen=True)
class Overlay:
    """One evaluated image.

    Attributes:
        image_id: its name.
        image: (H, W, 3) uint8 at the resolution of the label.
        label: (H, W) bool or 0/255.
        p_occupied: (H, W) probability of the ensemble.
        valid: (H, W) pixels that count; None: all.
    """

    image_id: str
    image: NDArray[np.uint8]
    label: NDArray[np.generic]
    p_occupied: NDArray[np.floating]
    valid: NDArray[np.bool_] | None = None


def overlay_figure(overlays: Sequence[Overlay], delta: float = 0.05, thing: str = "hand") -> Figure:
    """Draw one row per image: the image with the label's contour, p_occupied, and the errors in color.

    Missed pixels with ``p_occupied <= delta``, which are free for the planner, have their own color. ``thing`` is the
    display name of the obstacle.

    Raises:
        SettingsError: there is no image, or an image and its label differ in size.
    """
    if not overlays:
        raise SettingsError("an overlay needs at least one image")
    heights_in = [3.55 * height / width + 0.28 for height, width in (np.shape(one.label) for one in overlays)]
    layout = ConstrainedLayoutEngine(h_pad=0.06, rect=(0, 0, 1, 0.99))
    figure = Figure(figsize=(11, sum(heights_in) + 0.85), layout=layout)
    grid = figure.subplots(len(overlays), 3, squeeze=False, height_ratios=heights_in)
    for axes, overlay in zip(grid, overlays, strict=True):
        picture = _draw_row(axes, overlay, delta, thing)
    bar = figure.colorbar(picture, ax=list(grid[:, 1]), location="bottom", aspect=30, shrink=0.9, pad=0.01)
    bar.set_label("$p_\\mathrm{occupied}$")
    handles = [
        Patch(facecolor=_CONFIDENT_MISS, label=f"{thing} missed, $p_\\mathrm{{occupied}} \\leq {delta:g}$"),
        Patch(facecolor=_MISS, label=f"{thing} missed, $p_\\mathrm{{occupied}} < 0.5$"),
        Patch(facecolor=_FALSE_ALARM, label="false alarm"),
        Patch(facecolor="none", edgecolor=_LABEL, lw=1.5, label="label"),
    ]
    if any(overlay.valid is not None for overlay in overlays):
        handles.append(Patch(facecolor=_IGNORED, label="ignored"))
    figure.legend(handles=handles, loc="outside lower center", ncols=len(handles), frameon=False, fontsize=10)
    return figure


def _draw_row(axes: Sequence[Axes], overlay: Overlay, delta: float, thing: str) -> AxesImage:
    occupied = require_label(overlay.label)
    p_occupied = require_p_occupied(overlay.p_occupied, occupied.shape)
    if overlay.image.shape != (*occupied.shape, 3) or overlay.image.dtype != np.uint8:
        raise SettingsError(
            f"the image of {overlay.image_id} must be uint8 of shape {(*occupied.shape, 3)}, "
            f"got {overlay.image.dtype} {overlay.image.shape}"
        )
    scores = score_image(*valid_pixels(p_occupied, occupied, overlay.valid))
    axes[0].imshow(overlay.image)
    axes[0].set_title(f"{overlay.image_id}:  mIoU {scores.miou:.3f}", fontsize=10, loc="left")
    picture = axes[1].imshow(p_occupied, vmin=0.0, vmax=1.0, cmap="magma")
    errors = _errors(overlay.image, occupied, p_occupied, delta)
    if overlay.valid is not None:
        errors[~overlay.valid] = to_rgb(_IGNORED)
    axes[2].imshow(errors)
    rate = scores.missed_hand_rate
    missed = f"no {thing}" if rate is None else f"missed {rate:.1%} of the {thing}"
    alarms = "" if scores.false_alarm_rate is None else f", false alarms {scores.false_alarm_rate:.1%}"
    axes[2].set_title(missed + alarms, fontsize=10, loc="left")
    for panel in axes:
        panel.set_axis_off()
    if occupied.any() and not occupied.all():
        for panel in axes[:2]:
            panel.contour(occupied, levels=[0.5], colors=[_LABEL], linewidths=0.8)
    return picture


def _errors(
    image: NDArray[np.uint8], occupied: NDArray[np.bool_], p_occupied: NDArray[np.float64], delta: float
) -> NDArray[np.float64]:
    gray = image @ np.array([0.299, 0.587, 0.114]) / 255
    canvas = np.repeat((0.45 * gray + 0.08 + 0.22 * occupied)[:, :, None], 3, axis=2)
    predicted = p_occupied >= 0.5
    canvas[occupied & ~predicted] = to_rgb(_MISS)
    canvas[occupied & (p_occupied <= delta)] = to_rgb(_CONFIDENT_MISS)
    canvas[~occupied & predicted] = to_rgb(_FALSE_ALARM)
    return canvas
