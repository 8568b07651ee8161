"""Tasks that no motion can fulfill, and invalid settings: starts in the hand, goals below the table."""

import functools
import math
import pathlib
from collections.abc import Callable
from typing import Any

from deltasafe.geometry import Pose
from deltasafe.planning import MotionSettings, plan_motion
from deltasafe.scene import OccupancyGrid, Sphere, grid_from_shapes
from evidence.faults.rejection import Case, InputKind

START, GOAL = Pose(-0.14, 0.0, 0.03), Pose(0.14, 0.0, 0.03, 0.5)
BALL_M = (0.0, 0.0, 0.03)
POSES = {
    "in the hand": Pose(*BALL_M),
    "touching the hand": Pose(0.055, 0.0, 0.03),
    "with its shaft in the hand": Pose(0.0, 0.0, 0.008),
    "below the table": Pose(0.1, 0.0, -0.02),
    "in the table": Pose(0.1, 0.0, 0.002),
    "outside the grid": Pose(0.5, 0.0, 0.03),
    "at the border of the grid": Pose(0.199, 0.0, 0.03),
    "a kilometer away": Pose(1000.0, 0.0, 0.03),
    "in millimeters": Pose(-140.0, 0.0, 30.0),
}
SETTINGS: tuple[tuple[str, tuple[Any, ...]], ...] = (
    ("delta", (0.0, 1.0, -0.1, math.nan, 5.0)),
    ("v_min_mps", (0.0, -1.0, math.nan, 10.0)),
    ("gamma0_m", (-0.001, math.nan, math.inf)),
    ("n_iterations", (0, -5)),
    ("method", ("hope",)),
    ("n_samples", (0,)),
    ("resolution_m", (0.0,)),
    ("acceleration_mps2", (0.0,)),
    ("rate_hz", (0.0,)),
)


def ball_grid() -> OccupancyGrid:
    """Create a grid with one ball of 3 cm radius."""
    return grid_from_shapes([Sphere(BALL_M, 0.03)], 0.01, (-0.2, -0.15, 0.0), (0.2, 0.15, 0.07), 0.005)


def task_cases(home: pathlib.Path) -> list[Case]:
    """Plan beside one ball; a refusal is a result with a reason, or a `SettingsError`."""
    grid, valid = ball_grid(), home / "task"
    valid.write_text("tasks are not stored in files")
    attempts: dict[str, Callable[[], object]] = {}
    for name, pose in POSES.items():
        attempts[f"start {name}"] = functools.partial(_plan, grid, pose, GOAL)
        attempts[f"goal {name}"] = functools.partial(_plan, grid, START, pose)
    for value in (math.nan, math.inf, -math.inf):
        attempts[f"a pose with {value}"] = functools.partial(Pose, 0.0, value, 0.03)
    for far in ((1e300, 0.0, 0.03), (0.0, -1e9, 0.03), (0.0, 0.0, 1e5), (0.0, 0.0, 0.03, 1e9)):
        attempts[f"a pose at {far}"] = functools.partial(Pose, *far)
    for key, values in SETTINGS:
        for value in values:
            attempts[f"{key} is {value!r}"] = functools.partial(MotionSettings, **{key: value})
    return [_case(name, valid, attempt) for name, attempt in attempts.items()]


def _case(name: str, valid: pathlib.Path, attempt: Callable[[], object]) -> Case:
    return Case(name, InputKind("task", valid, lambda given, out: attempt()), lambda given, random: None)


def _plan(grid: OccupancyGrid, start: Pose, goal: Pose) -> str | None:
    motion = plan_motion(grid, start, goal, MotionSettings(n_iterations=10), 0)
    if motion.trajectory is not None or motion.result.path is not None:
        return None
    return f"{motion.reason}; give another pose" if motion.reason else None
