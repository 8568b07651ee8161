"""The safety study in pictures: rates with their intervals, clearances, and both by speed."""

import pathlib

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D

from deltasafe.reporting.panels import clean, new_figure, save
from deltasafe.studies.safety.evidence import Rate, by_speed, cell
from deltasafe.studies.safety.study import SafetyStudy

__all__ = ["plot_clearances", "plot_rates", "plot_speed"]

COLORS = {
    "ours": "#C8102E",
    "single_member": "#e08a1e",
    "top_speed": "#8a4fbf",
    "chance_constraint": "#1b1f24",
    "bounding_volume": "#2a9d4a",
    "max_probability": "#1f5fbf",
}
FLOOR = 6e-4
"""Where a rate of 0 is drawn on the logarithmic axis."""


def plot_rates(study: SafetyStudy, destination: str | pathlib.Path) -> None:
    """Share of motions with a violation, exact 95 % intervals, by delta and contender; delta itself as a dash."""
    figure = new_figure(11.5, 5.2)
    model, reality = figure.subplots(1, 2, sharey=True)
    deltas, width = study.settings.deltas, 0.8 / len(study.settings.contenders)
    for ax, kind in ((model, "model"), (reality, "reality")):
        for group, delta in enumerate(deltas):
            ax.plot([group - 0.48, group + 0.48], [delta, delta], "--", color="#8a8f98", lw=1.2, zorder=1)
            for place, name in enumerate(study.settings.contenders):
                found = cell(study, name, delta)
                x = group - 0.4 + (place + 0.5) * width
                if found.executed:
                    _interval(ax, x, found.model if kind == "model" else found.reality, COLORS[name])
        ax.set_yscale("log")
        ax.set_ylim(FLOOR * 0.75, 1.3)
        ax.set_yticks([FLOOR, 0.001, 0.01, 0.05, 0.2, 1.0], ["0", "0.1 %", "1 %", "5 %", "20 %", "100 %"])
        ax.minorticks_off()
        ax.set_xticks(range(len(deltas)), [f"delta = {delta:g}" for delta in deltas])
        ax.set_xlim(-0.6, len(deltas) - 0.4)
        clean(ax)
    model.set_title("Beyond delta in the field that was used", fontsize=10)
    reality.set_title("The tool touches or crosses the true hand", fontsize=10)
    model.set_ylabel("motions with at least one such pose")
    handles = [
        Line2D([], [], color=COLORS[name], marker="o", ms=5, lw=1.6, label=study.label(name))
        for name in study.settings.contenders
    ]
    handles += [
        Line2D([], [], color="#8a8f98", ls="--", lw=1.2, label="delta, the level for each point of the tool"),
        Line2D([], [], color="#1b1f24", marker="o", mfc="white", ms=5, ls="none", label="none seen"),
    ]
    figure.legend(handles=handles, loc="outside lower center", ncols=4, frameon=False, fontsize=8.5)
    save(figure, destination)


def plot_clearances(study: SafetyStudy, destination: str | pathlib.Path) -> None:
    """Share of motions whose smallest distance to the true hand is below x: a panel for each delta."""
    figure = new_figure(11.5, 4.3)
    panels = np.atleast_1d(figure.subplots(1, len(study.settings.deltas), sharey=True, sharex=True))
    for ax, delta in zip(panels, study.settings.deltas, strict=True):
        for name in study.settings.contenders:
            tool_m = np.sort(study.trials["min_tool_m"][study.of(name, delta) & study.executed])
            if len(tool_m):
                share = np.arange(1, len(tool_m) + 1) / len(tool_m)
                ax.step(1000 * tool_m, share, where="post", color=COLORS[name], lw=1.7)
        ax.axvline(0, color="#1b1f24", lw=0.8)
        ax.set_title(f"delta = {delta:g}", fontsize=10)
        ax.set(xlabel="smallest distance of the tool to the true hand [mm]", ylim=(0, 1), xlim=(-1, None))
        clean(ax)
    panels[0].set_ylabel("share of executed motions")
    handles = [
        Line2D([], [], color=COLORS[name], lw=1.7, label=study.label(name)) for name in study.settings.contenders
    ]
    figure.legend(handles=handles, loc="outside lower center", ncols=3, frameon=False, fontsize=8.5)
    save(figure, destination)


def plot_speed(study: SafetyStudy, destination: str | pathlib.Path) -> None:
    """Smallest clearance by speed, ours with and without the schedule, and how often each speed was driven."""
    figure = new_figure(11.5, 4.3)
    panels = np.atleast_1d(figure.subplots(1, len(study.settings.deltas), sharey=True, sharex=True))
    for ax, delta in zip(panels, study.settings.deltas, strict=True):
        for offset, name in ((-0.2, "ours"), (0.2, "top_speed")):
            bins = by_speed(study, name, delta)
            poses = sum(one.poses for one in bins)
            for n, one in enumerate(bins):
                if one.poses:
                    nearest_mm = 1000 * one.min_tool_m
                    ax.bar(n + offset, nearest_mm, 0.38, color=COLORS[name], alpha=0.85)
                    share = f"{100 * one.poses / poses:.0f} %"
                    place = (n + offset, nearest_mm)
                    ax.annotate(share, place, (0, 2), textcoords="offset points", ha="center", fontsize=6.5)
        edges = by_speed(study, "ours", delta)
        ticks = [f"{1000 * one.from_mps:.0f}-{1000 * one.to_mps:.0f}" for one in edges[:-1]]
        ax.set_xticks(range(len(edges)), [*ticks, f"> {1000 * edges[-1].from_mps:.0f}"], fontsize=7.5)
        ax.set_title(f"delta = {delta:g}", fontsize=10)
        ax.set_xlabel("reference speed [mm/s]")
        ax.margins(y=0.1)
        clean(ax)
    panels[0].set_ylabel("smallest distance to the true hand [mm]\n(above: share of poses)")
    handles = [Line2D([], [], color=COLORS[name], lw=6, label=study.label(name)) for name in ("ours", "top_speed")]
    figure.legend(handles=handles, loc="outside lower center", ncols=2, frameon=False, fontsize=8.5)
    save(figure, destination)


def _interval(ax: Axes, x: float, rate: Rate, color: str) -> None:
    low, high = max(rate.interval[0], FLOOR), rate.interval[1]
    ax.plot([x, x], [low, high], color=color, lw=1.8, solid_capstyle="butt")
    ax.plot([x - 0.03, x + 0.03], [high, high], color=color, lw=1.8)
    share = rate.violated / rate.n
    ax.plot(x, max(share, FLOOR), "o", ms=5, color=color, mfc=color if rate.violated else "white", zorder=3)
