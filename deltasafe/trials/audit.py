"""A second opinion on planned motions: brute force, and no code of the planner's tests."""

import dataclasses
import itertools
import math
import pathlib
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from deltasafe.execution.verdict import body_points
from deltasafe.geometry import Trajectory
from deltasafe.planning.body import ToolBody
from deltasafe.scene import LoggedScene, OccupancyGrid
from deltasafe.trials.motions import load_motion
from deltasafe.trials.occupancy_fields import load_occupancy_grid

__all__ = ["Audit", "audit_motions", "audit_path", "audit_trajectory"]


@dataclasses.dataclass(frozen=True)
class Audit:
    """How many poses of a trajectory were looked at, and at how many a point of the tool was unsafe."""

    poses: int
    unsafe_poses: int
    worst_p_occupied: float


def audit_trajectory(
    trajectory: Trajectory, grid: OccupancyGrid, body: ToolBody, delta: float, spacing_m: float = 0.001
) -> Audit:
    """Ask the field at points of the whole tool (2 mm apart), at poses at most ``spacing_m`` apart."""
    points = body_points(body, 0.002)
    xyz, yaw = trajectory.poses[:, :3], trajectory.poses[:, 3]
    way = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(xyz, axis=0), axis=1))])
    way += body.rho_max_m * np.concatenate([[0.0], np.cumsum(np.abs(np.diff(yaw)))])
    kept = np.unique(np.append(np.searchsorted(way, np.arange(0.0, way[-1], spacing_m)), len(way) - 1))
    return _looked(grid, points, trajectory.poses[kept], delta)


def audit_path(
    path: NDArray[np.float64],
    grid: OccupancyGrid,
    points_m: NDArray[np.float64],
    delta: float,
    reach_m: float,
    spacing_m: float = 0.001,
) -> Audit:
    """Ask the field at points (P, 3) of a body, along the straight edges between the waypoints (N, 4): x, y, z, yaw.

    Args:
        reach_m: distance of the body's farthest point from its axis; poses lie at most ``spacing_m`` of its way apart.
    """
    poses = [path[:1]]
    for start, end in itertools.pairwise(path):
        way_m = float(np.linalg.norm((end - start)[:3])) + reach_m * abs(end[3] - start[3])
        shares = np.linspace(0.0, 1.0, 1 + max(1, math.ceil(way_m / spacing_m)))[1:, None]
        poses.append(start + shares * (end - start))
    return _looked(grid, points_m, np.concatenate(poses), delta)


def _looked(grid: OccupancyGrid, points_m: NDArray[np.float64], poses: NDArray[np.float64], delta: float) -> Audit:
    cos, sin = np.cos(poses[:, 3]), np.sin(poses[:, 3])
    zero, one = np.zeros(len(poses)), np.ones(len(poses))
    rotations = np.stack([cos, -sin, zero, sin, cos, zero, zero, zero, one], axis=1).reshape(-1, 3, 3)
    worst = grid.most_on(points_m, rotations, poses[:, :3])
    return Audit(len(poses), int((worst.astype(np.float64) > delta).sum()), float(worst.max()))


def audit_motions(scenes: Sequence[LoggedScene], fields: pathlib.Path, motions: pathlib.Path) -> dict[str, Audit]:
    """The audit of each scene that has a trajectory."""
    audits = {}
    for scene in scenes:
        motion = load_motion(motions, scene.id)
        if motion.trajectory is not None:
            grid = load_occupancy_grid(fields, scene.id)
            audits[scene.id] = audit_trajectory(motion.trajectory, grid, motion.body, motion.settings.delta)
    return audits
