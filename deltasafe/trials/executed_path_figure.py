"""Figure of an executed motion: over the image that it was planned from, with clearance, tracking error and speed."""

import pathlib
from typing import NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from numpy.typing import NDArray

from deltasafe.errors import SettingsError
from deltasafe.execution.recording import Execution
from deltasafe.geometry import yaw_of
from deltasafe.planning import PlannedMotion
from deltasafe.reporting import over_image
from deltasafe.reporting.over_image import CLEAR, INK, LIMIT, SIGNAL
from deltasafe.reporting.panels import save_figure
from deltasafe.scene import Camera
from deltasafe.trials.motion_figure import body_outlines

Array = NDArray[np.float64]


class Caption(NamedTuple):
    """Title of the figure, and display name of the obstacle."""

    title: str = ""
    thing: str = "hand"


_NO_CAPTION = Caption()


def executed_over_image(
    rgb: NDArray[np.uint8],
    p_occupied_image: NDArray[np.float32],
    camera: Camera,
    motion: PlannedMotion,
    execution: Execution,
    destination: str | pathlib.Path,
    caption: Caption = _NO_CAPTION,
) -> None:
    """Draw an executed motion with its plan.

    Left: the image with the contour of delta, the planned path (white), the executed path colored by speed, and the
    tool at its closest pose to the true hand. Right, over the planned arc length: distance to the true hand and planned
    clearance, tracking error and bound, speed and limit. Without a true hand, its distance is marked as not judged.

    Args:
        rgb: (H, W, 3) uint8, of the camera's size.
        p_occupied_image: (H, W), of the camera's size.
        motion: with a trajectory.
        execution: of this motion.
        destination: file that is written atomically; the suffix selects the format.
        caption: title, and name of the obstacle.

    Raises:
        SettingsError: images and camera differ in size, or the motion has no trajectory.
    """
    figure, image, axes = over_image.image_and_plots(rgb, p_occupied_image, camera)
    if motion.profile is None:
        raise SettingsError(f"there is no motion to draw: {motion.reason}")
    speed = _speed_mps(execution)
    _draw_image(image, p_occupied_image, camera, motion, execution, speed, caption.thing)
    _draw_limits(axes, motion, execution, speed, caption.thing)
    if caption.title:
        figure.suptitle(caption.title, x=0.01, ha="left", fontsize=11)
    save_figure(figure, destination)


def arc_length_of_samples_m(execution: Execution) -> Array:
    """Return (N,) arc length of the reference at each sample from the start of the motion; constant after a stop."""
    steps = np.linalg.norm(np.diff(execution.reference_poses[:, :3], axis=0), axis=1)
    steps[~(execution.judged[1:] & execution.judged[:-1])] = 0.0
    return np.append(0.0, np.cumsum(steps))


def _speed_mps(execution: Execution) -> Array:
    """(N,) measured speed of the tool's fastest point, as in the schedule: |dx| + rho_max |dyaw|."""
    if len(execution.time_s) < 2:
        return np.zeros(len(execution.time_s))
    linear = np.linalg.norm(np.gradient(execution.tool_positions_m, execution.time_s, axis=0), axis=1)
    yaw = np.unwrap(yaw_of(execution.tool_quaternions))
    return np.asarray(linear + execution.body.rho_max_m * np.abs(np.gradient(yaw, execution.time_s)))


def _draw_image(
    ax: Axes,
    p_occupied_image: NDArray[np.float32],
    camera: Camera,
    motion: PlannedMotion,
    execution: Execution,
    speed: Array,
    thing: str,
) -> None:
    figure, judged = ax.figure, execution.judged
    assert isinstance(figure, Figure)
    level = over_image.draw_delta_contour(ax, p_occupied_image, motion.settings.delta)
    planned, _ = camera.project(execution.reference_poses[judged, :3])
    executed, _ = camera.project(execution.tool_positions_m[judged])
    ax.plot(*planned.T, color="white", lw=5.0, solid_capstyle="round")
    over_image.draw_speed(
        figure, ax, executed, speed[judged], motion.settings.v_max_mps, "executed speed", linewidths=3.0
    )
    handles = [level, *over_image.mark_ends(ax, planned)]
    handles.insert(1, _draw_closest(ax, camera, execution, thing))
    over_image.finish_image(ax, handles, camera)
    if execution.stop_reason:
        ax.set_title(f"stopped by the monitor: {execution.stop_reason}", color=LIMIT, fontsize=9, loc="left")


def _draw_closest(ax: Axes, camera: Camera, execution: Execution, thing: str) -> Line2D:
    """Draw the tool at its closest pose to the true obstacle; return the legend entry."""
    if not execution.beside_hand:
        return Line2D([], [], ls="none", label=f"distance to the {thing}: not judged")
    closest = int(np.argmin(np.where(execution.judged, execution.tool_to_hand_m, np.inf)))
    pose = np.append(execution.tool_positions_m[closest], yaw_of(execution.tool_quaternions[closest]))
    edge, _ = camera.project(body_outlines(pose[None], execution.body)[0])
    ax.fill(*edge.T, facecolor="white", edgecolor="none", alpha=0.35)
    ax.plot(*edge.T, color=INK, lw=1.4)
    nearest_mm = 1000 * execution.tool_to_hand_m[closest]
    return Line2D([], [], color=INK, lw=1.4, label=f"tool at its closest pose, {nearest_mm:.1f} mm")


def _draw_limits(axes: list[Axes], motion: PlannedMotion, execution: Execution, speed: Array, thing: str) -> None:
    profile, settings, judged = motion.profile, motion.settings, execution.judged
    assert profile is not None
    arc_mm, planned_mm = 1000 * arc_length_of_samples_m(execution)[judged], 1000 * profile.arc_length_m
    clear, error, fast = axes
    if execution.beside_hand:
        clear.plot(arc_mm, 1000 * execution.tool_to_hand_m[judged], color=CLEAR, lw=1.8, label=f"to the true {thing}")
    clear.plot(planned_mm, 1000 * profile.clearance_m, color=INK, lw=1.1, ls="--", label="planned clearance $d_o$")
    clear.set(ylabel="distance [mm]", ylim=(0, None))
    allowed = motion.tracking.error_m(np.maximum(execution.reference_speed_mps[judged], settings.v_min_mps))
    error.plot(arc_mm, 1000 * execution.workspace_error_m[judged], color=SIGNAL, lw=1.4, label="tracking error")
    error.plot(arc_mm, 1000 * allowed, color=LIMIT, lw=1.3, ls="--", label=r"bound $\gamma(v)$")
    error.set_yscale("log")
    error.set_ylabel("error [mm]")
    fast.plot(planned_mm, 1000 * profile.limit_mps, color=LIMIT, lw=1.3, ls="--", label="limit $v^*$")
    fast.plot(planned_mm, 1000 * profile.speed_mps, color=INK, lw=1.0, ls=":", label="scheduled")
    fast.plot(arc_mm, 1000 * speed[judged], color=SIGNAL, lw=1.6, label="executed")
    fast.set(ylabel="speed [mm/s]", xlabel="arc length of the path [mm]", ylim=(0, 1080 * settings.v_max_mps))
    over_image.finish_plots(axes)
