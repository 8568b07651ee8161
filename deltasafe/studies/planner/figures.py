"""Fig. 5 and Fig. 6 in the paper's form, beside the paper's curves."""

import pathlib
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.ticker import FuncFormatter

from deltasafe.reporting.panels import new_figure, save_figure, style_axes
from deltasafe.studies import baselines
from deltasafe.studies.planner.cost_comparison import SCENES, Comparison
from deltasafe.studies.planner.methods import MAIN, compared_methods
from deltasafe.studies.planner.paper_curves import paper_curves
from deltasafe.studies.planner.scenes import PAPER_UNIT_M
from deltasafe.studies.planner.timing import Timing

COLORS = baselines.COLORS | {"chance_constraint_each": "#8a8f98", "exact": "#b07aa1", "equal_margin": "#e08a1e"}
LEVEL = r"$\tilde d,\ 2\sigma$  [0.1 m]"


def plot_cost(found: Comparison, destination: str | pathlib.Path) -> None:
    """Plot the normalized path cost over the uncertainty, one row per scene: both line costs here, and the paper."""
    figure = new_figure(11.5, 6.6)
    axes = figure.subplots(2, 3, sharex=True, sharey="row")
    labels = {method.name: method.label for method in compared_methods(found.settings)}
    for row, scene in zip(axes, SCENES, strict=True):
        for ax, suffix in zip(row[:2], ("", "_squared"), strict=True):
            for name in MAIN:
                _curve(ax, found, scene, name + suffix, COLORS[name], label=labels[name])
        for name in MAIN:
            curve = paper_curves()["cost"][scene][name]
            row[2].plot(curve["level"], curve["normalized_cost"], color=COLORS[name], lw=1.8, label=labels[name])
        for ax, title in zip(row, ("here, additive cost", "here, the paper's squared cost", "paper"), strict=True):
            ax.set_title(f"{scene.capitalize()} scene: {title}", fontsize=10)
        row[0].set_ylabel("normalized path cost")
    for ax in axes[1]:
        ax.set_xlabel(LEVEL)
    for ax in axes.flat:
        style_axes(ax)
        ax.set_xlim(0, found.settings.largest_level_m / PAPER_UNIT_M)
    axes[0, 0].legend(frameon=False, fontsize=8.5, loc="upper left")
    save_figure(figure, destination)


def plot_references(found: Comparison, destination: str | pathlib.Path) -> None:
    """Plot the rise over the cost at no uncertainty, for our method, the chance constraint and the references."""
    figure = new_figure(10.0, 4.2)
    labels = {method.name: method.label for method in compared_methods(found.settings)}
    levels = np.array(found.settings.levels_m) / PAPER_UNIT_M
    for ax, scene in zip(figure.subplots(1, 2, sharey=True), SCENES, strict=True):
        for name in ("ours", "chance_constraint", "chance_constraint_each", "exact", "equal_margin"):
            mean, error = found.normalized_cost(scene, name)
            rise, spread = 100 * (mean / mean[0] - 1), 100 * error / mean[0]
            style = "-" if name in MAIN else "--"
            ax.plot(levels, rise, style, color=COLORS[name], lw=1.8, label=labels[name])
            ax.fill_between(levels, rise - spread, rise + spread, color=COLORS[name], alpha=0.15, lw=0)
        ax.set_title(f"{scene.capitalize()} scene", fontsize=10)
        ax.set(xlabel=LEVEL, xlim=(0, levels[-1]))
        style_axes(ax)
    figure.axes[0].set_ylabel("cost above that at no uncertainty [%]")
    figure.axes[0].legend(frameon=False, fontsize=8.5, loc="upper left")
    save_figure(figure, destination)


def plot_time(found: Timing, destination: str | pathlib.Path) -> None:
    """Plot the time of a search over the number of obstacles: without culling, with culling, and in the paper."""
    figure = new_figure(11.5, 4.4)
    plain, culled, paper = figure.subplots(1, 3, sharex=True)
    plain.sharey(culled)
    counts = found.settings.counts
    for ax in (plain, culled):
        ours: tuple[tuple[str, str], ...] = (("ours", "-"), ("ours_few", "--"), ("ours_continuous", ":"))
        for name, style in ours:
            ax.plot(counts, 1000 * found.median_s(name), style, color=COLORS["ours"], lw=1.8)
        ax.plot(counts, 1000 * (found.median_s("ours") + found.field_s), color=COLORS["ours"], lw=1.0, alpha=0.45)
        ax.set_ylabel("CPU time [ms]")
    for name in MAIN[1:]:
        plain.plot(counts, 1000 * found.median_s(name), color=COLORS[name], lw=1.8)
        culled.plot(counts, 1000 * found.median_s(f"{name}_culled"), color=COLORS[name], lw=1.8)
    plain.plot(counts, 1000 * found.median_s("max_probability_numeric"), "--", color=COLORS["max_probability"], lw=1.8)
    for name, curve in paper_curves()["time"].items():
        few = name == "ours_20"
        color = COLORS["ours" if name.startswith("ours") else name]
        paper.plot(curve["n_obstacles"], curve["seconds"], "--" if few else "-", color=color, lw=1.8)
    paper.set_ylabel("computation time [s]")
    titles = ("Here: every obstacle at every pose", "Here: far obstacles culled, same answers", "Paper")
    for ax, title in zip((plain, culled, paper), titles, strict=True):
        ax.set_title(title, fontsize=10)
        ax.set(xlabel="number of obstacles", yscale="log", xlim=(counts[0], counts[-1]))
        ax.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        ax.set_xticks([counts[0], *(n for n in (20, 40, 60, 80, 100) if counts[0] < n <= counts[-1])])
        style_axes(ax)
    red, blue = COLORS["ours"], COLORS["max_probability"]
    many, few_samples = found.settings.n_samples, found.settings.few_samples
    handles = [
        Line2D([], [], color=red, lw=1.8, label=f"Our method, $N_x = {many}$"),
        Line2D([], [], color=red, lw=1.8, ls="--", label=f"Our method, $N_x = {few_samples}$"),
        Line2D([], [], color=red, lw=1.8, ls=":", label="Our method, continuous"),
        Line2D([], [], color=red, lw=1.0, alpha=0.45, label="Our method, building the field included"),
        *(Line2D([], [], color=COLORS[name], lw=1.8, label=label) for name, label in baselines.LABELS.items()),
        Line2D([], [], color=blue, lw=1.8, ls="--", label="Max. prob. approx., numeric search"),
    ]
    figure.legend(handles=handles, loc="outside lower center", ncols=4, frameon=False, fontsize=8.5)
    save_figure(figure, destination)


def _curve(ax: Axes, found: Comparison, scene: str, name: str, color: str, **options: Any) -> None:
    levels = np.array(found.settings.levels_m) / PAPER_UNIT_M
    mean, error = found.normalized_cost(scene, name)
    ax.plot(levels, mean, color=color, lw=1.8, **options)
    ax.fill_between(levels, mean - error, mean + error, color=color, alpha=0.18, lw=0)
