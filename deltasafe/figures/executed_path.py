"""An executed motion over the image it was planned from, and its clearance, tracking and speed against their limits."""

import pathlib

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from numpy.typing import NDArray

from deltasafe.errors import SettingsError
from deltasafe.execution.recording import Execution
from deltasafe.figures.planning import CLEAR, INK, LIMIT, SIGNAL, body_outlines
from deltasafe.planning import PlannedMotion
from deltasafe.scene import Camera
from deltasafe.storage import atomic_file

__all__ = ["executed_over_image", "way_of_samples_m"]

Array = NDArray[np.float64]


def executed_over_image(
    rgb: NDArray[np.uint8],
    p_occupied_image: NDArray[np.float32],
    camera: Camera,
    motion: PlannedMotion,
    execution: Execution,
    destination: str | pathlib.Path,
    title: str = "",
) -> None:
    """Draw what was executed beside what was planned.

    Left: the image with the contour of delta, the planned way (white), the executed one coloured by its speed, the tool
    where it came closest to the true hand. Right, over the planned way: distance to the true hand and to what the plan
    took for unsafe; the tracking error under its bound; the speed under its limit.

    Args:
        rgb: (H, W, 3) uint8; p_occupied_image (H, W); both of the camera's size.
        motion: with a trajectory; execution: of it.
        destination: file to write, atomically; the suffix chooses the format.

    Raises:
        SettingsError: images and camera differ in size, or the motion has no trajectory.
    """
    if rgb.shape != (camera.height, camera.width, 3) or p_occupied_image.shape != rgb.shape[:2]:
        raise SettingsError(
            f"image {rgb.shape} and probabilities {p_occupied_image.shape} must have the camera's size "
            f"{(camera.height, camera.width)}"
        )
    if motion.profile is None:
        raise SettingsError(f"there is no motion to have been executed: {motion.reason}")
    figure = Figure(figsize=(12.6, 5.9), dpi=130, facecolor="white", layout="constrained")
    FigureCanvasAgg(figure)
    grid = figure.add_gridspec(3, 2, width_ratios=(1.5, 1.0))
    speed = _speed_mps(execution)
    _draw_image(figure, figure.add_subplot(grid[:, 0]), rgb, p_occupied_image, camera, motion, execution, speed)
    first = figure.add_subplot(grid[0, 1])
    axes = [first, *(figure.add_subplot(grid[row, 1], sharex=first) for row in (1, 2))]
    _draw_limits(axes, motion, execution, speed)
    if title:
        figure.suptitle(title, x=0.01, ha="left", fontsize=11)
    with atomic_file(destination) as temporary:
        figure.savefig(temporary)


def way_of_samples_m(execution: Execution) -> Array:
    """(N,) way of the reference at each sample, from the start of the motion on; a stopped arm has no way left."""
    steps = np.linalg.norm(np.diff(execution.reference_poses[:, :3], axis=0), axis=1)
    steps[~(execution.judged[1:] & execution.judged[:-1])] = 0.0
    return np.append(0.0, np.cumsum(steps))


def _speed_mps(execution: Execution) -> Array:
    """(N,) measured speed of the tool's fastest point, as the schedule counts it: |dx| + rho_max |turn|."""
    if len(execution.time_s) < 2:
        return np.zeros(len(execution.time_s))
    linear = np.linalg.norm(np.gradient(execution.tool_positions_m, execution.time_s, axis=0), axis=1)
    x, y, z, w = execution.tool_quaternions.T
    yaw = np.unwrap(np.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z)))
    return np.asarray(linear + execution.body.rho_max_m * np.abs(np.gradient(yaw, execution.time_s)))


