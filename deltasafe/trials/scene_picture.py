"""Picture of what a scene means: world axes, table grid, start, goal and border of the view, over its image."""

import math
import pathlib
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Polygon, Rectangle
from matplotlib.patheffects import withStroke
from numpy.typing import NDArray

from deltasafe.geometry import Pose
from deltasafe.planning import ToolBody
from deltasafe.reporting.over_image import INK, LIMIT, SIGNAL
from deltasafe.reporting.panels import new_figure, save_figure
from deltasafe.scene import Camera, LoggedScene
from deltasafe.scene.extrusion import useful_area
from deltasafe.trials.motion_figure import body_outlines

Array = NDArray[np.float64]
AXES = (("x", "#e6194b"), ("y", "#2ca02c"), ("z", "#1f5fff"))
ENDS = (("start", SIGNAL), ("goal", "#b5179e"))
BORDER = "#f08c00"
GRID_STEPS_M = (0.02, 0.05, 0.1, 0.2, 0.5, 1.0)
MAX_LINES = 12
MARGIN = 0.14
"""Of the larger side of the image, drawn around it, so that what lies just outside of the view is seen as such."""


class Grid(NamedTuple):
    """Lines on the table: every ``step_m`` from ``low`` to ``high`` (2,), multiples of the step, at height ``z_m``."""

    low: Array
    high: Array
    step_m: float
    z_m: float

    def values(self, axis: int) -> Array:
        first, last = np.round(np.array([self.low[axis], self.high[axis]]) / self.step_m)
        return np.asarray(np.arange(first, last + 1) * self.step_m)


def draw_scene(
    rgb: NDArray[np.uint8],
    scene: LoggedScene,
    destination: str | pathlib.Path,
    notes: Sequence[str] = (),
    body: ToolBody | None = None,
) -> None:
    """Draw a scene over its image and from above, with its facts; the suffix of ``destination`` selects the format.

    Args:
        rgb: (H, W, 3) uint8, of the camera's size.
        notes: warnings that are printed into the picture.
        body: the tool at start and goal.
    """
    seen = scene.camera.view_on_plane(scene.table_z_m, *useful_area(scene.start, scene.goal))
    body = body or ToolBody()
    ends = np.vstack([useful_area(scene.start, scene.goal, body.rho_max_m)])
    grid = _grid(np.vstack([seen, ends]), scene.table_z_m)
    figure = new_figure(13.6, 6.9)
    layout = figure.add_gridspec(2, 2, width_ratios=(1.7, 1.0), height_ratios=(1.6, 1.0))
    _draw_image(figure.add_subplot(layout[:, 0]), rgb, scene, grid, body)
    _draw_from_above(figure.add_subplot(layout[0, 1]), scene, seen, grid, body)
    _write_facts(figure.add_subplot(layout[1, 1]), scene, notes)
    figure.suptitle(
        f"{scene.id}.  Check: the grid lies flat on the table and its squares measure {grid.step_m:g} m; x, y and z "
        "point as in your world frame; start and goal are where the tool shall be.",
        x=0.01,
        ha="left",
        fontsize=10.5,
    )
    save_figure(figure, destination)


def _grid(points: Array, z_m: float) -> Grid:
    """Grid around points (N, 2)."""
    low, high = points.min(axis=0), points.max(axis=0)
    step_m = next((step for step in GRID_STEPS_M if (high - low).max() <= MAX_LINES * step), GRID_STEPS_M[-1])
    return Grid(step_m * np.floor(low / step_m), step_m * np.ceil(high / step_m), step_m, z_m)


def _draw_image(ax: Axes, rgb: NDArray[np.uint8], scene: LoggedScene, grid: Grid, body: ToolBody) -> None:
    camera = scene.camera
    margin = MARGIN * max(camera.width, camera.height)
    ax.imshow(rgb, extent=(0.0, camera.width, camera.height, 0.0))
    ax.set(xlim=(-margin, camera.width + margin), ylim=(camera.height + margin, -margin), xticks=[], yticks=[])
    ax.set_facecolor("#dfe3e8")
    _draw_lines(ax, camera, grid)
    border = Rectangle((0, 0), camera.width, camera.height, fill=False, ec=BORDER, lw=3)
    border.set_label("border of the view; beyond it, space below the obstacle's height counts as occupied")
    ax.add_patch(border)
    origin_m = _axes_origin(camera, grid)
    for axis in (2, 0, 1):  # z may hide y where the camera looks along y
        _label(ax, _draw_arrow(ax, camera, origin_m, axis, grid.step_m), *AXES[axis], 17)
    origin = ", ".join(f"{value:.3g}" for value in origin_m)
    _label(ax, camera.project(origin_m[None])[0][0] + (0, 0.035 * camera.height), f"({origin})", INK, 8)
    for (name, color), pose in zip(ENDS, (scene.start, scene.goal), strict=True):
        _draw_end(ax, camera, pose, body, (name, color), scene.table_z_m)
    ax.legend(handles=[border], loc="lower left", fontsize=8, framealpha=0.9, borderaxespad=0.2)


