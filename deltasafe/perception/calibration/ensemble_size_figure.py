"""Fig. 4 and Table III of the paper as pictures: reliability and scores of ensembles of growing size."""

from collections.abc import Iterable, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import FuncFormatter, MaxNLocator

from deltasafe.perception.calibration.ensemble_size import ensemble_size_rows
from deltasafe.perception.calibration.paper_results import (
    ENSEMBLE_SIZE_RESULTS,
    MEMBER_RELIABILITY_RESULTS,
    RELIABILITY_RESULTS,
)
from deltasafe.perception.calibration.reliability import CONFIDENCE_EDGES, Curve
from deltasafe.perception.calibration.report import CalibrationReport

__all__ = ["ensemble_reliability_figure", "ensemble_size_figure"]

_GRAY = "#8a8a8a"
_COLORS = {2: "#C8102E", 5: "#009E73", 10: "#0072B2"}
_N_MEMBERS_SHOWN = 5


def ensemble_reliability_figure(report: CalibrationReport) -> Figure:
    """Fig. 4: reliability of the means of the first M = 2, 5, 10 members and of the first five members alone.

    Left ours, right the paper's in the same colors and dashed, which also lies thinly behind ours. Bands are
    intervals by bootstrap over images; the bars show how many pixels stand behind each point.
    """
    figure = Figure(figsize=(11, 5.4), layout="constrained")
    grid = figure.add_gridspec(2, 2, height_ratios=[4, 1])
    sizes = [m for m in _COLORS if m <= report.n_members] or [report.n_members]
    ours = figure.add_subplot(grid[0, 0])
    theirs = figure.add_subplot(grid[0, 1], sharex=ours, sharey=ours)
    counts = figure.add_subplot(grid[1, 0], sharex=ours)
    key = figure.add_subplot(grid[1, 1])
    members = report.members[:_N_MEMBERS_SHOWN]
    _diagonal(ours)
    _diagonal(theirs)
    for member in members:
        ours.plot(*_points(member.reliability), color=_GRAY, lw=0.9)
    for m in sizes:
        curve, color = report.ensembles[m - 1].reliability, _COLORS.get(m, _COLORS[10])
        x, low, high = _band(curve)
        ours.fill_between(x, low, high, color=color, alpha=0.13, lw=0)
        ours.plot(*_points(curve), "o-", color=color, lw=1.8, ms=3.5)
    for confidence, accuracy in MEMBER_RELIABILITY_RESULTS:
        theirs.plot(confidence, accuracy, "--", color=_GRAY, lw=0.9)
    for m, (confidence, accuracy) in RELIABILITY_RESULTS.items():
        theirs.plot(confidence, accuracy, "o--", color=_COLORS[m], lw=1.8, ms=3.5)
        if m in sizes:
            ours.plot(confidence, accuracy, "--", color=_COLORS[m], lw=0.9)
    _draw_counts(counts, [report.ensembles[m - 1].reliability for m in sizes], sizes)
    drawn = [value for m in sizes for value in _band(report.ensembles[m - 1].reliability)[1]]
    alone = [value for member in members for value in _points(member.reliability)[1]]
    paper = [value for _, accuracy in MEMBER_RELIABILITY_RESULTS for value in accuracy]
    ours.set(xlim=(0.5, 1), ylim=(np.floor(min(*drawn, *alone, *paper) * 20) / 20, 1), ylabel="Accuracy")
    ours.set_title(f"Ours, {len(report.image_ids)} test images", fontsize=11)
    theirs.set_title("The paper's Fig. 4", fontsize=11)
    for axes in (ours, theirs):
        axes.set_xlabel("Confidence")
    shown = sorted({*sizes, *RELIABILITY_RESULTS})
    handles = [Line2D([], [], color=_COLORS.get(m, _COLORS[10]), lw=1.8, label=f"$M = {m}$") for m in shown]
    handles += [
        Line2D([], [], color=_GRAY, lw=0.9, label=f"Single members ({len(members)})"),
        Line2D([], [], color="black", ls=":", lw=1, label="Ideal"),
        Line2D([], [], color="#555555", ls="--", lw=0.9, label="The paper's"),
    ]
    key.legend(handles=handles, frameon=False, loc="center", ncols=3)
    key.set_axis_off()
    for axes in (ours, theirs, counts):
        _clean(axes)
    return figure


def ensemble_size_figure(report: CalibrationReport) -> Figure:
    """Table III: BS and NLL of the mean of the first M members with their intervals, beside the paper's."""
    figure = Figure(figsize=(11, 3.6), layout="constrained")
    rows = ensemble_size_rows(report)
    sizes = [row.n_members for row in rows]
    paper = [m for m in ENSEMBLE_SIZE_RESULTS if m <= max(report.n_members, 2)]
    for column, (name, label) in enumerate((("brier", "Brier score"), ("nll", "NLL [nats]"))):
        axes = figure.add_subplot(1, 2, column + 1)
        low, high = np.transpose([(getattr(row.low, name), getattr(row.high, name)) for row in rows])
        members = [getattr(member.scores, name) for member in report.members]
        axes.fill_between(sizes, low, high, color=_COLORS[10], alpha=0.13, lw=0)
        axes.plot(np.ones(len(members)), members, "o", color=_GRAY, alpha=0.7, ms=5, label="each member alone")
        axes.plot(
            sizes,
            [getattr(row.scores, name) for row in rows],
            "o-",
            color=_COLORS[10],
            label=f"mean of the first $M$ members, {report.settings.level:.0%} interval",
        )
        axes.plot(
            paper,
            [ENSEMBLE_SIZE_RESULTS[m][column] for m in paper],
            "s--",
            color="black",
            ms=3,
            lw=0.9,
            label="paper, Table III",
        )
        axes.set(xlabel="Ensemble size $M$", ylabel=label)
        axes.set_ylim(bottom=0)
        axes.xaxis.set_major_locator(MaxNLocator(integer=True))
        _clean(axes)
        axes.legend(frameon=False, fontsize=9)
    return figure


def _diagonal(axes: Axes) -> None:
    axes.plot([0.5, 1], [0.5, 1], color="black", ls=":", lw=1, zorder=1)


def _draw_counts(axes: Axes, curves: Sequence[Curve], sizes: Sequence[int]) -> None:
    edges = np.array(CONFIDENCE_EDGES)
    width = np.diff(edges) * 0.84 / len(sizes)
    smallest = 1.0
    for index, (m, curve) in enumerate(zip(sizes, curves, strict=True)):
        share = np.array(curve.count) / sum(curve.count)
        left = edges[:-1] + np.diff(edges) * 0.08 + index * width
        axes.bar(left, share, width=width, align="edge", color=_COLORS.get(m, _COLORS[10]), alpha=0.7)
        smallest = min(smallest, share[share > 0].min())
    axes.set(yscale="log", ylabel="Pixels")
    axes.set_ylim(10.0 ** np.floor(np.log10(smallest)) / 2, 2)
    axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{100 * value:g}%"))
    axes.tick_params(axis="y", labelsize=8)


def _points(curve: Curve) -> tuple[list[float], list[float]]:
    return _filled(curve.stated), _filled(curve.observed)


def _band(curve: Curve) -> tuple[list[float], list[float], list[float]]:
    return _filled(curve.stated), _filled(curve.low), _filled(curve.high)


def _filled(values: Iterable[float | None]) -> list[float]:
    return [value for value in values if value is not None]


def _clean(axes: Axes) -> None:
    axes.spines[["top", "right"]].set_visible(False)
    axes.grid(True, which="major", color="#e6e6e6", lw=0.6)
    axes.set_axisbelow(True)
