"""Figure of the tracking study: error over speed with the bounds, and the largest excess of each run."""

import pathlib

import numpy as np
from matplotlib.axes import Axes

from deltasafe.planning.tracking_bound import TrackingBound
from deltasafe.reporting.panels import new_figure, save_figure
from deltasafe.studies.tracking.study import TrackingStudy
from deltasafe.studies.tracking.tracking_errors import PHASES_OF_SPEED

COLORS = ("#5b8db8", "#e08a1e", "#8e6bb0", "#2a9d4a")
BOUND, PAPER = "#1b1f24", "#C8102E"
MAX_SAMPLES = 40_000
"""Samples that the figure shows."""


def plot_tracking(study: TrackingStudy, destination: str | pathlib.Path) -> None:
    """Plot samples of the held-out runs with the bounds, and each run's largest excess over the identified bound."""
    figure = new_figure(11.5, 4.8)
    left, right = figure.subplots(1, 2, width_ratios=(3, 2))
    _draw_errors(left, study)
    _draw_excesses(right, study)
    for ax in (left, right):
        ax.grid(alpha=0.3)
    save_figure(figure, destination)


def _draw_errors(ax: Axes, study: TrackingStudy) -> None:
    tracks, bound, paper_slope, paper = study.held_out, study.bound, study.paper_slope_bound, TrackingBound()
    order = np.random.default_rng(0).permutation(len(tracks.error_m))[:MAX_SAMPLES]
    speed, error = 1e3 * tracks.speed_mps, 1e3 * tracks.error_m
    for index, name in enumerate(PHASES_OF_SPEED):
        shown = order[tracks.phase[order] == index]
        ax.plot(speed[shown], error[shown], ".", ms=1.5, color=COLORS[index], rasterized=True)
        ax.plot([], [], "o", ms=5, color=COLORS[index], label=name)
    outside = tracks.excess_m(bound) > 0
    if outside.any():
        ax.plot(speed[outside], error[outside], "x", ms=4, color=PAPER, label="outside the bound")
    v = np.linspace(0, study.settings.v_max_mps, 50)
    for name, line, color, style in (
        ("identified", bound, BOUND, "-"),
        ("paper's slope", paper_slope, PAPER, "--"),
        ("paper", paper, PAPER, "-"),
    ):
        label = f"{name}: {1e3 * line.gamma0_m:.2f} mm + {1e3 * line.gamma1_s:.2f} ms · v"
        ax.plot(1e3 * v, 1e3 * line.error_m(v), style, color=color, lw=1.8, label=label)
    ax.set_ylim(0, 2.2e3 * max(bound.error_m(v[-1]), tracks.error_m.max()))
    ax.set_xlim(0, 1e3 * v[-1])
    ax.set(xlabel="speed of the reference [mm/s]", ylabel="workspace error [mm]")
    ax.set_title(f"{tracks.n_runs} held-out runs", fontsize=10)
    ax.legend(loc="upper right", fontsize=8, framealpha=0.9, ncols=2)


def _draw_excesses(ax: Axes, study: TrackingStudy) -> None:
    bound, whole = study.bound, study.coverage()[0]
    excesses = [1e3 * runs.worst_of_runs(runs.excess_m(bound)) for runs in (study.bound_runs, study.held_out)]
    edges = list(np.linspace(excesses[0].min(), max(0.1, excesses[0].max()), 50))
    labels = ("runs that determine the constant", "held-out runs")
    for excess, color, label in zip(excesses, (COLORS[0], BOUND), labels, strict=True):
        weights = np.full(len(excess), 1 / len(excess))
        ax.hist(excess, edges, weights=weights, histtype="step", lw=1.5, color=color, label=label)
    ax.axvline(0, color=PAPER, lw=1)
    title = f"within: {whole.runs_within} of {whole.runs} runs (lower 95 % bound {whole.runs_lower95:.2%})"
    ax.set_title(title, fontsize=10)
    ax.set(xlabel="largest excess of a run over the identified bound [mm]", ylabel="fraction of runs")
    ax.legend(loc="upper center", fontsize=8)
