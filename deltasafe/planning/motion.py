"""Planning of a timed, delta-safe motion from an occupancy grid and a task."""

import dataclasses
import math
import pathlib
from typing import Any

import numpy as np

from deltasafe.errors import DataError, PlanningError, SettingsError
from deltasafe.geometry import Pose, PosePath, Trajectory
from deltasafe.io.arrays import read_npz
from deltasafe.io.records import from_json
from deltasafe.io.storage import atomic_folder, read_json, write_json
from deltasafe.planning.body import ToolBody
from deltasafe.planning.collision.distance_field import DistanceField
from deltasafe.planning.results import PlanResult, PlanStatus
from deltasafe.planning.scc_rrt_star import PlannerSettings, plan
from deltasafe.planning.timing.velocity_schedule import SpeedProfile, VelocitySettings, schedule
from deltasafe.planning.tracking_bound import TrackingBound
from deltasafe.scene import ImageStamp, OccupancyGrid

FORMAT = 2


@dataclasses.dataclass(frozen=True)
class MotionSettings(VelocitySettings, PlannerSettings):
    """All settings of a motion: segment test, search, velocity schedule, tracking bound and tool.

    Attributes:
        cost: line cost: ``root``, ``squared`` or ``area``. The paper's experiment penalizes the area between path and
            table, so that the tool passes near the fingers.
        gamma0_m, gamma1_s: constant and slope of the tracking bound gamma(v) = gamma0 + gamma1 v. The default slope is
            the paper's; the default constant was identified for the simulated arm (`make tracking-study`).
        body: the space that the tool occupies.
        motion_alpha: bound on the probability that the image hides a part of the hand from the planner: the motion also
            keeps the margin r(delta, motion_alpha) that the ensemble's calibration states. 0: pointwise delta-safety
            only, as in the paper.
    """

    cost: str = "area"
    gamma0_m: float = 0.00095
    gamma1_s: float = 0.05
    body: ToolBody = dataclasses.field(default_factory=ToolBody)
    motion_alpha: float = 0.0

    def __post_init__(self) -> None:
        if not 0 <= self.motion_alpha < 1:
            raise SettingsError(f"motion_alpha must be in [0, 1), where 0 means no margin, got {self.motion_alpha}")
        PlannerSettings.__post_init__(self)
        VelocitySettings.__post_init__(self)
        _ = self.tracking

    @property
    def tracking(self) -> TrackingBound:
        """Tracking bound of planner, schedule, monitor and verdict."""
        return TrackingBound(self.gamma0_m, self.gamma1_s)


@dataclasses.dataclass(frozen=True)
class PlannedMotion:
    """A planned motion, or the reason why there is none.

    Attributes:
        result: outcome and path of the search.
        trajectory: reference at the controller's rate; None without a verified path that could be timed.
        profile: clearance, limit and speed along the blended path; None without ``trajectory``.
        reason: empty if there is a trajectory, else why there is none.
        settings: of the motion.
        seed: of the search.
        image_stamp: the image that the grid was made from, if any.
        margin_m: horizontal margin around the unsafe set that the motion keeps, beside the tracking error; 0: none.
    """

    result: PlanResult
    trajectory: Trajectory | None
    profile: SpeedProfile | None
    reason: str
    settings: MotionSettings
    seed: int
    image_stamp: ImageStamp | None = None
    margin_m: float = 0.0

    @property
    def body(self) -> ToolBody:
        """Tool of the motion."""
        return self.settings.body

    @property
    def tracking(self) -> TrackingBound:
        """Tracking bound of the motion."""
        return self.settings.tracking

    @property
    def is_safe(self) -> bool:
        """Whether there is a trajectory to execute."""
        return self.trajectory is not None

    def planned_in(self, grid: OccupancyGrid) -> OccupancyGrid:
        """Return the grid with the motion's margin around its unsafe set, which path and speed are planned in."""
        return grid.dilated(self.settings.delta, self.margin_m)

    def save(self, folder: str | pathlib.Path) -> None:
        """Write ``motion.json`` and ``motion.npz`` to a folder, atomically."""
        result = dataclasses.asdict(dataclasses.replace(self.result, path=None))
        record = {
            "format": FORMAT,
            "result": {name: _json(value) for name, value in result.items()},
            "reason": self.reason,
            "settings": dataclasses.asdict(self.settings),
            "seed": self.seed,
            "image_stamp": None if self.image_stamp is None else dataclasses.asdict(self.image_stamp),
            "margin_m": self.margin_m,
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
        """Read a folder that ``save`` wrote.

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
                raise ValueError("the status is solved, but there is no path")
            has_trajectory = "trajectory_poses" in arrays
            if has_trajectory != ("profile_poses" in arrays) or not isinstance(record["reason"], str):
                raise ValueError("trajectory and profile must both be present or absent, and the reason a text")
            if has_trajectory == bool(record["reason"]):
                raise ValueError(f"the reason {record['reason']!r} must be empty if and only if there is a trajectory")
            return cls(
                PlanResult(**result),
                Trajectory(**_group(arrays, "trajectory_")) if has_trajectory else None,
                SpeedProfile(**_group(arrays, "profile_")) if has_trajectory else None,
                record["reason"],
                from_json(MotionSettings, record["settings"]),
                record["seed"],
                ImageStamp(**record["image_stamp"]) if record["image_stamp"] else None,
                float(record.get("margin_m", 0.0)),  # motions of earlier versions have none
            )
        except (AttributeError, KeyError, TypeError, ValueError) as error:
            raise DataError(folder, f"does not hold a planned motion ({error!r}); plan it again") from error


def plan_motion(
    grid: OccupancyGrid,
    start: Pose,
    goal: Pose,
    settings: MotionSettings | None = None,
    seed: int = 0,
    image_stamp: ImageStamp | None = None,
    margin_m: float = 0.0,
) -> PlannedMotion:
    """Plan a path, verify it and schedule its speed. Without a safe path, the motion states the reason.

    Args:
        grid: P(occupied); its lower face is the table.
        start, goal: poses of the tool in the world frame.
        settings: of the motion; by default those of the pipeline.
        seed: of the search; the same seed gives the same motion.
        image_stamp: the image that the grid was made from; stored with the motion.
        margin_m: horizontal margin around the unsafe set, from `deltasafe.trials.motion_margin`; start and goal keep
            it too.

    Raises:
        SettingsError: a setting is outside its domain.
    """
    settings = settings or MotionSettings()
    body, tracking = settings.body, settings.tracking
    field = DistanceField.build(grid.dilated(settings.delta, margin_m), settings.delta)
    result = plan(start, goal, field, settings, seed, body, tracking)
    trajectory, profile, reason = None, None, ""
    if result.status is not PlanStatus.SOLVED or result.path is None:
        reason = f"{result.status}: {result.message}"
        if margin_m:
            reason += f" (around what may be occupied, the motion keeps a margin of {1000 * margin_m:.1f} mm more)"
    else:
        try:
            trajectory, profile = schedule(result.path, field, settings, body, tracking, settings.rotation_weight_m2)
        except PlanningError as error:
            reason = str(error)
    return PlannedMotion(result, trajectory, profile, reason, settings, seed, image_stamp, margin_m)


def _json(value: object) -> object:
    return None if isinstance(value, float) and not math.isfinite(value) else value


def _group(arrays: dict[str, np.ndarray], prefix: str) -> dict[str, np.ndarray]:
    return {name.removeprefix(prefix): value for name, value in arrays.items() if name.startswith(prefix)}