def _draw_lines(ax: Axes, camera: Camera, grid: Grid) -> None:
    """Draw the lines of constant x and y; label each where it leaves the image, or where there is room."""
    labeled: list[Array] = []
    for axis in (0, 1):
        along = np.linspace(grid.low[1 - axis], grid.high[1 - axis], 400)
        for value in grid.values(axis):
            points = np.full((len(along), 3), grid.z_m)
            points[:, axis], points[:, 1 - axis] = value, along
            uv, _ = camera.project(points)
            ax.plot(*uv.T, color="black", lw=1.7, alpha=0.35)
            ax.plot(*uv.T, color="white", lw=1.0, alpha=0.9)
            inside = uv[((uv > 0) & (uv < (camera.width, camera.height))).all(axis=1)]
            if len(inside):
                name, color = AXES[axis]
                places = inside[::-1] if axis else inside
                spacing = np.array([0.1 * camera.width, 0.04 * camera.height])
                free = (at for at in places if all((np.abs(at - other) > spacing).any() for other in labeled))
                labeled.append(next(free, places[0]))
                _label(ax, labeled[-1], f"{name} = {value:.3g}", color, 8)


def _axes_origin(camera: Camera, grid: Grid) -> Array:
    """(3,) the crossing of the grid where the axes are drawn: (0, 0) if it is well inside the image, else near it."""
    x, y = np.meshgrid(grid.values(0), grid.values(1), indexing="ij")
    crossings = np.column_stack([x.ravel(), y.ravel(), np.full(x.size, grid.z_m)])
    size = np.array([camera.width, camera.height])
    centered = np.abs(camera.project(crossings)[0] / size - 0.5).max(axis=1)  # 0.5 at the image's border
    usable = np.flatnonzero(centered < 0.35)  # false for NaN
    if not len(usable):
        return np.asarray(crossings[np.nanargmin(centered)])
    return np.asarray(crossings[usable[np.argmin(np.linalg.norm(crossings[usable, :2], axis=1))]])


def _draw_arrow(ax: Axes, camera: Camera, origin_m: Array, axis: int, length_m: float) -> Array:
    """Draw one axis of the world; return the pixel coordinates of its tip."""
    end_m = origin_m + length_m * np.eye(3)[axis]
    (first, last), _ = camera.project(np.array([origin_m, end_m]))
    for color, width in (("white", 6.0), (AXES[axis][1], 3.2)):
        ax.annotate("", last, first, arrowprops={"arrowstyle": "-|>", "color": color, "lw": width, "shrinkA": 0})
    length_px = float(np.linalg.norm(last - first))
    if length_px < 0.02 * camera.width:  # points at the camera
        ax.plot(*first, "o", ms=11, mfc="white", mec=AXES[axis][1], mew=2.5)
        ax.plot(*first, "o", ms=3, color=AXES[axis][1])
        return np.asarray(first - 0.025 * camera.width)
    return np.asarray(last + (last - first) * (0.025 * camera.width / length_px))


