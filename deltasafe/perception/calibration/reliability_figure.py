"""The figure of reliability: the diagram of the paper's Fig. 4, and the safety diagram."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from deltasafe.perception.calibration.curve_drawing import (
    BLUE,
    GRAY,
    ORANGE,
    RED,
    draw_band,
    draw_curve,
    draw_pixel_fractions,
    observed,
    size_color,
)
from deltasafe.perception.calibration.reliability import CONFIDENCE_EDGES, DELTA_GRID
from deltasafe.perception.calibration.report import CalibrationReport
from deltasafe.reporting.panels import style_axes

_SMALLEST_P = 1e-5
_BARS = "#c9d6df"


def reliability_figure(report: CalibrationReport) -> Figure:
    """Draw the paper's reliability diagram (left) and the fraction of occupied pixels over p_occupied (right).

    Bars below show the fraction of pixels in each bin; bands are intervals by bootstrap over images.
    """
    figure = Figure(figsize=(11, 5.6), layout="constrained")
    grid = figure.add_gridspec(2, 2, height_ratios=[4, 1])
    final = report.final
    for column, (draw, edges, count, label) in enumerate(
        (
            (_draw_confidence, CONFIDENCE_EDGES, final.predictor.reliability.count, "Confidence"),
            (
                _draw_safety,
                (_SMALLEST_P, *DELTA_GRID, 1.0),
                final.safety.count,
                "$p_\\mathrm{occupied}$  $(= 1 - p_\\mathrm{free})$",
            ),
        )
    ):
        top = figure.add_subplot(grid[0, column])
        bottom = figure.add_subplot(grid[1, column], sharex=top)
        draw(top, report)
        draw_pixel_fractions(bottom, np.array(edges), [count], [_BARS])
        bottom.set_xlabel(label)
        top.tick_params(labelbottom=False)
        for axes in (top, bottom):
            style_axes(axes)
    return figure


def _draw_confidence(axes: Axes, report: CalibrationReport) -> None:
    axes.plot([0.5, 1], [0.5, 1], "k--", lw=1, label="Ideal", zorder=1)
    for index, member in enumerate(report.members):
        draw_curve(axes, member.reliability, color=GRAY, lw=1, label=None if index else "Members", zorder=2)
    for m in (2, 5, 10):
        if m < report.n_members:
            curve = report.ensembles[m - 1].reliability
            draw_curve(axes, curve, color=size_color(m), lw=1.6, label=f"$M = {m}$", zorder=3)
    final, color = report.final.predictor.reliability, size_color(report.n_members)
    label = f"$M = {report.n_members}$"
    if report.final is not report.uncalibrated:
        uncalibrated = report.ensembles[-1].reliability
        draw_curve(axes, uncalibrated, "o:", color=color, lw=1.6, ms=3, label=f"{label}, $T = 1$", zorder=3)
        label += f", $T = {report.final.temperature:.2f}$"
    draw_curve(axes, final, "o-", color=color, lw=2.2, ms=4, label=label, zorder=4)
    draw_band(axes, final, color)
    drawn = [v for curve in (final, *(member.reliability for member in report.members)) for v in observed(curve)]
    drawn += [value for value in final.low if value is not None]
    bottom = max(0.0, np.floor(min(0.5, *drawn) * 20) / 20)
    axes.set(xlim=(0.5, 1), ylim=(bottom, 1), ylabel="Accuracy", title="Reliability: accuracy over confidence")
    axes.legend(frameon=False, fontsize=9, loc="upper left", ncols=2)


def _draw_safety(axes: Axes, report: CalibrationReport) -> None:
    curve = report.final.safety
    observed_fraction = _nan_for_none(curve.observed)
    positive = observed_fraction[observed_fraction > 0]
    floor = 10.0 ** np.floor(np.log10(max(positive.min() / 2, 1e-6))) if len(positive) else 1e-6
    span = np.array([_SMALLEST_P, 1.0])
    axes.fill_between(span, span, 1.0, color=RED, alpha=0.06, lw=0)
    axes.plot(span, span, "k--", lw=1, label="Ideal")
    text = "more often occupied than predicted"
    axes.text(0.02, 0.97, text, transform=axes.transAxes, va="top", color=RED, fontsize=9)
    predicted = np.maximum(_nan_for_none(curve.predicted), _SMALLEST_P)
    low, high = (np.maximum(_nan_for_none(side), floor) for side in (curve.low, curve.high))
    axes.fill_between(predicted, low, high, color=BLUE, alpha=0.18, lw=0)
    shown = np.where(observed_fraction > 0, observed_fraction, np.nan)
    axes.plot(predicted, shown, "o-", color=BLUE, ms=4, lw=1.6, label="Pixels of one bin", clip_on=False)
    never = predicted[observed_fraction == 0]
    if len(never):
        at_floor = np.full(len(never), floor)
        axes.plot(never, at_floor, "v", color=BLUE, mfc="white", label="Never occupied", clip_on=False)
    _draw_support(axes, report)
    axes.set(xscale="log", yscale="log", xlim=(_SMALLEST_P, 1), ylim=(floor, 1))
    axes.set(ylabel="Fraction of occupied pixels", title="Safety diagram: occupied fraction over p_occupied")
    axes.legend(frameon=False, fontsize=9, loc="lower right")


def _draw_support(axes: Axes, report: CalibrationReport) -> None:
    """Draw the upper bound over delta, and the smallest supported delta."""
    rows, supported = report.final.support, report.smallest_supported_delta
    label = f"All pixels with $p \\leq \\delta$: {report.settings.level:.0%} bound"
    axes.plot([row.delta for row in rows], [row.upper_bound for row in rows], color=ORANGE, lw=1.6, label=label)
    if supported is not None:
        axes.axvline(supported, color=ORANGE, lw=1, ls=":")
        axes.annotate(
            f"$\\delta \\geq {supported:g}$\nsupported", (supported, 1.0), (5, -6), textcoords="offset points",
            va="top", fontsize=9, color="#8a5f00",
        )  # fmt: skip


def _nan_for_none(values: tuple[float | None, ...]) -> NDArray[np.float64]:
    return np.array([np.nan if value is None else value for value in values])
