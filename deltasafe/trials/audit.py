"""A second opinion on planned motions: brute force, and no code of the planner's tests."""

import dataclasses
import pathlib
from collections.abc import Sequence

import numpy as np

from deltasafe.execution.safety import body_points
from deltasafe.geometry import Trajectory
from deltasafe.planning.body import ToolBody
from deltasafe.scene import LoggedScene, OccupancyGrid
from deltasafe.trials.fields import load_field
from deltasafe.trials.motions import load_motion

__all__ = ["Audit", "audit_motions", "audit_trajectory"]


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
    worst, unsafe = 0.0, 0
    for index in kept:
        c, s = np.cos(yaw[index]), np.sin(yaw[index])
        turned = points @ np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]).T
        p_occupied = float(grid.at(turned + xyz[index]).max())
        worst = max(worst, p_occupied)
        unsafe += p_occupied > delta
    return Audit(len(kept), int(unsafe), worst)


def audit_motions(scenes: Sequence[LoggedScene], fields: pathlib.Path, motions: pathlib.Path) -> dict[str, Audit]:
    """The audit of each scene that has a trajectory."""
    audits = {}
    for scene in scenes:
        motion = load_motion(motions, scene.id)
        if motion.trajectory is not None:
            grid = load_field(fields, scene.id)
            audits[scene.id] = audit_trajectory(motion.trajectory, grid, motion.body, motion.settings.delta)
    return audits
