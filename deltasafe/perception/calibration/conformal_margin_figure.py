"""The figure of conformal margins: margins over alpha, and the image with the largest score."""

import math

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from numpy.typing import NDArray

from deltasafe.errors import SettingsError
from deltasafe.perception.calibration.conformal_margin import (
    REFERENCE_WIDTH_PX,
    ConformalMargin,
    ConformalMargins,
    distance_to_unsafe_px,
)
from deltasafe.perception.calibration.curve_drawing import BLUE, ORANGE, RED
from deltasafe.perception.calibration.metrics import require_labeled_prediction
from deltasafe.perception.calibration.overlay_figure import Overlay
from deltasafe.perception.calibration.report import CalibrationReport
from deltasafe.reporting.panels import style_axes

_HAND = "#00E5FF"
_DELTAS = (0.02, 0.05, 0.2)
_COLORS = (BLUE, ORANGE, RED)


def conformal_margin_figure(report: CalibrationReport, worst: Overlay | None = None) -> Figure:
    """Draw the margins over alpha for a few deltas, and one image with the margin around it.

    Args:
        report: with margins.
        worst: image to draw on the left, usually `CalibrationReport.farthest_missed`. Its hand is colored by what
            covers it: p_occupied > delta, the margin, or nothing. Its p_occupied has the temperature that is stored
            with the ensemble; the score was computed with one that was fitted without the image.

    Raises:
        SettingsError: the report holds no margins.
    """
    margins = report.final.margins
    if margins is None:
        raise SettingsError("the stored report has no margins; calibrate again")
    margin = margins.margin(report.grid_delta, margins.stated_alpha)
    figure = Figure(figsize=(11 if worst else 6, 4.2), layout="constrained")
    if worst is None:
        axes = figure.subplots()
    else:
        left, axes = figure.subplots(1, 2, width_ratios=[1.1, 1])
        farthest = report.final.hausdorff_at(report.grid_delta)[report.image_ids.index(worst.image_id)]
        _draw_image(left, worst, margin, farthest, report.info.singular)
    _draw_margins(axes, margins, sorted({*_DELTAS, report.grid_delta}))
    return figure


def _draw_margins(axes: Axes, margins: ConformalMargins, deltas: list[float]) -> None:
    n = margins.n_images
    alphas = [k / (n + 1) for k in range(1, n + 1)]
    for delta, color in zip(deltas, [*_COLORS, "black"], strict=False):
        px = np.array([margins.margin(delta, alpha).px for alpha in alphas])
        finite = np.isfinite(px)
        label = f"delta = {delta:g}" + ("" if finite.all() else f", infinite for {n - finite.sum()} smallest alphas")
        axes.plot(
            100 * np.array(alphas)[finite],
            px[finite],
            drawstyle="steps-post",
            marker=".",
            ms=4,
            color=color,
            label=label,
        )
    axes.set(xscale="log", xlabel="alpha [%]", ylabel=f"Margin [px of {REFERENCE_WIDTH_PX}]", ylim=(0, None))
    ticks = [tick for tick in (0.1, 0.2, 0.5, 1, 2, 5, 10, 20, 50, 100) if tick >= 100 * alphas[0]]
    axes.set_xticks(ticks, [f"{tick:g}" for tick in ticks])
    axes.set_xticks([], minor=True)
    axes.set_title(f"Margin of {n} images", fontsize=11)
    axes.legend(frameon=False, fontsize=9)
    style_axes(axes)


def _draw_image(axes: Axes, worst: Overlay, margin: ConformalMargin, farthest: float, thing: str) -> None:
    """Draw the obstacle and what covers it; ``farthest`` is the score of the image in the report."""
    p_occupied, hand = require_labeled_prediction(worst.p_occupied, worst.label)
    distance = distance_to_unsafe_px(p_occupied > margin.delta) / hand.shape[1]
    covered = distance <= margin.fraction_of_width
    by_margin, missed = hand & (distance > 0.0) & covered, hand & ~covered
    axes.imshow(_colored(worst.image, by_margin, missed))
    for mask, color, style in (
        (hand, _HAND, "solid"),
        (distance == 0.0, "white", "solid"),
        (covered, "white", "dashed"),
    ):
        if mask.any() and not mask.all():
            axes.contour(mask, levels=[0.5], colors=[color], linewidths=1.0, linestyles=style)
    axes.set_title(
        f"{worst.image_id}:  farthest {_px(farthest)} px, margin {_px(margin.fraction_of_width)} px", fontsize=10
    )
    axes.set_axis_off()
    handles = [
        Line2D([], [], color=_HAND, label=f"{thing} (label)"),
        Line2D([], [], color="gray", label=f"$p_\\mathrm{{occupied}} > {margin.delta:g}$ (white)"),
        Line2D([], [], color="gray", ls="--", label=f"with margin, alpha = {margin.alpha:.2g}"),
        Patch(facecolor=ORANGE, label=f"{thing} covered by the margin"),
        Patch(facecolor=RED, label=f"{thing} not covered"),
    ]
    axes.legend(handles=handles, loc="upper center", bbox_to_anchor=(0.5, -0.01), ncols=3, frameon=False, fontsize=8)


def _px(fraction_of_width: float) -> str:
    return "infinite" if math.isinf(fraction_of_width) else f"{REFERENCE_WIDTH_PX * fraction_of_width:.1f}"


def _colored(image: NDArray[np.uint8], by_margin: NDArray[np.bool_], missed: NDArray[np.bool_]) -> NDArray[np.float64]:
    canvas = 0.75 * image / 255
    canvas[by_margin], canvas[missed] = to_rgb(ORANGE), to_rgb(RED)
    return canvas