def _draw_end(ax: Axes, camera: Camera, pose: Pose, body: ToolBody, style: tuple[str, str], table_z_m: float) -> None:
    """Draw the tool at a pose, the line from it down to the table, and one from its center along its x axis."""
    name, color = style
    outline = body_outlines(pose.as_array()[None], body)[0]
    center = np.array([pose.x_m, pose.y_m, pose.z_m])
    foot = np.array([pose.x_m, pose.y_m, table_z_m])
    edge, _ = camera.project(outline)
    ax.fill(*edge.T, facecolor=color, alpha=0.3, lw=0)
    for points, width in ((outline, 2.0), (np.array([foot, center]), 1.5), (np.array([center, outline[0]]), 2.4)):
        ax.plot(*camera.project(points)[0].T, color=color, lw=width, path_effects=_halo(width))
    place, text = camera.project(center[None])[0][0], f"{name} ({pose.x_m:g}, {pose.y_m:g}, {pose.z_m:g})"
    (left, right), (bottom, top) = ax.get_xlim(), ax.get_ylim()
    if left < place[0] < right and top < place[1] < bottom:  # false for NaN
        place = np.array([place[0], edge[:, 1].min() - 0.03 * camera.height])
    else:
        place = np.array([camera.width / 2, top + (0.03 if name == "start" else 0.07) * (bottom - top)])
        text += " is outside of this picture"
    _label(ax, place, text, color, 9.5)


def _draw_from_above(ax: Axes, scene: LoggedScene, seen: Array, grid: Grid, body: ToolBody) -> None:
    """Draw the table as seen from above: x to the right, y up."""
    ax.add_patch(Polygon(seen, closed=True, fc="#fff3bf", ec=BORDER, lw=2))
    for (name, color), pose in zip(ENDS, (scene.start, scene.goal), strict=True):
        outline = body_outlines(pose.as_array()[None], body)[0]
        ax.fill(*outline[:, :2].T, facecolor=color, alpha=0.4)
        ax.plot(*outline[:, :2].T, color=color, lw=1.4)
        _label(ax, np.array([pose.x_m, outline[:, 1].max() + 0.35 * grid.step_m]), name, color, 9)
    low, high, camera_m = grid.low - grid.step_m / 2, grid.high + grid.step_m / 2, scene.camera.position_m
    is_shown = bool(((low < camera_m[:2]) & (camera_m[:2] < high)).all())
    if is_shown:
        ax.plot(*camera_m[:2], "D", ms=7, color=INK)
        _label(ax, camera_m[:2] - (0, 0.35 * grid.step_m), "camera", INK, 8)
    x, y = (f"{name} [m]" for name in "xy")
    ax.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), aspect="equal", xlabel=x, ylabel=y)
    ax.set(xticks=grid.values(0), yticks=grid.values(1))
    ax.tick_params(labelsize=7)
    ax.grid(color="#ced4da", lw=0.7)
    ax.set_axisbelow(True)
    ax.xaxis.label.set_color(AXES[0][1])
    ax.yaxis.label.set_color(AXES[1][1])
    ax.set_title("from above; yellow: what is used of the table (seen, near start and goal)", fontsize=9, loc="left")


def _write_facts(ax: Axes, scene: LoggedScene, notes: Sequence[str]) -> None:
    camera, table_z_m = scene.camera, scene.table_z_m
    down = -float(camera.world_from_camera_rotation[2, 2])
    tilt = math.degrees(math.acos(min(max(down, -1.0), 1.0)))
    x_m, y_m, z_m = camera.position_m
    facts = [
        f"camera at ({x_m:.3f}, {y_m:.3f}, {z_m:.3f}) m, tilted by {tilt:.0f} degrees from straight down",
        f"table at z = {table_z_m:g} m, obstacle up to {1000 * scene.hand_height_m:.0f} mm above it",
    ]
    for (name, _), pose in zip(ENDS, (scene.start, scene.goal), strict=True):
        height_mm, yaw = 1000 * (pose.z_m - table_z_m), math.degrees(pose.yaw_rad)
        facts.append(f"{name}: {height_mm:.0f} mm above the table, yaw {yaw:.0f} degrees")
    ax.set_axis_off()
    ax.text(0, 1, "\n".join(facts), va="top", fontsize=9, transform=ax.transAxes)
    text = "\n".join(f"Warning: {note}" for note in notes)
    ax.text(0, 0.5, text, va="top", fontsize=9, color=LIMIT, transform=ax.transAxes, wrap=True)


def _label(ax: Axes, place: Array, text: str, color: str, size: float) -> None:
    ax.text(
        float(place[0]),
        float(place[1]),
        text,
        color=color,
        fontsize=size,
        weight="bold",
        ha="center",
        va="center",
        path_effects=_halo(2.0),
        clip_on=True,
    )


def _halo(width: float) -> list[withStroke]:
    """A white border, which keeps a line or text readable on any image."""
    return [withStroke(linewidth=width + 2.0, foreground="white")]
