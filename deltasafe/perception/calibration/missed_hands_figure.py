"""The figure of missed hands: reliability by predicted class, and the missed fraction of each hand."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from deltasafe.perception.calibration.curve_drawing import BLUE, ORANGE, RED, draw_band, draw_curve
from deltasafe.perception.calibration.report import CalibrationReport
from deltasafe.reporting.panels import style_axes

_N_NAMED = 5


def missed_hands_figure(report: CalibrationReport) -> Figure:
    """Draw accuracy over confidence by predicted class (left) and the missed fraction of each hand (right).

    Both are of the ensemble as it is used. Right: the fraction with p_occupied < 0.5, and the fraction with p_occupied
    up to the planning delta (rounded up to the next value of ``DELTA_GRID``), largest first, the first ones with names.
    """
    figure = Figure(figsize=(11, 4.4), layout="constrained")
    left, right = figure.subplots(1, 2, width_ratios=[2, 3])
    _draw_classes(left, report)
    _draw_images(right, report)
    for axes in (left, right):
        axes.title.set_fontsize(11)
        style_axes(axes)
    return figure


def _draw_classes(axes: Axes, report: CalibrationReport) -> None:
    final = report.final
    axes.plot([0.5, 1], [0.5, 1], "k--", lw=1, label="Ideal")
    for curve, color, name in ((final.hand, RED, report.info.singular), (final.background, BLUE, "background")):
        draw_curve(axes, curve, "o-", color=color, ms=4, lw=1.8, label=f"Predicted {name}", clip_on=False)
        draw_band(axes, curve, color)
    drawn = [v for curve in (final.hand, final.background) for v in curve.low if v is not None]
    axes.set(xlim=(0.5, 1), ylim=(np.floor(min(0.5, *drawn) * 20) / 20, 1))
    axes.set(xlabel="Confidence", ylabel="Accuracy", title="Reliability by predicted class")
    axes.legend(frameon=False, fontsize=9, loc="lower right")


def _draw_images(axes: Axes, report: CalibrationReport) -> None:
    missed, thing = report.missed_hand_rates, report.info.singular
    n_images, percent = len(missed), 100 * np.array(list(missed.values()))
    at_delta = [100 * report.missed_at_planning_delta[i] for i in missed]
    label = f"free for the planner ($p_\\mathrm{{occupied}} \\leq {report.grid_delta:g}$)"
    axes.bar(range(n_images), percent, width=0.86, color=ORANGE, label="missed ($p_\\mathrm{occupied} < 0.5$)")
    axes.bar(range(n_images), at_delta, width=0.86, color=RED, label=label)
    if n_images:
        mean = percent.mean()
        axes.axhline(mean, color="black", lw=1, ls=":")
        axes.annotate(
            f"mean {mean:.1f}%", (n_images - 0.5, mean), (0, 3), textcoords="offset points", ha="right", fontsize=9
        )
        for k, i in enumerate(list(missed)[:_N_NAMED]):
            axes.annotate(
                report.image_ids[i], (k, percent[k]), (0, 4), textcoords="offset points", rotation=90, ha="center",
                va="bottom", fontsize=7,
            )  # fmt: skip
        axes.set_ylim(0, max(percent.max() * 1.3, 1e-3))
        axes.set_xlim(-0.8, max(n_images, 10))
    axes.set(
        xlabel=f"{n_images} images, largest fraction first",
        ylabel=f"Fraction of the {thing} [%]",
        xticks=[],
    )
    axes.set_title(f"Missed fraction of each {thing}")
    axes.legend(frameon=False, fontsize=9, loc="upper right")
