import json
import pathlib

import numpy as np
import pytest

from deltasafe.compute import numba_cache as compiling
from deltasafe.errors import DataError, PlanningError, SettingsError
from deltasafe.geometry import Pose
from deltasafe.planning import (
    DistanceField,
    MotionSettings,
    PlannedMotion,
    Planner,
    PlannerSettings,
    PlanStatus,
    TrackingBound,
    plan,
    plan_motion,
    schedule,
)
from deltasafe.scene import Cuboid, OccupancyGrid, grid_from_shapes

START, GOAL = Pose(-0.14, 0.0, 0.03), Pose(0.14, 0.0, 0.03, 0.5)


@pytest.fixture(scope="module")
def grid() -> OccupancyGrid:
    return grid_from_shapes(
        [Cuboid((0, 0, 0.03), (0.02, 0.05, 0.03))], 0.01, (-0.2, -0.15, 0), (0.2, 0.15, 0.09), 0.005
    )


@pytest.fixture(scope="module")
def motion(grid: OccupancyGrid) -> PlannedMotion:
    return plan_motion(grid, START, GOAL, 0.0, MotionSettings(n_iterations=500), 3)


def test_a_motion_is_complete_and_survives_storage(motion: PlannedMotion, tmp_path: pathlib.Path) -> None:
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


def test_no_path_is_an_outcome_and_survives_storage(grid: OccupancyGrid, tmp_path: pathlib.Path) -> None:
    motion = plan_motion(grid, Pose(0, 0, 0.03), GOAL, 0.0, MotionSettings(), 0)
    assert not motion.is_safe
    assert motion.trajectory is None
    assert motion.reason.startswith("start unsafe")
    motion.save(tmp_path / "motion")
    again = PlannedMotion.load(tmp_path / "motion")
    assert again.reason == motion.reason
    assert again.result.status is PlanStatus.START_UNSAFE
    assert again.result.path is None


def test_broken_storage_is_named(motion: PlannedMotion, tmp_path: pathlib.Path) -> None:
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


def test_the_grid_must_stand_on_the_table(grid: OccupancyGrid) -> None:
    with pytest.raises(SettingsError, match="stand on the table"):
        plan_motion(grid, START, GOAL, 0.01, MotionSettings(), 0)


@pytest.mark.parametrize("table_z_m", [float("nan"), float("inf"), 1e300])
def test_a_table_that_is_not_finite_is_refused(grid: OccupancyGrid, table_z_m: float) -> None:
    with pytest.raises(SettingsError, match="stand on the table"):
        plan_motion(grid, START, GOAL, table_z_m, MotionSettings(), 0)


def test_search_and_schedule_keep_the_tracking_bound_of_their_settings(grid: OccupancyGrid) -> None:
    """gamma(v_min) is 10 mm + 0.05 s * 0.01 m/s; the reserve is 1 mm."""
    settings, field = MotionSettings(gamma0_m=0.01, n_iterations=500), DistanceField.build(grid, 0.05)
    result = plan(START, GOAL, field, settings, 3)
    assert result.margin_m == pytest.approx(0.0115)
    assert Planner(START, [GOAL], field, settings, 3).plan()[0].margin_m == pytest.approx(0.0115)
    assert result.path is not None
    profile = schedule(result.path, field, settings)[1]
    assert profile.clearance_m.min() >= 0.0105 - 1e-12
    close = plan(START, GOAL, field, MotionSettings(n_iterations=500), 3)
    assert close.margin_m == pytest.approx(0.0015)
    assert close.path is not None
    with pytest.raises(PlanningError, match=r"gamma\(v_min\) is 10.50 mm"):
        schedule(close.path, field, settings)


def test_a_given_tracking_bound_goes_before_that_of_the_settings(grid: OccupancyGrid) -> None:
    settings, field = MotionSettings(gamma0_m=0.01, n_iterations=500), DistanceField.build(grid, 0.05)
    assert plan(START, GOAL, field, settings, 3, tracking=TrackingBound()).margin_m == pytest.approx(0.0015)
    motion = plan_motion(grid, START, GOAL, 0.0, settings, 3, tracking=TrackingBound())
    assert motion.result.margin_m == pytest.approx(0.0015)
    assert motion.tracking == TrackingBound()
    plain = PlannerSettings(n_iterations=500)
    assert plan(START, GOAL, field, plain, 3).margin_m == pytest.approx(0.0015)


def test_the_schedule_takes_the_rotation_weight_of_its_settings(grid: OccupancyGrid, motion: PlannedMotion) -> None:
    assert motion.result.path is not None
    field, settings = DistanceField.build(grid, 0.05), MotionSettings(rotation_weight_m2=0.04)
    of_settings = schedule(motion.result.path, field, settings)[0]
    given = schedule(motion.result.path, field, settings, rotation_weight_m2=0.04)[0]
    other = schedule(motion.result.path, field, settings, rotation_weight_m2=0.01)[0]
    assert np.array_equal(of_settings.poses, given.poses)
    assert not np.array_equal(of_settings.poses, other.poses)


def test_settings_are_flat_and_plain() -> None:
    import dataclasses

    values = dataclasses.asdict(MotionSettings())
    assert all(isinstance(value, int | float | str | bool) for value in values.values())
    assert values["n_iterations"] == 2000
    assert values["v_max_mps"] == 0.2
    assert MotionSettings(**json.loads(json.dumps(values))) == MotionSettings()


def test_the_compiled_cache_notices_a_change_of_any_source(monkeypatch: pytest.MonkeyPatch) -> None:
    """numba looks at one file only; a stale collision test would be run unnoticed."""

    def stamp() -> str:
        return compiling.compiled(_double)._cache._cache_file._source_stamp

    before = stamp()
    read = pathlib.Path.read_bytes
    monkeypatch.setattr(
        pathlib.Path, "read_bytes", lambda path: read(path) + (b"#" if path.name == "checks.py" else b"")
    )
    compiling._digest_of_sources.cache_clear()
    after = stamp()
    compiling._digest_of_sources.cache_clear()
    assert before != after


def test_a_cache_written_with_foreign_types_is_not_fatal(monkeypatch: pytest.MonkeyPatch) -> None:
    """A constraint type of a script must not break the planner of everybody else."""

    def fail(self: object) -> None:
        raise ModuleNotFoundError("No module named 'somebodys_script'")

    monkeypatch.setattr(compiling.caching.IndexDataCacheFile, "_load_index", fail)
    assert compiling.compiled(_double)(2.5) == 5.0


def _double(value):  # type: ignore[no-untyped-def]
    return 2 * value
