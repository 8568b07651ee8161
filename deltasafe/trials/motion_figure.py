"""Figure of a planned motion: over the image that it was planned from, and as height, clearance and speed."""

import pathlib

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from numpy.typing import NDArray
from scipy.spatial import ConvexHull

from deltasafe.planning import PlannedMotion, ToolBody, ToolPart
from deltasafe.reporting import over_image
from deltasafe.reporting.over_image import CLEAR, INK, LIMIT, SIGNAL
from deltasafe.reporting.panels import save_figure
from deltasafe.scene import Camera

Array = NDArray[np.float64]


def plan_over_image(
    rgb: NDArray[np.uint8],
    p_occupied_image: NDArray[np.float32],
    camera: Camera,
    motion: PlannedMotion,
    destination: str | pathlib.Path,
    table_z_m: float = 0.0,
) -> None:
    """Draw a planned motion, or a scene without a motion and the reason.

    Left: the image, P(occupied) as a transparent overlay with the contour of delta, the path of the disc colored by
    speed, and outlines of the disc. Right, over the arc length: height above the table, clearance, and speed with its
    limit.

    Args:
        rgb: (H, W, 3) uint8.
        p_occupied_image: (H, W) probabilities.
        camera: of both images.
        motion: the planned motion.
        destination: file that is written atomically; the suffix selects the format.
        table_z_m: height of the table.

    Raises:
        SettingsError: images and camera differ in size.
    """
    figure, image, axes = over_image.image_and_plots(rgb, p_occupied_image, camera)
    _draw_image(figure, image, p_occupied_image, camera, motion)
    if motion.profile is None:
        for ax in axes:
            ax.set_axis_off()
        axes[1].text(
            0.0, 0.5, "No motion.\n" + motion.reason, wrap=True, va="center", color=LIMIT, transform=axes[1].transAxes
        )
    else:
        _draw_profile(axes, motion, table_z_m)
    save_figure(figure, destination)


def _draw_image(
    figure: Figure, ax: Axes, p_occupied_image: NDArray[np.float32], camera: Camera, motion: PlannedMotion
) -> None:
    overlay = np.zeros((*p_occupied_image.shape, 4))
    overlay[..., :3] = (0.82, 0.29, 0.36)
    overlay[..., 3] = 0.45 * p_occupied_image
    ax.imshow(overlay, extent=(0.0, camera.width, camera.height, 0.0))
    handles = [over_image.draw_delta_contour(ax, p_occupied_image, motion.settings.delta)]
    path = motion.result.path
    if path is not None:
        shown = motion.profile.poses if motion.profile is not None else path.poses
        uv, _ = camera.project(shown[:, :3])
        for outline in body_outlines(shown, motion.body):
            edge, _ = camera.project(outline)
            ax.fill(*edge.T, facecolor="white", edgecolor=INK, alpha=0.16, lw=0)
            ax.plot(*edge.T, color=INK, lw=0.8, alpha=0.75)
        ax.plot(*uv.T, color="white", lw=5.0, solid_capstyle="round")
        if motion.profile is not None:
            most_mps, style = motion.settings.v_max_mps, {"linewidths": 3.2, "capstyle": "round"}
            over_image.draw_speed(figure, ax, uv, motion.profile.speed_mps, most_mps, "speed along the path", **style)
        else:
            ax.plot(*uv.T, color=LIMIT, lw=2.0, ls="--")
        handles += over_image.mark_ends(ax, uv)
        handles.append(Line2D([], [], color=INK, lw=1.0, label="outline of the tool"))
    over_image.finish_image(ax, handles, camera)


def _draw_profile(axes: list[Axes], motion: PlannedMotion, table_z_m: float) -> None:
    profile, settings = motion.profile, motion.settings
    assert profile is not None
    arc_mm = 1000 * profile.arc_length_m
    height, clear, speed = axes
    z_mm = 1000 * (profile.poses[:, 2] - table_z_m)
    half_mm = 500 * motion.body.thickness_m
    height.fill_between(arc_mm, z_mm - half_mm, z_mm + half_mm, color=CLEAR, alpha=0.2, lw=0)
    height.plot(arc_mm, z_mm, color=CLEAR, lw=1.8, label="center and thickness of the disc")
    height.axhline(0, color=INK, lw=1.2)
    height.set(ylabel="height [mm]", ylim=(-4, None))
    needed_mm = 1000 * motion.tracking.error_m(profile.speed_mps)
    clear.plot(arc_mm, 1000 * profile.clearance_m, color=CLEAR, lw=1.8, label="clearance $d_o$")
    clear.fill_between(arc_mm, 0, needed_mm, color=LIMIT, alpha=0.25, lw=0, label=r"tracking error $\gamma(v)$")
    clear.set(ylabel="distance [mm]", ylim=(0, None))
    speed.plot(arc_mm, 1000 * profile.limit_mps, color=LIMIT, lw=1.3, ls="--", label="limit $v^*$")
    speed.plot(arc_mm, 1000 * profile.speed_mps, color=SIGNAL, lw=1.8, label="scheduled speed")
    speed.axhline(1000 * settings.v_min_mps, color=INK, lw=0.8, ls=":", label="smallest allowed speed")
    speed.set(ylabel="speed [mm/s]", xlabel="arc length of the path [mm]", ylim=(0, 1080 * settings.v_max_mps))
    over_image.finish_plots(axes)
    duration = motion.trajectory.duration_s if motion.trajectory is not None else 0.0
    height.set_title(
        f"{duration:.1f} s for {arc_mm[-1]:.0f} mm, least clearance {1000 * profile.clearance_m.min():.1f} mm",
        fontsize=10,
        loc="left",
    )


def body_outlines(poses: Array, body: ToolBody, apart_m: float = 0.035) -> list[Array]:
    """Return outlines (M, 3) of the disc or parts, seen from above, at poses ``apart_m`` apart; both ends included."""
    steps = np.linalg.norm(np.diff(poses[:, :3], axis=0), axis=1) + body.rho_max_m * np.abs(np.diff(poses[:, 3]))
    arc_m = np.append(0.0, np.cumsum(steps))
    places = np.linspace(0, arc_m[-1], 1 + max(1, round(arc_m[-1] / apart_m)))
    angle = np.linspace(0, 2 * np.pi, 72)
    circle = np.column_stack([np.cos(angle), np.sin(angle)])
    if body.parts:
        rims = [_outline(part, circle) for part in body.parts]
    else:
        rims = [circle * [body.semi_axis_x_m, body.semi_axis_y_m]]
    outlines = []
    for place in places:
        pose = poses[min(int(np.searchsorted(arc_m, place)), len(poses) - 1)]
        cos, sin = np.cos(pose[3]), np.sin(pose[3])
        for rim in rims:
            turned = rim @ np.array([[cos, sin], [-sin, cos]])
            outlines.append(np.column_stack([turned + pose[:2], np.full(len(rim), pose[2])]))
    return outlines


def _outline(part: ToolPart, circle: Array) -> Array:
    """Convex hull (M, 2), closed, of a part seen from above, in the tool's frame."""
    core = part.corners()[:, :2]
    if part.kind == "disc":
        cos, sin = np.cos(part.yaw_rad), np.sin(part.yaw_rad)
        rim = circle * [part.half_x_m, part.half_y_m]
        core = rim @ np.array([[cos, sin], [-sin, cos]]) + [part.x_m, part.y_m]
    points = (core[:, None] + max(part.radius_m, 1e-6) * circle).reshape(-1, 2)
    hull = ConvexHull(points).vertices
    return np.asarray(points[np.append(hull, hull[0])])
