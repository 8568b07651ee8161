"""From a field and a task to a timed, delta-safe motion, or to the reason why there is none."""

import dataclasses
import math
import pathlib
from typing import Any

import numpy as np

from deltasafe.errors import DataError, PlanningError, SettingsError
from deltasafe.geometry import Pose, PosePath, Trajectory
from deltasafe.io.arrays import read_npz
from deltasafe.io.storage import atomic_folder, read_json, write_json
from deltasafe.planning.body import ToolBody
from deltasafe.planning.collision.distance_field import DistanceField
from deltasafe.planning.results import PlanResult, PlanStatus
from deltasafe.planning.scc_rrt_star import PlannerSettings, plan
from deltasafe.planning.timing.velocity_schedule import SpeedProfile, VelocitySettings, schedule
from deltasafe.planning.tracking_bound import TrackingBound
from deltasafe.scene import ImageStamp, OccupancyGrid

__all__ = ["MotionSettings", "PlannedMotion", "plan_motion"]

FORMAT = 1


@dataclasses.dataclass(frozen=True)
class MotionSettings(VelocitySettings, PlannerSettings):
    """All settings of a motion, flat: of the segment test, of the search, of the schedule, and the tracking bound.

    Attributes:
        gamma0_m, gamma1_s: the tracking bound gamma(v) = gamma0 + gamma1 v; the paper's line by default.
    """

    gamma0_m: float = TrackingBound.gamma0_m
    gamma1_s: float = TrackingBound.gamma1_s

    def __post_init__(self) -> None:
        PlannerSettings.__post_init__(self)
        VelocitySettings.__post_init__(self)
        _ = self.tracking

    @property
    def tracking(self) -> TrackingBound:
        """gamma of schedule, monitor and verdict."""
        return TrackingBound(self.gamma0_m, self.gamma1_s)


@dataclasses.dataclass(frozen=True)
class PlannedMotion:
    """A planned motion, or an outcome without one.

    Attributes:
        result: the search's verdict and path.
        trajectory: reference at the controller's rate; None unless a verified path could be timed.
        profile: clearance, limit and speed along the blended path; None with ``trajectory``.
        reason: empty if there is a trajectory, else why not.
        settings, body, tracking, seed: what it was planned with.
        seen: which image the field was made from, if from one.
    """

    result: PlanResult
    trajectory: Trajectory | None
    profile: SpeedProfile | None
    reason: str
    settings: MotionSettings
    body: ToolBody
    tracking: TrackingBound
    seed: int
    seen: ImageStamp | None = None

    @property
    def is_safe(self) -> bool:
        """Whether there is a motion to execute."""
        return self.trajectory is not None

    def save(self, folder: str | pathlib.Path) -> None:
        """Write ``motion.json`` and ``motion.npz`` into a folder that appears as a whole."""
        result = dataclasses.asdict(dataclasses.replace(self.result, path=None))
        record = {
            "format": FORMAT,
            "result": {name: _json(value) for name, value in result.items()},
            "reason": self.reason,
            "settings": dataclasses.asdict(self.settings),
            "body": dataclasses.asdict(self.body),
            "tracking": dataclasses.asdict(self.tracking),
            "seed": self.seed,
            "seen": None if self.seen is None else dataclasses.asdict(self.seen),
        }
        arrays: dict[str, Any] = {}
        if self.result.path is not None:
            arrays["path"] = self.result.path.poses
        for prefix, group in (("trajectory", self.trajectory), ("profile", self.profile)):
            if group is not None:
                for field in dataclasses.fields(group):
                    arrays[f"{prefix}_{field.name}"] = getattr(group, field.name)
        with atomic_folder(folder) as temporary:
            write_json(temporary / "motion.json", record)
            np.savez_compressed(temporary / "motion.npz", **arrays)

    @classmethod
    def load(cls, folder: str | pathlib.Path) -> "PlannedMotion":
        """Read what ``save`` wrote.

        Raises:
            DataError: a file is missing, altered or of another format.
        """
        folder = pathlib.Path(folder)
        record = read_json(folder / "motion.json")
        if not isinstance(record, dict) or record.get("format") != FORMAT:
            raise DataError(folder / "motion.json", f"is not a planned motion of format {FORMAT}; plan it again")
        arrays = read_npz(folder / "motion.npz")
        try:
            result = dict(record["result"])
            result["status"] = PlanStatus(result["status"])
            result["clearance_m"] = math.nan if result["clearance_m"] is None else result["clearance_m"]
            result["path"] = PosePath(arrays["path"]) if "path" in arrays else None
            if ("path" in arrays) < (result["status"] is PlanStatus.SOLVED):
                raise ValueError("it is solved and has no path")
            if ("trajectory_poses" in arrays) != ("profile_poses" in arrays) or not isinstance(record["reason"], str):
                raise ValueError("a trajectory has a profile, and what has none a reason")
            if ("trajectory_poses" in arrays) == bool(record["reason"]):
                raise ValueError(f"its reason is {record['reason']!r}, which does not fit its trajectory")
            return cls(
                PlanResult(**result),
                Trajectory(**_group(arrays, "trajectory_")) if "trajectory_poses" in arrays else None,
                SpeedProfile(**_group(arrays, "profile_")) if "profile_poses" in arrays else None,
                record["reason"],
                MotionSettings(**record["settings"]),
                ToolBody(**record["body"]),
                TrackingBound(**record["tracking"]),
                record["seed"],
                ImageStamp(**record["seen"]) if record.get("seen") else None,
            )
        except (AttributeError, KeyError, TypeError, ValueError) as error:
            raise DataError(folder, f"does not hold a planned motion ({error!r}); plan it again") from error


def plan_motion(
    grid: OccupancyGrid,
    start: Pose,
    goal: Pose,
    table_z_m: float,
    settings: MotionSettings,
    seed: int,
    body: ToolBody | None = None,
    tracking: TrackingBound | None = None,
    seen: ImageStamp | None = None,
) -> PlannedMotion:
    """Path, verification and schedule in one. A scene without a safe path is an outcome with its reason.

    Args:
        tracking: gamma; that of the settings if None.
        seen: which image the grid was made from; travels with the motion.

    Raises:
        SettingsError: the table is not the lower face of the grid, or a setting is outside its domain.
    """
    if not abs(table_z_m - grid.origin_m[2]) <= 1e-9:
        raise SettingsError(f"the grid must stand on the table: {grid.origin_m[2]} m against {table_z_m} m")
    body, tracking = body or ToolBody(), tracking or settings.tracking
    field = DistanceField.build(grid, settings.delta)
    result = plan(start, goal, field, settings, seed, body, tracking)
    trajectory, profile, reason = None, None, ""
    if result.status is not PlanStatus.SOLVED or result.path is None:
        reason = f"{result.status}: {result.message}"
    else:
        try:
            trajectory, profile = schedule(result.path, field, settings, body, tracking, settings.rotation_weight_m2)
        except PlanningError as error:
            reason = str(error)
    return PlannedMotion(result, trajectory, profile, reason, settings, body, tracking, seed, seen)


def _json(value: object) -> object:
    return None if isinstance(value, float) and not math.isfinite(value) else value


def _group(arrays: dict[str, np.ndarray], prefix: str) -> dict[str, np.ndarray]:
    return {name.removeprefix(prefix): value for name, value in arrays.items() if name.startswith(prefix)}
