"""Planned motions: storage, settings, and the tracking bound that search and schedule use."""

import dataclasses
import json
import pathlib

import numpy as np
import pytest

from deltasafe.errors import DataError, PlanningError
from deltasafe.geometry import Pose
from deltasafe.io.records import from_json
from deltasafe.planning import (
    DistanceField,
    MotionSettings,
    PlannedMotion,
    Planner,
    PlannerSettings,
    PlanStatus,
    ToolBody,
    ToolPart,
    TrackingBound,
    plan,
    plan_motion,
    schedule,
    verify_motion,
)
from deltasafe.presets import PRESETS
from deltasafe.scene import Cuboid, OccupancyGrid, grid_from_shapes

START, GOAL = Pose(-0.14, 0.0, 0.03), Pose(0.14, 0.0, 0.03, 0.5)


@pytest.fixture(scope="module")
def grid() -> OccupancyGrid:
    return grid_from_shapes(
        [Cuboid((0, 0, 0.03), (0.02, 0.05, 0.03))], 0.01, (-0.2, -0.15, 0), (0.2, 0.15, 0.09), 0.005
    )


@pytest.fixture(scope="module")
def motion(grid: OccupancyGrid) -> PlannedMotion:
    return plan_motion(grid, START, GOAL, MotionSettings(n_iterations=500), 3)


def test_stored_motion_equals_the_original(motion: PlannedMotion, tmp_path: pathlib.Path) -> None:
    assert motion.is_safe
    assert motion.reason == ""
    motion.save(tmp_path / "motion")
    again = PlannedMotion.load(tmp_path / "motion")
    assert again.result.path is not None
    assert motion.result.path is not None
    assert (again.result.path.poses == motion.result.path.poses).all()
    for name in ("time_s", "poses", "velocities"):
        assert (getattr(again.trajectory, name) == getattr(motion.trajectory, name)).all()
    for name in ("clearance_m", "limit_mps", "speed_mps", "arc_length_m", "poses"):
        assert (getattr(again.profile, name) == getattr(motion.profile, name)).all()
    for name in ("settings", "body", "tracking", "seed", "reason"):
        assert getattr(again, name) == getattr(motion, name)
    assert again.result.status is PlanStatus.SOLVED
    assert again.result.clearance_m == motion.result.clearance_m


def test_motion_without_path_states_the_reason_and_can_be_stored(grid: OccupancyGrid, tmp_path: pathlib.Path) -> None:
    motion = plan_motion(grid, Pose(0, 0, 0.03), GOAL, MotionSettings(), 0)
    assert not motion.is_safe
    assert motion.trajectory is None
    assert motion.reason.startswith("start unsafe")
    motion.save(tmp_path / "motion")
    again = PlannedMotion.load(tmp_path / "motion")
    assert again.reason == motion.reason
    assert again.result.status is PlanStatus.START_UNSAFE
    assert again.result.path is None


def test_invalid_files_are_named(motion: PlannedMotion, tmp_path: pathlib.Path) -> None:
    folder = tmp_path / "motion"
    with pytest.raises(DataError, match=r"motion\.json"):
        PlannedMotion.load(folder)
    motion.save(folder)
    record = json.loads((folder / "motion.json").read_text())
    (folder / "motion.json").write_text(json.dumps(record | {"settings": {"hope": 1}}))
    with pytest.raises(DataError, match="hope"):
        PlannedMotion.load(folder)
    (folder / "motion.json").write_text(json.dumps(record | {"format": 99}))
    with pytest.raises(DataError, match="format"):
        PlannedMotion.load(folder)
    (folder / "motion.json").write_text(json.dumps(record))
    (folder / "motion.npz").write_bytes(b"")
    with pytest.raises(DataError, match=r"motion\.npz"):
        PlannedMotion.load(folder)


def test_settings_with_a_tool_survive_json() -> None:
    settings = MotionSettings(gamma0_m=0.002, body=ToolBody(0.02, 0.01))
    assert from_json(MotionSettings, json.loads(json.dumps(dataclasses.asdict(settings)))) == settings
    assert (settings.tracking.gamma0_m, settings.body.semi_axis_x_m) == (0.002, 0.02)


