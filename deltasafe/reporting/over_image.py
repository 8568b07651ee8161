"""Parts shared by figures that show a motion over its image, with three plots over path length beside it."""

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from numpy.typing import NDArray

from deltasafe.errors import SettingsError
from deltasafe.reporting.panels import new_figure
from deltasafe.scene import Camera

Array = NDArray[np.float64]
INK, SIGNAL, LIMIT, CLEAR = "#1b1f24", "#0a7d6c", "#d1495b", "#3366aa"


def image_and_plots(
    rgb: NDArray[np.uint8], p_occupied_image: NDArray[np.float32], camera: Camera
) -> tuple[Figure, Axes, list[Axes]]:
    """Create the figure with the image; return it, the image's axes and three axes with a common x axis.

    Raises:
        SettingsError: the image or the probabilities do not have the size of the camera.
    """
    if rgb.shape != (camera.height, camera.width, 3) or p_occupied_image.shape != rgb.shape[:2]:
        raise SettingsError(
            f"image {rgb.shape} and probabilities {p_occupied_image.shape} must have the camera's size "
            f"{(camera.height, camera.width)}"
        )
    figure = new_figure(12.6, 5.9)
    grid = figure.add_gridspec(3, 2, width_ratios=(1.5, 1.0))
    image = figure.add_subplot(grid[:, 0])
    first = figure.add_subplot(grid[0, 1])
    image.imshow(rgb, extent=(0.0, camera.width, camera.height, 0.0))
    return figure, image, [first, *(figure.add_subplot(grid[row, 1], sharex=first) for row in (1, 2))]


def draw_delta_contour(ax: Axes, p_occupied_image: NDArray[np.float32], delta: float) -> Line2D:
    """Draw the contour p_occupied = delta; return its legend entry."""
    height, width = p_occupied_image.shape
    if p_occupied_image.min() <= delta < p_occupied_image.max():
        rows, columns = np.arange(height) + 0.5, np.arange(width) + 0.5
        ax.contour(columns, rows, p_occupied_image, levels=[delta], colors=["white"], linewidths=2.6)
        ax.contour(columns, rows, p_occupied_image, levels=[delta], colors=[LIMIT], linewidths=1.3)
    return Line2D([], [], color=LIMIT, lw=1.6, label=f"P(occupied) = {delta:g}")


def draw_speed(
    figure: Figure, ax: Axes, uv: Array, speed_mps: Array, max_speed_mps: float, label: str, **style: Any
) -> None:
    """Draw a path (N, 2) in pixels, colored by speed (N,), with a color bar below the image."""
    lines = LineCollection(list(np.stack([uv[:-1], uv[1:]], axis=1)), cmap="viridis", **style)
    lines.set_array(1000 * (speed_mps[:-1] + speed_mps[1:]) / 2)
    lines.set_clim(0, 1000 * max_speed_mps)
    ax.add_collection(lines)
    bar = ax.inset_axes((0.15, -0.055, 0.7, 0.022))
    figure.colorbar(lines, cax=bar, orientation="horizontal").set_label(f"{label} [mm/s]")


def mark_ends(ax: Axes, uv: Array) -> list[Line2D]:
    """Mark start and goal of a path (N, 2) in pixels; return their legend entries."""
    handles = []
    for label, point, marker in (("start", uv[0], "o"), ("goal", uv[-1], "s")):
        ax.plot(*point, marker, ms=9, mfc="white", mec=INK, mew=1.8, ls="none")
        handles.append(Line2D([], [], marker=marker, ms=8, mfc="white", mec=INK, mew=1.6, ls="none", label=label))
    return handles


def finish_image(ax: Axes, handles: list[Line2D], camera: Camera) -> None:
    """Add the legend and limit the axes to the image."""
    ax.legend(handles=handles, loc="upper left", ncols=2, fontsize=8, framealpha=0.9)
    ax.set(xlim=(0, camera.width), ylim=(camera.height, 0), xticks=[], yticks=[])


def finish_plots(axes: list[Axes]) -> None:
    """Add grids and legends; the legend gets a strip above the curves. Only the last axes keep tick labels."""
    for ax in axes:
        ax.margins(x=0.01)
        ax.grid(color="#d8dbe0", lw=0.6)
        ax.set_axisbelow(True)
        ax.spines[["top", "right"]].set_visible(False)
        low, high = ax.get_ylim()
        ax.set_ylim(low, high * (high / low) ** 0.35 if ax.get_yscale() == "log" else 1.3 * high)
        ax.legend(fontsize=7.5, frameon=False, loc="upper center", ncols=3, handlelength=1.6, borderaxespad=0.2)
    for ax in axes[:-1]:
        ax.tick_params(labelbottom=False)
