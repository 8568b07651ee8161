"""Paths of the loop: whether the rest of one is still clear, and a new one from where the arm rests."""

import numpy as np

from deltasafe.errors import PlanningError
from deltasafe.geometry import Pose
from deltasafe.online.committed import Committed, TimedPath
from deltasafe.online.moving_set import MovingSet
from deltasafe.online.settings import OnlineSettings
from deltasafe.planning import MotionSettings, Planner, PlanStatus, schedule

SHARES = (1.0, 0.5, 0.0)
"""Parts of the planning horizon that are tried: beside a hand at the goal, a smaller reserve may still do."""

VOXEL_DIAGONAL = 1.75
"""Clearances are lower bounds that lose at most a voxel's diagonal; a path that the planner accepted must not count as
blocked for that."""

LOOK_AHEAD_M = 0.002
"""Motion between poses of the rest of a path that are tested; a piece of it is verified before it is driven."""


def is_blocked(path: TimedPath, committed: Committed, now_s: float, moving_set: MovingSet, margin_m: float) -> bool:
    """Whether the set of the newest image, as it was captured, closes the rest of a path even to a tool that crawls."""
    done_s = committed.state_at(now_s)[0] if committed.path is path else 0.0
    time_s, poses = path.trajectory.time_s, path.trajectory.poses
    rest = poses[max(int(np.searchsorted(time_s, done_s, "right")) - 1, 0) :]
    moved = np.linalg.norm(np.diff(rest[:, :3], axis=0), axis=1) + path.rho_max_m * np.abs(np.diff(rest[:, 3]))
    along_m = np.append(0.0, np.cumsum(moved))
    tested = np.searchsorted(along_m, np.arange(0.0, along_m[-1], LOOK_AHEAD_M))
    lost_m = VOXEL_DIAGONAL * moving_set.field.arrays.lattice.voxel_m
    return bool((moving_set.clearance_m(rest[np.append(tested, -1)]) < margin_m - lost_m).any())


class Replanner:
    """Plans in the unsafe set as it may be a little later, so that a path leaves room for a hand that moves.

    Args:
        goal: of all paths.
        motion: search, speed limits, tool and tracking bound.
        seed: of the first search; later searches count on from it.
    """

    def __init__(self, goal: Pose, motion: MotionSettings, settings: OnlineSettings, seed: int) -> None:
        self._goal, self._motion, self._settings, self._seed = goal, motion, settings, seed
        self._number = 0
        self._planner: Planner | None = None
        self._start: Pose | None = None

    def plan(self, start: Pose, moving_set: MovingSet) -> tuple[TimedPath | None, str]:
        """Plan and time a path from a pose at rest; return it, or None and the reason.

        From an unchanged start, the search continues in the changed field: edges that are still safe keep their costs.
        """
        motion, reason = self._motion, ""
        for share in SHARES:
            field = moving_set.grown(share * self._settings.horizon_s)
            if self._planner is None or self._start != start:
                self._planner = Planner(start, [self._goal], field, motion, self._seed + self._number, motion.body)
                self._start = start
                result = self._planner.plan()[0]
            else:
                result = self._planner.replan(field)[0]
            if result.status is PlanStatus.SOLVED and result.path is not None:
                try:
                    weight_m2 = motion.rotation_weight_m2
                    trajectory, _ = schedule(result.path, field, motion, motion.body, motion.tracking, weight_m2)
                except PlanningError as error:
                    reason = str(error)
                    continue
                self._number += 1
                return TimedPath(trajectory, self._number, motion.body.rho_max_m), ""
            reason = reason or f"no path: {result.message}"
        return None, reason
