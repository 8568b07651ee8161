"""Brute-force audit of planned motions; shares no code with the segment tests of the planner."""

import dataclasses
import itertools
import math

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_dilation

from deltasafe.errors import SettingsError
from deltasafe.geometry import Trajectory
from deltasafe.planning.body import ToolBody
from deltasafe.planning.motion import PlannedMotion
from deltasafe.planning.parts import ToolPart
from deltasafe.scene import OccupancyGrid

Array = NDArray[np.float64]


@dataclasses.dataclass(frozen=True)
class Audit:
    """Result of an audit.

    Attributes:
        poses: number of audited poses.
        unsafe_poses: number of poses at which a point of the tool has p_occupied > delta, or is closer to such a voxel
            than the margin of the motion.
        worst_p_occupied: largest p_occupied at any point of the tool.
    """

    poses: int
    unsafe_poses: int
    worst_p_occupied: float

    @property
    def is_safe(self) -> bool:
        """Whether no audited pose is unsafe."""
        return self.unsafe_poses == 0


def verify_motion(motion: PlannedMotion, grid: OccupancyGrid, spacing_m: float = 0.001) -> Audit:
    """Audit the trajectory of a planned motion against the delta of its settings and its margin.

    Args:
        grid: P(occupied) of the world; that of the motion, or another one.
        spacing_m: largest motion of any point of the tool between two audited poses.

    Raises:
        SettingsError: the motion has no trajectory.
    """
    if motion.trajectory is None:
        raise SettingsError(f"the motion has no trajectory to verify ({motion.reason})")
    delta = motion.settings.delta
    audit = audit_trajectory(motion.trajectory, grid, motion.body, delta, spacing_m)
    if not motion.margin_m:
        return audit
    dilated = _dilated_by_offsets(grid, delta, motion.margin_m)
    unsafe = audit_trajectory(motion.trajectory, dilated, motion.body, delta, spacing_m).unsafe_poses
    return dataclasses.replace(audit, unsafe_poses=unsafe)


def _dilated_by_offsets(grid: OccupancyGrid, delta: float, margin_m: float) -> OccupancyGrid:
    """As `OccupancyGrid.dilated`, by the list of all offsets between two voxels that are within the margin."""
    reach = 1 + math.floor(margin_m / grid.voxel_m + 1e-9)
    gap = np.maximum(np.abs(np.arange(-reach, reach + 1)) - 1, 0) * grid.voxel_m
    offsets = np.hypot(gap[:, None], gap[None, :]) <= margin_m
    unsafe = grid.p_occupied.astype(np.float64) > delta
    if grid.unseen is not None:
        unsafe[grid.unseen] = False
    return OccupancyGrid(
        np.maximum(grid.p_occupied, binary_dilation(unsafe, offsets[:, :, None])), grid.origin_m, grid.voxel_m
    )


def audit_trajectory(
    trajectory: Trajectory, grid: OccupancyGrid, body: ToolBody, delta: float, spacing_m: float = 0.001
) -> Audit:
    """Look up points of the tool (2 mm apart) in the grid, at samples at most ``spacing_m`` apart."""
    xyz, yaw = trajectory.poses[:, :3], trajectory.poses[:, 3]
    motion_m = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(xyz, axis=0), axis=1))])
    motion_m += body.rho_max_m * np.concatenate([[0.0], np.cumsum(np.abs(np.diff(yaw)))])
    samples = np.searchsorted(motion_m, np.arange(0.0, motion_m[-1], spacing_m))
    samples = np.unique(np.append(samples, len(motion_m) - 1))
    return _audit_poses(grid, body_points(body, 0.002), trajectory.poses[samples], delta)


def audit_path(
    path: Array, grid: OccupancyGrid, points_m: Array, delta: float, reach_m: float, spacing_m: float = 0.001
) -> Audit:
    """Look up points (P, 3) of a body in the grid, along the polyline of poses (N, 4).

    Args:
        reach_m: distance of the body's farthest point from its yaw axis.
        spacing_m: largest motion of any point of the body between two audited poses.
    """
    poses = [path[:1]]
    for start, end in itertools.pairwise(path):
        motion_m = float(np.linalg.norm((end - start)[:3])) + reach_m * abs(end[3] - start[3])
        fractions = np.linspace(0.0, 1.0, 1 + max(1, math.ceil(motion_m / spacing_m)))[1:, None]
        poses.append(start + fractions * (end - start))
    return _audit_poses(grid, points_m, np.concatenate(poses), delta)


def _audit_poses(grid: OccupancyGrid, points_m: Array, poses: Array, delta: float) -> Audit:
    cos, sin = np.cos(poses[:, 3]), np.sin(poses[:, 3])
    zero, one = np.zeros(len(poses)), np.ones(len(poses))
    rotations = np.stack([cos, -sin, zero, sin, cos, zero, zero, zero, one], axis=1).reshape(-1, 3, 3)
    worst = grid.max_p_occupied_on(points_m, rotations, poses[:, :3])
    return Audit(len(poses), int((worst.astype(np.float64) > delta).sum()), float(worst.max()))


def body_points(body: ToolBody, spacing_m: float = 0.0025) -> Array:
    """Points (P, 3) on and inside the tool in its frame, at most about ``spacing_m`` apart."""
    if not (math.isfinite(spacing_m) and spacing_m > 0):
        raise SettingsError(f"spacing_m must be a positive length in meters, got {spacing_m}")
    if body.parts:
        return np.concatenate([_points_of(part, spacing_m) for part in body.solids])
    half = body.thickness_m / 2
    scale = [body.semi_axis_x_m / body.rho_max_m, body.semi_axis_y_m / body.rho_max_m]
    disc, shaft = _rings(body.rho_max_m, spacing_m) * scale, _rings(body.shaft_radius_m, spacing_m)
    return np.concatenate([_layers(disc, -half, half, spacing_m), _layers(shaft, half, body.shaft_length_m, spacing_m)])


def _points_of(part: ToolPart, spacing_m: float) -> Array:
    """Points of a grid on the box around a part that lie in the part; at most 40 along each axis."""
    corners = part.corners()
    lower, upper = corners.min(axis=0) - part.radius_m, corners.max(axis=0) + part.radius_m
    counts = 1 + np.clip(np.ceil((upper - lower) / spacing_m).astype(int), 2, 40)
    axes = [np.linspace(low, high, count) for low, high, count in zip(lower, upper, counts, strict=True)]
    points_m = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    points_m = np.concatenate([points_m, corners])
    return points_m[part.distance_m(points_m) <= 0]


def _rings(radius_m: float, spacing_m: float) -> Array:
    rings = []
    for radius in np.linspace(0, radius_m, math.ceil(radius_m / spacing_m) + 1):
        count = max(1, math.ceil(2 * math.pi * radius / spacing_m))
        angle = 2 * np.pi * np.arange(count) / count
        rings.append(radius * np.stack([np.cos(angle), np.sin(angle)], axis=1))
    return np.concatenate(rings)


def _layers(flat: Array, bottom_m: float, top_m: float, spacing_m: float) -> Array:
    heights = np.linspace(bottom_m, top_m, math.ceil((top_m - bottom_m) / spacing_m) + 1)
    return np.concatenate([np.column_stack([flat, np.full(len(flat), z)]) for z in heights])
