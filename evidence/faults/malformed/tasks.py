"""Tasks that no motion fulfils, and settings that none may have: starts in the hand, goals beneath the table."""

import functools
import math
import pathlib
from collections.abc import Callable
from typing import Any

from deltasafe.geometry import Pose
from deltasafe.planning import MotionSettings, plan_motion
from deltasafe.scene import OccupancyGrid, Sphere, grid_from_shapes
from evidence.faults.judging import Case, Door

__all__ = ["task_cases"]

FREE, OTHER = Pose(-0.14, 0.0, 0.03), Pose(0.14, 0.0, 0.03, 0.5)
BALL = (0.0, 0.0, 0.03)


def task_cases(home: pathlib.Path) -> list[Case]:
    """Planning beside one ball; a refusal is an outcome with its reason, or a `SettingsError`."""
    field = grid_from_shapes([Sphere(BALL, 0.03)], 0.01, (-0.2, -0.15, 0.0), (0.2, 0.15, 0.07), 0.005)
    sound = home / "task"
    sound.write_text("the task is in memory")
    impossible = {
        "in the hand": Pose(*BALL),
        "touching the hand": Pose(0.055, 0.0, 0.03),
        "shaft through the hand": Pose(0.0, 0.0, 0.008),
        "beneath the table": Pose(0.1, 0.0, -0.02),
        "in the table": Pose(0.1, 0.0, 0.002),
        "beside what was seen": Pose(0.5, 0.0, 0.03),
        "at the border of what was seen": Pose(0.199, 0.0, 0.03),
        "a kilometre away": Pose(1000.0, 0.0, 0.03),
        "in millimetres": Pose(-140.0, 0.0, 30.0),
    }
    cases = []
    for name, pose in impossible.items():
        cases.append(_case(f"start {name}", sound, functools.partial(_plan, field, pose, OTHER)))
        cases.append(_case(f"goal {name}", sound, functools.partial(_plan, field, FREE, pose)))
    for value in (math.nan, math.inf, -math.inf):
        cases.append(_case(f"a pose with {value}", sound, functools.partial(Pose, 0.0, value, 0.03)))
    for far in ((1e300, 0.0, 0.03), (0.0, -1e9, 0.03), (0.0, 0.0, 1e5), (0.0, 0.0, 0.03, 1e9)):
        cases.append(_case(f"a pose at {far}", sound, functools.partial(Pose, *far)))
    settings: list[tuple[str, Any]] = [
        *(("delta", value) for value in (0.0, 1.0, -0.1, math.nan, 5.0)),
        *(("v_min_mps", value) for value in (0.0, -1.0, math.nan, 10.0)),
        *(("gamma0_m", value) for value in (-0.001, math.nan, math.inf)),
        *(("n_iterations", value) for value in (0, -5)),
        ("method", "hope"),
        ("n_samples", 0),
        ("resolution_m", 0.0),
        ("acceleration_mps2", 0.0),
        ("rate_hz", 0.0),
    ]
    for key, value in settings:
        cases.append(_case(f"{key} is {value!r}", sound, functools.partial(MotionSettings, **{key: value})))
    cases.append(_case("a table that is not the field's", sound, lambda: _plan(field, FREE, OTHER, table_z_m=0.02)))
    return cases


def _plan(field: OccupancyGrid, start: Pose, goal: Pose, table_z_m: float = 0.0) -> str | None:
    motion = plan_motion(field, start, goal, table_z_m, MotionSettings(n_iterations=10), 0)
    if motion.trajectory is not None or motion.result.path is not None:
        return None
    return f"{motion.reason}; give another pose" if motion.reason else None


def _case(name: str, sound: pathlib.Path, attempt: Callable[[], Any]) -> Case:
    def read(given: pathlib.Path, out: pathlib.Path) -> str | None:
        found = attempt()
        return found if isinstance(found, str) else None

    return Case(name, Door("task", sound, read), lambda given, random: None)
