"""Reliability as in the paper's Fig. 4 and the diagram that matters to safety."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter

from deltasafe.perception.calibration.reliability import CONFIDENCE_EDGES, DELTA_GRID, Curve
from deltasafe.perception.calibration.report import CalibrationReport

__all__ = ["reliability_figure"]

_GRAY = "#9a9a9a"
_BLUE = "#0072B2"
_RED = "#C8102E"
_SIZE_COLORS = {2: _RED, 5: "#009E73", 10: _BLUE}
_SMALLEST_P = 1e-5


def reliability_figure(report: CalibrationReport) -> Figure:
    """The paper's reliability diagram (left) and how often a pixel is occupied per p_occupied (right).

    Bars below show how many pixels stand behind each point; bands are intervals by bootstrap over images.
    """
    figure = Figure(figsize=(11, 5.6), layout="constrained")
    grid = figure.add_gridspec(2, 2, height_ratios=[4, 1])
    top_left = figure.add_subplot(grid[0, 0])
    bottom_left = figure.add_subplot(grid[1, 0], sharex=top_left)
    top_right = figure.add_subplot(grid[0, 1])
    bottom_right = figure.add_subplot(grid[1, 1], sharex=top_right)
    _draw_confidence(top_left, report)
    edges = np.array(CONFIDENCE_EDGES)
    _draw_counts(bottom_left, edges, report.final.predictor.reliability.count, "Confidence")
    _draw_safety(top_right, report)
    edges = np.array([_SMALLEST_P, *DELTA_GRID, 1.0])
    _draw_counts(bottom_right, edges, report.final.safety.count, "$p_\\mathrm{occupied}$  $(= 1 - p_\\mathrm{free})$")
    for axes in (top_left, top_right):
        axes.tick_params(labelbottom=False)
    return figure


def _draw_confidence(axes: Axes, report: CalibrationReport) -> None:
    axes.plot([0.5, 1], [0.5, 1], "k--", lw=1, label="Ideal", zorder=1)
    for index, member in enumerate(report.members):
        _line(axes, member.reliability, color=_GRAY, lw=1, label=None if index else "Members", zorder=2)
    for m in sorted({2, 5, 10, report.n_members}):
        if 1 < m < report.n_members:
            curve = report.ensembles[m - 1].reliability
            _line(axes, curve, color=_SIZE_COLORS[m], lw=1.6, label=f"$M = {m}$", zorder=3)
    final, color = report.final.predictor.reliability, _SIZE_COLORS.get(report.n_members, _BLUE)
    label = f"$M = {report.n_members}$"
    if report.final is not report.as_it_is:
        raw = report.ensembles[-1].reliability
        _line(axes, raw, color=color, lw=1.6, ls=":", marker="o", ms=3, label=f"{label}, $T = 1$", zorder=3)
        label += f", $T = {report.final.temperature:.2f}$"
    _line(axes, final, color=color, lw=2.2, marker="o", ms=4, label=label, zorder=4)
    _band(axes, final, color)
    seen = [value for value in (*final.observed, *final.low) if value is not None]
    members = [v for m in report.members for v in m.reliability.observed if v is not None]
    bottom = max(0.0, np.floor(min(0.5, *seen, *members) * 20) / 20)
    axes.set(xlim=(0.5, 1), ylim=(bottom, 1), ylabel="Accuracy", title="Is it as often right as it is sure?")
    axes.legend(frameon=False, fontsize=9, loc="upper left", ncols=2)
    _clean(axes)


def _draw_safety(axes: Axes, report: CalibrationReport) -> None:
    curve = report.final.safety
    stated = np.array([np.nan if value is None else max(value, _SMALLEST_P) for value in curve.stated])
    observed = np.array([np.nan if value is None else value for value in curve.observed])
    positive = observed[observed > 0]
    floor = 10.0 ** np.floor(np.log10(max(positive.min() / 2, 1e-6))) if len(positive) else 1e-6
    span = np.array([_SMALLEST_P, 1.0])
    axes.fill_between(span, span, 1.0, color=_RED, alpha=0.06, lw=0)
    axes.plot(span, span, "k--", lw=1, label="Ideal")
    axes.text(
        0.02,
        0.97,
        "more often occupied than stated",
        transform=axes.transAxes,
        va="top",
        color=_RED,
        fontsize=9,
    )
    if curve.low:
        low = np.array([np.nan if value is None else max(value, floor) for value in curve.low])
        high = np.array([np.nan if value is None else max(value, floor) for value in curve.high])
        axes.fill_between(stated, low, high, color=_BLUE, alpha=0.18, lw=0)
    shown = np.where(observed > 0, observed, np.nan)
    axes.plot(stated, shown, "o-", color=_BLUE, ms=4, lw=1.6, label="Pixels of one bin", clip_on=False)
    if (observed == 0).any():
        never = observed == 0
        axes.plot(
            stated[never],
            np.full(never.sum(), floor),
            "v",
            color=_BLUE,
            mfc="white",
            label="Never occupied",
            clip_on=False,
        )
    deltas = np.array([row.delta for row in report.final.support])
    bounds = np.array([row.upper_bound for row in report.final.support])
    axes.plot(
        deltas,
        bounds,
        color="#E69F00",
        lw=1.6,
        label=f"All pixels with $p \\leq \\delta$: {report.settings.level:.0%} bound",
    )
    supported = report.smallest_supported_delta
    if supported is not None:
        axes.axvline(supported, color="#E69F00", lw=1, ls=":")
        axes.annotate(
            f"$\\delta \\geq {supported:g}$\nsupported",
            (supported, 1.0),
            xytext=(5, -6),
            textcoords="offset points",
            va="top",
            fontsize=9,
            color="#8a5f00",
        )
    axes.set(xscale="log", yscale="log", xlim=(_SMALLEST_P, 1), ylim=(floor, 1))
    axes.set(ylabel="Share of occupied pixels", title="How often is a pixel occupied that counts as free?")
    axes.legend(frameon=False, fontsize=9, loc="lower right")
    _clean(axes)


def _draw_counts(axes: Axes, edges: np.ndarray, count: Sequence[int], label: str) -> None:
    share = np.array(count) / sum(count)
    axes.bar(edges[:-1], share, width=np.diff(edges), align="edge", color="#c9d6df", edgecolor="white", lw=0.6)
    positive = share[share > 0]
    axes.set(yscale="log", xlabel=label, ylabel="Pixels")
    axes.set_ylim(10.0 ** np.floor(np.log10(positive.min())) / 2, 2)
    axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{100 * value:g}%"))
    axes.tick_params(axis="y", labelsize=8)
    _clean(axes)


def _line(axes: Axes, curve: Curve, **style: Any) -> None:
    points = [(x, y) for x, y in zip(curve.stated, curve.observed, strict=True) if x is not None]
    axes.plot(*zip(*points, strict=True), **style)


def _band(axes: Axes, curve: Curve, color: str) -> None:
    rows = zip(curve.stated, curve.low, curve.high, strict=True)
    x, low, high = zip(*((x, a, b) for x, a, b in rows if x is not None), strict=True)
    axes.fill_between(x, low, high, color=color, alpha=0.15, lw=0)


def _clean(axes: Axes) -> None:
    axes.spines[["top", "right"]].set_visible(False)
    axes.grid(True, which="major", color="#e6e6e6", lw=0.6)
    axes.set_axisbelow(True)
