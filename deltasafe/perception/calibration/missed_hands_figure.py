"""Where a missed hand would come from: reliability by predicted class, and the missed share image by image."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from deltasafe.perception.calibration.reliability import DELTA_GRID, Curve
from deltasafe.perception.calibration.report import CalibrationReport

__all__ = ["missed_hands_figure"]

_BLUE = "#0072B2"
_RED = "#C8102E"
_ORANGE = "#E69F00"
_N_NAMED = 5


def missed_hands_figure(report: CalibrationReport) -> Figure:
    """Left: accuracy per confidence of the pixels predicted as hand, and as background, of the ensemble as it is used.

    Right: for each image the share of its hand that is missed (p_occupied < 0.5), and the part of it that a planner
    with ``planning_delta`` takes for free (at the next larger delta of ``DELTA_GRID``), worst first; the worst images
    are named.
    """
    figure = Figure(figsize=(11, 4.4), layout="constrained")
    left, right = figure.subplots(1, 2, width_ratios=[2, 3])
    final = report.final
    left.plot([0.5, 1], [0.5, 1], "k--", lw=1, label="Ideal")
    for curve, color, name in ((final.hand, _RED, "hand"), (final.background, _BLUE, "background")):
        _draw_class(left, curve, color, f"Predicted {name}")
    drawn = [v for curve in (final.hand, final.background) for v in curve.low if v is not None]
    left.set(xlim=(0.5, 1), ylim=(np.floor(min(0.5, *drawn) * 20) / 20, 1))
    left.set(xlabel="Confidence", ylabel="Accuracy", title="Is either class as often right as it is sure?")
    left.legend(frameon=False, fontsize=9, loc="lower right")
    _draw_images(right, report)
    for axes in (left, right):
        axes.title.set_fontsize(11)
        axes.spines[["top", "right"]].set_visible(False)
        axes.grid(True, axis="y", color="#e6e6e6", lw=0.6)
        axes.set_axisbelow(True)
    return figure


def _draw_class(axes: Axes, curve: Curve, color: str, label: str) -> None:
    rows = zip(curve.stated, curve.observed, curve.low, curve.high, strict=True)
    points = np.array([row for row in rows if row[0] is not None], dtype=np.float64).reshape(-1, 4)
    axes.plot(points[:, 0], points[:, 1], "o-", color=color, ms=4, lw=1.8, label=label, clip_on=False)
    axes.fill_between(points[:, 0], points[:, 2], points[:, 3], color=color, alpha=0.15, lw=0)


def _draw_images(axes: Axes, report: CalibrationReport) -> None:
    order = report.most_missed_first
    column = min(int(np.searchsorted(DELTA_GRID, report.settings.planning_delta)), len(DELTA_GRID) - 1)
    missed = np.array([report.images[i].missed_hand_rate for i in order], dtype=np.float64)
    taken = np.array([(report.final.taken_for_free[i] or (0.0,) * len(DELTA_GRID))[column] for i in order])
    place = np.arange(len(order))
    axes.bar(place, 100 * missed, width=0.86, color=_ORANGE, label="missed ($p_\\mathrm{occupied} < 0.5$)")
    label = f"taken for free ($p_\\mathrm{{occupied}} \\leq {DELTA_GRID[column]:g}$)"
    axes.bar(place, 100 * taken, width=0.86, color=_RED, label=label)
    if len(order):
        axes.axhline(100 * float(missed.mean()), color="black", lw=1, ls=":")
        axes.annotate(
            f"mean {missed.mean():.1%}", (len(order) - 0.5, 100 * missed.mean()), (0, 3), textcoords="offset points",
            ha="right", fontsize=9,
        )  # fmt: skip
        for k in range(min(_N_NAMED, len(order))):
            axes.annotate(
                report.image_ids[order[k]], (k, 100 * missed[k]), (0, 4), textcoords="offset points",
                rotation=90, ha="center", va="bottom", fontsize=7,
            )  # fmt: skip
        axes.set_ylim(0, max(100 * missed.max() * 1.3, 1e-3))
        axes.set_xlim(-0.8, max(len(order), 10))
    axes.set(xlabel=f"{len(order)} images, worst first", ylabel="Share of the hand [%]", xticks=[])
    axes.set_title("How much of each hand is missed?")
    axes.legend(frameon=False, fontsize=9, loc="upper right")
