"""Figure, axes and file settings that all plots share."""

import pathlib

from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from deltasafe.io.storage import atomic_file


def new_figure(width_in: float, height_in: float) -> Figure:
    """Create an empty white figure with constrained layout."""
    figure = Figure(figsize=(width_in, height_in), dpi=130, facecolor="white", layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def style_axes(ax: Axes) -> None:
    """Draw a faint grid behind the data and remove the upper and right spines."""
    ax.grid(color="#e1e4e8", lw=0.6)
    ax.set_axisbelow(True)
    ax.spines[["top", "right"]].set_visible(False)


def save_figure(figure: Figure, destination: str | pathlib.Path) -> None:
    """Write the figure atomically; the suffix selects the format."""
    with atomic_file(destination) as temporary:
        figure.savefig(temporary)
