"""Figures of the schemes and of the ablation: our results and the paper's."""

from collections.abc import Sequence
from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from deltasafe.perception.calibration.curve_drawing import BLUE, GRAY, ORANGE, RED
from deltasafe.reporting.panels import style_axes
from deltasafe.studies.perception.tables import SCHEME_TITLES, AblationRow, SchemeRow

_PRINTED = {
    "pixel_accuracy": ("PA [%]", 1e2),
    "miou": ("mIoU [%]", 1e2),
    "nll": ("NLL $\\times 10^2$", 1e2),
    "brier": ("BS $\\times 10^3$", 1e3),
}


def scheme_figure(rows: Sequence[SchemeRow]) -> Figure:
    """Plot the four measures of every scheme at every size; hollow: the paper's values."""
    sizes = sorted({row.cell.n_images for row in rows})
    schemes = [name for name in SCHEME_TITLES if any(row.cell.scheme == name for row in rows)]
    figure = Figure(figsize=(11, 3.5), layout="constrained")
    all_axes = figure.subplots(1, 4, sharey=True)
    for axes, (name, (label, unit)) in zip(all_axes, _PRINTED.items(), strict=True):
        for row in rows:
            k = sizes.index(row.cell.n_images)
            color = BLUE if k == len(sizes) - 1 else ORANGE
            y = schemes.index(row.cell.scheme) + (k - (len(sizes) - 1) / 2) * 0.34
            low, value, high = _span(row, name)
            axes.plot([unit * low, unit * high], [y, y], "-", color=color, lw=2, alpha=0.45)
            axes.plot(unit * value, y, "o", color=color, ms=6)
            if row.paper is not None:
                axes.plot(unit * getattr(row.paper, name), y, "o", mfc="white", mec=color, ms=5)
        axes.set(xlabel=label, ylim=(len(schemes) - 0.5, -0.5))
        if name in ("nll", "brier"):
            axes.set_xlim(left=0)
        _clean(axes)
    all_axes[0].set_yticks(range(len(schemes)), [SCHEME_TITLES[name] for name in schemes])
    handles = [_dot(BLUE if k == len(sizes) - 1 else ORANGE, f"{size} images") for k, size in enumerate(sizes)]
    handles.append(Line2D([], [], marker="o", ls="", mfc="white", mec="black", ms=5, label="the paper's"))
    figure.legend(handles=handles, loc="outside lower center", ncols=len(handles), frameon=False, fontsize=9)
    return figure


def ablation_figure(rows: Sequence[AblationRow]) -> Figure:
    """Plot the loss of each measure without a method; right of zero, the method helps."""
    drawn = [row for row in rows if row.loss is not None]
    figure = Figure(figsize=(11, 0.9 + 0.3 * max(len(drawn), 3)), layout="constrained")
    all_axes = figure.subplots(1, 4, sharey=True)
    for axes, (name, (label, unit)) in zip(all_axes, _PRINTED.items(), strict=True):
        axes.axvline(0, color="black", lw=0.8)
        for y, row in enumerate(drawn):
            loss, low, high = (unit * getattr(scores, name) for scores in (row.loss, row.loss_low, row.loss_high))
            color = GRAY if low <= 0 <= high else BLUE if loss > 0 else RED
            axes.plot([low, high], [y, y], "-", color=color, lw=2, alpha=0.45)
            axes.plot(loss, y, "o", color=color, ms=6)
        axes.set(xlabel=f"loss in {label}", ylim=(len(drawn) - 0.5, -0.5))
        _clean(axes)
    all_axes[0].set_yticks(range(len(drawn)), [row.cell.left_out.replace("_", " ") for row in drawn])
    return figure


def _span(row: SchemeRow, name: str) -> tuple[float, float, float]:
    """Return low end, value and high end: one sd over members, or the interval of the ensemble."""
    value = getattr(row.table_scores, name)
    if name in ("nll", "brier"):
        return getattr(row.low, name), value, getattr(row.high, name)
    sd = 0.0 if row.members.sd is None else getattr(row.members.sd, name)
    return value - sd, value, value + sd


def _dot(color: str, label: str) -> Any:
    return Line2D([], [], marker="o", ls="", color=color, ms=6, label=label)


def _clean(axes: Axes) -> None:
    style_axes(axes)
    axes.spines["left"].set_visible(False)
    axes.tick_params(axis="y", length=0)