GRIPPER = ToolBody(
    parts=(
        ToolPart("box", z_m=0.06, half_x_m=0.035, half_y_m=0.015, half_z_m=0.02),
        ToolPart("box", x_m=-0.03, z_m=0.02, half_x_m=0.004, half_y_m=0.008, half_z_m=0.02),
        ToolPart("capsule", x_m=0.03, z_m=0.02, half_z_m=0.016, radius_m=0.004),
    )
)


def test_gripper_is_planned_audited_stored_and_configured(grid: OccupancyGrid, tmp_path: pathlib.Path) -> None:
    settings = MotionSettings(n_iterations=500, body=GRIPPER)
    motion = plan_motion(grid, START, GOAL, settings, 3)
    assert motion.is_safe, motion.reason
    assert verify_motion(motion, grid).is_safe
    motion.save(tmp_path / "motion")
    assert PlannedMotion.load(tmp_path / "motion").settings == settings
    obstacle = ToolBody(parts=(ToolPart("sphere", z_m=-0.01, radius_m=0.002), *GRIPPER.parts))
    assert plan_motion(grid, START, GOAL, dataclasses.replace(settings, body=obstacle), 3).is_safe
    low = plan_motion(grid, Pose(-0.14, 0, 0.011), GOAL, dataclasses.replace(settings, body=obstacle), 3)
    assert low.result.status is PlanStatus.START_UNSAFE  # the sphere would touch the table


def test_default_settings_equal_the_default_preset() -> None:
    assert MotionSettings() == PRESETS["default"].motion == PRESETS["paper"].motion


def test_search_and_schedule_use_the_tracking_bound_of_the_settings(grid: OccupancyGrid) -> None:
    """gamma(v_min) is 10 mm + 0.05 s * 0.01 m/s; the reserve is 1 mm."""
    settings, field = MotionSettings(gamma0_m=0.01, n_iterations=500), DistanceField.build(grid, 0.05)
    result = plan(START, GOAL, field, settings, 3)
    assert result.margin_m == pytest.approx(0.0115)
    assert Planner(START, [GOAL], field, settings, 3).plan()[0].margin_m == pytest.approx(0.0115)
    assert result.path is not None
    profile = schedule(result.path, field, settings)[1]
    assert profile.clearance_m.min() >= 0.0105 - 1e-12
    close = plan(START, GOAL, field, MotionSettings(n_iterations=500), 3)
    assert close.margin_m == pytest.approx(0.00245)
    assert close.path is not None
    with pytest.raises(PlanningError, match=r"gamma\(v_min\) is 10.50 mm"):
        schedule(close.path, field, settings)


def test_tracking_argument_overrides_the_settings(grid: OccupancyGrid) -> None:
    settings, field = MotionSettings(gamma0_m=0.01, n_iterations=500), DistanceField.build(grid, 0.05)
    assert plan(START, GOAL, field, settings, 3, tracking=TrackingBound()).margin_m == pytest.approx(0.0015)
    motion = plan_motion(grid, START, GOAL, settings, 3)
    assert motion.result.margin_m == pytest.approx(0.0115)
    assert motion.tracking == settings.tracking
    plain = PlannerSettings(n_iterations=500)
    assert plan(START, GOAL, field, plain, 3).margin_m == pytest.approx(0.0015)


def test_schedule_uses_the_rotation_weight_of_the_settings(grid: OccupancyGrid, motion: PlannedMotion) -> None:
    assert motion.result.path is not None
    field, settings = DistanceField.build(grid, 0.05), MotionSettings(rotation_weight_m2=0.04)
    of_settings = schedule(motion.result.path, field, settings)[0]
    given = schedule(motion.result.path, field, settings, rotation_weight_m2=0.04)[0]
    other = schedule(motion.result.path, field, settings, rotation_weight_m2=0.01)[0]
    assert np.array_equal(of_settings.poses, given.poses)
    assert not np.array_equal(of_settings.poses, other.poses)
