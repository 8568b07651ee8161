"""Figures of the safety study: rates with intervals, clearances, and clearance by speed."""

import pathlib
from collections.abc import Iterable
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from deltasafe.reporting.panels import new_figure, save_figure, style_axes
from deltasafe.studies import baselines
from deltasafe.studies.safety.evidence import Rate, by_speed, evaluate
from deltasafe.studies.safety.study import SafetyStudy

COLORS = baselines.COLORS | {"single_member": "#e08a1e", "top_speed": "#8a4fbf", "with_margin": "#8c5a3c"}
INK, GRAY = "#1b1f24", "#8a8f98"
ZERO_AT = 6e-4
"""Position of a rate of 0 on the logarithmic axis."""


def plot_rates(study: SafetyStudy, destination: str | pathlib.Path) -> None:
    """Plot the fraction of motions with a violation, with exact 95 % intervals, by delta and method."""
    figure = new_figure(11.5, 5.2)
    axes = figure.subplots(1, 2, sharey=True)
    deltas, methods = study.settings.deltas, study.settings.methods
    for group, delta in enumerate(deltas):
        for ax in axes:
            ax.plot([group - 0.48, group + 0.48], [delta, delta], "--", color=GRAY, lw=1.2, zorder=1)
        for index, name in enumerate(methods):
            found = evaluate(study, name, delta)
            x = group - 0.4 + (index + 0.5) * 0.8 / len(methods)
            if found.executed:
                for ax, rate in zip(axes, (found.violation, found.touch), strict=True):
                    _draw_interval(ax, x, rate, COLORS[name])
    titles = ("Beyond delta in the field that was used", "The tool touches or crosses the true hand")
    for ax, title in zip(axes, titles, strict=True):
        ax.set_yscale("log")
        ax.set_ylim(ZERO_AT * 0.75, 1.3)
        ax.set_yticks([ZERO_AT, 0.001, 0.01, 0.05, 0.2, 1.0], ["0", "0.1 %", "1 %", "5 %", "20 %", "100 %"])
        ax.minorticks_off()
        ax.set_xticks(range(len(deltas)), [f"delta = {delta:g}" for delta in deltas])
        ax.set_xlim(-0.6, len(deltas) - 0.4)
        ax.set_title(title, fontsize=10)
        style_axes(ax)
    axes[0].set_ylabel("motions with at least one such pose")
    handles = [
        *_handles(study, methods, marker="o", ms=5, lw=1.6),
        Line2D([], [], color=GRAY, ls="--", lw=1.2, label="delta, the bound for each point of the tool"),
        Line2D([], [], color=INK, marker="o", mfc="white", ms=5, ls="none", label="no such motion"),
    ]
    _save_with_legend(figure, handles, 4, destination)


def plot_clearances(study: SafetyStudy, destination: str | pathlib.Path) -> None:
    """Plot the cumulative distribution of the smallest distance to the true hand, one panel per delta."""
    figure = new_figure(11.5, 4.3)
    for ax, delta in _panels(figure, study):
        for name in study.settings.methods:
            tool_m = np.sort(study.trials["min_tool_m"][study.of(name, delta) & study.executed])
            if len(tool_m):
                fraction = np.arange(1, len(tool_m) + 1) / len(tool_m)
                ax.step(1000 * tool_m, fraction, where="post", color=COLORS[name], lw=1.7)
        ax.axvline(0, color=INK, lw=0.8)
        ax.set(xlabel="smallest distance of the tool to the true hand [mm]", ylim=(0, 1), xlim=(-1, None))
    figure.axes[0].set_ylabel("fraction of executed motions")
    _save_with_legend(figure, _handles(study, study.settings.methods, lw=1.7), 3, destination)


def plot_speed(study: SafetyStudy, destination: str | pathlib.Path) -> None:
    """Plot the smallest clearance and the fraction of poses by speed, with and without the velocity schedule."""
    figure = new_figure(11.5, 4.3)
    for ax, delta in _panels(figure, study):
        for offset, name in ((-0.2, "ours"), (0.2, "top_speed")):
            bins = by_speed(study, name, delta)
            poses = sum(one.poses for one in bins)
            for n, one in enumerate(bins):
                if one.poses:
                    top = (n + offset, 1000 * one.min_tool_m)
                    ax.bar(*top, 0.38, color=COLORS[name], alpha=0.85)
                    text = f"{100 * one.poses / poses:.0f} %"
                    ax.annotate(text, top, (0, 2), textcoords="offset points", ha="center", fontsize=6.5)
        ticks = [f"{1000 * one.from_mps:.0f}-{1000 * one.to_mps:.0f}" for one in bins[:-1]]
        ax.set_xticks(range(len(bins)), [*ticks, f"> {1000 * bins[-1].from_mps:.0f}"], fontsize=7.5)
        ax.set_xlabel("reference speed [mm/s]")
        ax.margins(y=0.1)
    figure.axes[0].set_ylabel("smallest distance to the true hand [mm]\n(above: fraction of poses)")
    _save_with_legend(figure, _handles(study, ("ours", "top_speed"), lw=6), 2, destination)


def _panels(figure: Figure, study: SafetyStudy) -> list[tuple[Axes, float]]:
    """Create one panel per delta."""
    deltas = study.settings.deltas
    panels = list(zip(figure.subplots(1, len(deltas), sharey=True, sharex=True, squeeze=False)[0], deltas, strict=True))
    for ax, delta in panels:
        ax.set_title(f"delta = {delta:g}", fontsize=10)
        style_axes(ax)
    return panels


def _handles(study: SafetyStudy, methods: Iterable[str], **style: Any) -> list[Line2D]:
    return [Line2D([], [], color=COLORS[name], label=study.label(name), **style) for name in methods]


def _save_with_legend(figure: Figure, handles: list[Line2D], columns: int, destination: str | pathlib.Path) -> None:
    figure.legend(handles=handles, loc="outside lower center", ncols=columns, frameon=False, fontsize=8.5)
    save_figure(figure, destination)


def _draw_interval(ax: Axes, x: float, rate: Rate, color: str) -> None:
    low, high = max(rate.interval[0], ZERO_AT), rate.interval[1]
    ax.plot([x, x], [low, high], color=color, lw=1.8, solid_capstyle="butt")
    ax.plot([x - 0.03, x + 0.03], [high, high], color=color, lw=1.8)
    fraction = rate.violated / rate.n
    ax.plot(x, max(fraction, ZERO_AT), "o", ms=5, color=color, mfc=color if rate.violated else "white", zorder=3)