def _draw_image(
    figure: Figure,
    ax: Axes,
    rgb: NDArray[np.uint8],
    p_occupied_image: NDArray[np.float32],
    camera: Camera,
    motion: PlannedMotion,
    execution: Execution,
    speed: Array,
) -> None:
    delta, judged = motion.settings.delta, execution.judged
    ax.imshow(rgb, extent=(0.0, camera.width, camera.height, 0.0))
    if p_occupied_image.min() <= delta < p_occupied_image.max():
        rows, columns = np.arange(camera.height) + 0.5, np.arange(camera.width) + 0.5
        ax.contour(columns, rows, p_occupied_image, levels=[delta], colors=["white"], linewidths=2.6)
        ax.contour(columns, rows, p_occupied_image, levels=[delta], colors=[LIMIT], linewidths=1.3)
    planned, _ = camera.project(execution.reference_poses[judged, :3])
    driven, _ = camera.project(execution.tool_positions_m[judged])
    ax.plot(*planned.T, color="white", lw=5.0, solid_capstyle="round")
    lines = LineCollection(list(np.stack([driven[:-1], driven[1:]], axis=1)), cmap="viridis", linewidths=3.0)
    lines.set_array(1000 * (speed[judged][:-1] + speed[judged][1:]) / 2)
    lines.set_clim(0, 1000 * motion.settings.v_max_mps)
    ax.add_collection(lines)
    bar = ax.inset_axes((0.15, -0.055, 0.7, 0.022))
    figure.colorbar(lines, cax=bar, orientation="horizontal").set_label("executed speed [mm/s]")
    closest = int(np.argmin(np.where(judged, execution.tool_to_hand_m, np.inf)))
    x, y, z, w = execution.tool_quaternions[closest]
    pose = np.append(execution.tool_positions_m[closest], np.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z)))
    edge, _ = camera.project(body_outlines(pose[None], execution.body)[0])
    ax.fill(*edge.T, facecolor="white", edgecolor="none", alpha=0.35)
    ax.plot(*edge.T, color=INK, lw=1.4)
    nearest_mm = 1000 * execution.tool_to_hand_m[closest]
    handles = [
        Line2D([], [], color=LIMIT, lw=1.6, label=f"P(occupied) = {delta:g}"),
        Line2D([], [], color=INK, lw=1.4, label=f"the tool where it came closest, {nearest_mm:.1f} mm"),
    ]
    for label, point, marker in (("start", planned[0], "o"), ("goal", planned[-1], "s")):
        ax.plot(*point, marker, ms=9, mfc="white", mec=INK, mew=1.8, ls="none")
        handles.append(Line2D([], [], marker=marker, ms=8, mfc="white", mec=INK, mew=1.6, ls="none", label=label))
    ax.legend(handles=handles, loc="upper left", ncols=2, fontsize=8, framealpha=0.9)
    ax.set(xlim=(0, camera.width), ylim=(camera.height, 0), xticks=[], yticks=[])
    if execution.stop_reason:
        ax.set_title(f"stopped by the monitor: {execution.stop_reason}", color=LIMIT, fontsize=9, loc="left")


def _draw_limits(axes: list[Axes], motion: PlannedMotion, execution: Execution, speed: Array) -> None:
    profile, settings, judged = motion.profile, motion.settings, execution.judged
    assert profile is not None
    way, planned = 1000 * way_of_samples_m(execution)[judged], 1000 * profile.arc_length_m
    clear, error, fast = axes
    clear.plot(way, 1000 * execution.tool_to_hand_m[judged], color=CLEAR, lw=1.8, label="to the true hand")
    clear.plot(planned, 1000 * profile.clearance_m, color=INK, lw=1.1, ls="--", label="planned clearance $d_o$")
    clear.set(ylabel="distance [mm]", ylim=(0, None))
    allowed = motion.tracking.error_m(np.maximum(execution.reference_speed_mps[judged], settings.v_min_mps))
    error.plot(way, 1000 * execution.workspace_error_m[judged], color=SIGNAL, lw=1.4, label="tracking error")
    error.plot(way, 1000 * allowed, color=LIMIT, lw=1.3, ls="--", label=r"bound $\gamma(v)$")
    error.set_yscale("log")
    error.set_ylabel("error [mm]")
    fast.plot(planned, 1000 * profile.limit_mps, color=LIMIT, lw=1.3, ls="--", label="limit $v^*$")
    fast.plot(planned, 1000 * profile.speed_mps, color=INK, lw=1.0, ls=":", label="scheduled")
    fast.plot(way, 1000 * speed[judged], color=SIGNAL, lw=1.6, label="executed")
    fast.set(ylabel="speed [mm/s]", xlabel="way along the path [mm]", ylim=(0, 1080 * settings.v_max_mps))
    for ax in axes:
        ax.margins(x=0.01)
        ax.grid(color="#d8dbe0", lw=0.6)
        ax.set_axisbelow(True)
        ax.spines[["top", "right"]].set_visible(False)
        low, high = ax.get_ylim()
        ax.set_ylim(low, high * (high / low) ** 0.35 if ax.get_yscale() == "log" else 1.3 * high)
        ax.legend(fontsize=7.5, frameon=False, loc="upper center", ncols=3, handlelength=1.6, borderaxespad=0.2)
    for ax in axes[:2]:
        ax.tick_params(labelbottom=False)
