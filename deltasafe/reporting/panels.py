"""Plots in panels side by side, as the studies have them: one look for all."""

import pathlib

from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from deltasafe.io.storage import atomic_file

__all__ = ["clean", "new_figure", "save"]


def new_figure(width_in: float, height_in: float) -> Figure:
    """An empty white figure."""
    figure = Figure(figsize=(width_in, height_in), dpi=130, facecolor="white", layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def clean(ax: Axes) -> None:
    """A faint grid behind what is drawn, no frame above and to the right."""
    ax.grid(color="#e1e4e8", lw=0.6)
    ax.set_axisbelow(True)
    ax.spines[["top", "right"]].set_visible(False)


def save(figure: Figure, destination: str | pathlib.Path) -> None:
    """Write the figure atomically; the suffix chooses the format."""
    with atomic_file(destination) as temporary:
        figure.savefig(temporary)
