"""The tracking error over speed, the paper's line, the identified bound, and what lay outside on held-out runs."""

import pathlib

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from deltasafe.io.storage import atomic_file
from deltasafe.planning.tracking_bound import TrackingBound
from deltasafe.studies.tracking.study import TrackingStudy
from deltasafe.studies.tracking.tracking_errors import PHASES_OF_SPEED

__all__ = ["plot_tracking"]

_COLORS = ("#5b8db8", "#e08a1e", "#8e6bb0", "#2a9d4a")
_BOUND, _PAPER, _OUTSIDE = "#1b1f24", "#C8102E", "#C8102E"
_SHOWN = 40_000


def plot_tracking(study: TrackingStudy, destination: str | pathlib.Path) -> None:
    """Samples of the held-out runs with the bounds; each run's largest excess over the identified one."""
    figure = Figure(figsize=(11.5, 4.8), layout="constrained")
    FigureCanvasAgg(figure)
    left, right = figure.subplots(1, 2, width_ratios=(3, 2))
    tracks, bound, paper = study.held_out, study.bound, TrackingBound()
    order = np.random.default_rng(0).permutation(len(tracks.error_m))[:_SHOWN]
    speed, error = 1e3 * tracks.speed_mps, 1e3 * tracks.error_m
    for index, name in enumerate(PHASES_OF_SPEED):
        shown = order[tracks.phase[order] == index]
        left.plot(speed[shown], error[shown], ".", ms=1.5, color=_COLORS[index], rasterized=True)
        left.plot([], [], "o", ms=5, color=_COLORS[index], label=name)
    outside = tracks.excess_m(bound) > 0
    if outside.any():
        left.plot(speed[outside], error[outside], "x", ms=4, color=_OUTSIDE, label="outside the bound")
    v = np.linspace(0, study.settings.v_max_mps, 50)
    lifted = study.lifted_paper_line
    left.plot(1e3 * v, 1e3 * bound.error_m(v), color=_BOUND, lw=2, label=_named("identified", bound))
    left.plot(1e3 * v, 1e3 * lifted.error_m(v), color=_PAPER, lw=1.5, ls="--", label=_named("paper's slope", lifted))
    left.plot(1e3 * v, 1e3 * paper.error_m(v), color=_PAPER, lw=1.5, label=_named("paper", paper))
    left.set_ylim(0, 2.2e3 * max(bound.error_m(v[-1]), tracks.error_m.max()))
    left.set_xlim(0, 1e3 * v[-1])
    left.set_xlabel("speed of the reference [mm/s]")
    left.set_ylabel("workspace error [mm]")
    left.set_title(f"{tracks.n_runs} held-out runs", fontsize=10)
    left.legend(loc="upper right", fontsize=8, framealpha=0.9, ncols=2)

    edges = None
    for runs, color, label in (
        (study.bound_runs, _COLORS[0], "runs that gave the constant"),
        (tracks, _BOUND, "held-out runs"),
    ):
        excess = 1e3 * runs.worst_of_runs(runs.excess_m(bound))
        edges = np.linspace(excess.min(), max(0.1, excess.max()), 50) if edges is None else edges
        weights = np.full(len(excess), 1 / len(excess))
        right.hist(excess, edges, weights=weights, histtype="step", lw=1.5, color=color, label=label)
    right.axvline(0, color=_PAPER, lw=1)
    whole = study.coverage()[0]
    right.set_title(
        f"within: {whole.runs_within} of {whole.runs} runs (lower 95 % bound {whole.runs_lower95:.2%})", fontsize=10
    )
    right.set_xlabel("largest excess of a run over the identified bound [mm]")
    right.set_ylabel("share of runs")
    right.legend(loc="upper center", fontsize=8)
    for ax in (left, right):
        ax.grid(alpha=0.3)
    with atomic_file(destination) as temporary:
        figure.savefig(temporary, dpi=130)


def _named(name: str, bound: TrackingBound) -> str:
    return f"{name}: {1e3 * bound.gamma0_m:.2f} mm + {1e3 * bound.gamma1_s:.2f} ms · v"
