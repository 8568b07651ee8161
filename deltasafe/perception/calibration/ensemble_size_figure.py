"""Fig. 4 and Table III of the paper as figures: reliability and scores of ensembles of growing size."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator

from deltasafe.perception.calibration.curve_drawing import (
    BLUE,
    GRAY,
    draw_band,
    draw_curve,
    draw_pixel_fractions,
    observed,
    size_color,
)
from deltasafe.perception.calibration.ensemble_size import EnsembleSize, ensemble_size_rows
from deltasafe.perception.calibration.paper_results import (
    ENSEMBLE_SIZE_RESULTS,
    MEMBER_RELIABILITY_RESULTS,
    RELIABILITY_RESULTS,
)
from deltasafe.perception.calibration.reliability import CONFIDENCE_EDGES
from deltasafe.perception.calibration.report import CalibrationReport
from deltasafe.reporting.panels import style_axes

_N_MEMBERS_SHOWN = 5


def ensemble_reliability_figure(report: CalibrationReport) -> Figure:
    """Draw Fig. 4: reliability of the means of the first 2, 5, 10 members, and of the first five members alone.

    Left: this report, with the paper's curves of the same sizes dashed. Right: all curves of the paper. Bands are
    intervals by bootstrap over images; the bars show the fraction of pixels in each bin.
    """
    figure = Figure(figsize=(11, 5.4), layout="constrained")
    grid = figure.add_gridspec(2, 2, height_ratios=[4, 1])
    sizes = [m for m in RELIABILITY_RESULTS if m <= report.n_members] or [report.n_members]
    ours = figure.add_subplot(grid[0, 0])
    paper = figure.add_subplot(grid[0, 1], sharex=ours, sharey=ours)
    counts = figure.add_subplot(grid[1, 0], sharex=ours)
    _draw_ours(ours, report, sizes)
    _draw_paper(paper)
    curves = [report.ensembles[m - 1].reliability for m in sizes]
    draw_pixel_fractions(counts, np.array(CONFIDENCE_EDGES), [c.count for c in curves], [size_color(m) for m in sizes])
    for axes in (ours, paper):
        axes.plot([0.5, 1], [0.5, 1], color="black", ls=":", lw=1, zorder=1)
        axes.set_xlabel("Confidence")
    for axes in (ours, paper, counts):
        style_axes(axes)
    _draw_key(figure.add_subplot(grid[1, 1]), report, sizes)
    return figure


def ensemble_size_figure(report: CalibrationReport) -> Figure:
    """Draw Table III: BS and NLL of the mean of the first M members with their intervals, and the paper's values."""
    figure = Figure(figsize=(11, 3.6), layout="constrained")
    rows = ensemble_size_rows(report)
    for column, (name, label) in enumerate((("brier", "Brier score"), ("nll", "NLL [nats]"))):
        axes = figure.add_subplot(1, 2, column + 1)
        _draw_score(axes, report, rows, name)
        sizes = [m for m in ENSEMBLE_SIZE_RESULTS if m <= max(report.n_members, 2)]
        values = [ENSEMBLE_SIZE_RESULTS[m][column] for m in sizes]
        axes.plot(sizes, values, "s--", color="black", ms=3, lw=0.9, label="paper, Table III")
        axes.set(xlabel="Ensemble size $M$", ylabel=label)
        axes.set_ylim(bottom=0)
        axes.xaxis.set_major_locator(MaxNLocator(integer=True))
        style_axes(axes)
        axes.legend(frameon=False, fontsize=9)
    return figure


def _draw_ours(axes: Axes, report: CalibrationReport, sizes: list[int]) -> None:
    members = [member.reliability for member in report.members[:_N_MEMBERS_SHOWN]]
    lowest = [value for _, accuracy in MEMBER_RELIABILITY_RESULTS for value in accuracy]
    for curve in members:
        draw_curve(axes, curve, color=GRAY, lw=0.9)
        lowest += observed(curve)
    for m in sizes:
        curve, color = report.ensembles[m - 1].reliability, size_color(m)
        draw_band(axes, curve, color)
        draw_curve(axes, curve, "o-", color=color, lw=1.8, ms=3.5)
        lowest += [value for value in curve.low if value is not None]
        if m in RELIABILITY_RESULTS:
            axes.plot(*RELIABILITY_RESULTS[m], "--", color=color, lw=0.9)
    axes.set(xlim=(0.5, 1), ylim=(np.floor(min(lowest) * 20) / 20, 1), ylabel="Accuracy")
    axes.set_title(f"Ours, {len(report.image_ids)} test images", fontsize=11)


def _draw_paper(axes: Axes) -> None:
    for confidence, accuracy in MEMBER_RELIABILITY_RESULTS:
        axes.plot(confidence, accuracy, "--", color=GRAY, lw=0.9)
    for m, (confidence, accuracy) in RELIABILITY_RESULTS.items():
        axes.plot(confidence, accuracy, "o--", color=size_color(m), lw=1.8, ms=3.5)
    axes.set_title("The paper's Fig. 4", fontsize=11)


def _draw_key(axes: Axes, report: CalibrationReport, sizes: list[int]) -> None:
    shown = sorted({*sizes, *RELIABILITY_RESULTS})
    n_members = min(report.n_members, _N_MEMBERS_SHOWN)
    handles = [Line2D([], [], color=size_color(m), lw=1.8, label=f"$M = {m}$") for m in shown]
    handles += [
        Line2D([], [], color=GRAY, lw=0.9, label=f"Single members ({n_members})"),
        Line2D([], [], color="black", ls=":", lw=1, label="Ideal"),
        Line2D([], [], color="#555555", ls="--", lw=0.9, label="The paper's"),
    ]
    axes.legend(handles=handles, frameon=False, loc="center", ncols=3)
    axes.set_axis_off()


def _draw_score(axes: Axes, report: CalibrationReport, rows: tuple[EnsembleSize, ...], name: str) -> None:
    sizes = [row.n_members for row in rows]
    low, value, high = (
        [getattr(scores, name) for scores in column]
        for column in zip(*((row.low, row.scores, row.high) for row in rows), strict=True)
    )
    members = [getattr(member.scores, name) for member in report.members]
    label = f"mean of the first $M$ members, {report.settings.level:.0%} interval"
    axes.fill_between(sizes, low, high, color=BLUE, alpha=0.15, lw=0)
    axes.plot(np.ones(len(members)), members, "o", color=GRAY, alpha=0.7, ms=5, label="each member alone")
    axes.plot(sizes, value, "o-", color=BLUE, label=label)
