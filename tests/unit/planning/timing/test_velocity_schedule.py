"""Velocity scheduling and corner blending: limits of the motion, clearance at speed, and refusals."""

import dataclasses
from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from deltasafe.errors import PlanningError, SettingsError
from deltasafe.geometry import Pose, PosePath, Trajectory
from deltasafe.planning import (
    DistanceField,
    PlannerSettings,
    SpeedProfile,
    ToolBody,
    TrackingBound,
    VelocitySettings,
    plan,
    schedule,
    schedule_at_top_speed,
)
from deltasafe.planning.timing.corner_blending import blend_corners
from deltasafe.scene import OccupancyGrid

FREE = DistanceField.build(
    OccupancyGrid(np.zeros((120, 120, 10), np.float32), np.array([-0.3, -0.3, 0.0]), 0.005), 0.05
)
LIMITS = VelocitySettings()
BODY = ToolBody()


def fastest_acceleration(trajectory: Trajectory, rho_max_m: float = BODY.rho_max_m) -> np.ndarray:
    """Largest acceleration of 64 points on a circle around the yaw axis, by finite differences of their velocities."""
    around = np.linspace(0, 2 * np.pi, 64, endpoint=False)
    angle = trajectory.poses[:, 3:] + around
    across = np.stack([-np.sin(angle), np.cos(angle), 0 * angle], axis=-1)
    velocity = trajectory.velocities[:, None, :3] + rho_max_m * trajectory.velocities[:, 3, None, None] * across
    gains = np.diff(velocity, axis=0) / np.diff(trajectory.time_s)[:, None, None]
    return np.asarray(np.linalg.norm(gains, axis=2))


def check_limits(trajectory: Trajectory, limits: VelocitySettings) -> None:
    """Assert rest at both ends, and limits of speed, yaw rate and acceleration, computed by finite differences."""
    assert (trajectory.velocities[[0, -1]] == 0).all()
    rates = np.diff(trajectory.poses, axis=0) / np.diff(trajectory.time_s)[:, None]
    speeds = np.linalg.norm(rates[:, :3], axis=1) + BODY.rho_max_m * np.abs(rates[:, 3])
    assert speeds.max() <= limits.v_max_mps * (1 + 1e-6)
    assert np.abs(rates[:, 3]).max() <= limits.yaw_rate_radps * (1 + 1e-6)
    assert fastest_acceleration(trajectory).max() <= limits.acceleration_mps2 * 1.002
    middle = (trajectory.velocities[1:] + trajectory.velocities[:-1]) / 2
    assert (np.abs(rates - middle) <= (2e-4, 2e-4, 2e-4, 2e-3)).all()


def test_straight_path_has_the_duration_of_a_trapezoidal_profile() -> None:
    path = PosePath(np.array([[-0.2, 0, 0.1, 0], [0.2, 0, 0.1, 0]]))
    trajectory, profile = schedule(path, FREE, LIMITS)
    check_limits(trajectory, LIMITS)
    # v / a to accelerate, as long to decelerate, the rest at full speed
    assert trajectory.duration_s == pytest.approx(0.4 / 0.2 + 0.2 / 0.5, rel=0.002)
    assert profile.speed_mps.max() == pytest.approx(0.2)
    assert profile.arc_length_m[-1] == pytest.approx(0.4)


def test_turn_on_the_spot_reaches_the_yaw_rate_limit() -> None:
    path = PosePath(np.array([[0, 0, 0.1, 0], [0, 0, 0.1, 1.5]]))
    trajectory, _ = schedule(path, FREE, dataclasses.replace(LIMITS, yaw_rate_radps=0.8))
    assert np.abs(trajectory.velocities[:, 3]).max() == pytest.approx(0.8, rel=1e-3)
    check_limits(trajectory, dataclasses.replace(LIMITS, yaw_rate_radps=0.8))


@settings(max_examples=25, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(st.integers(0, 10**6), st.integers(3, 7))
def test_random_polylines_are_followed_within_limits(seed: int, count: int) -> None:
    rng = np.random.default_rng(seed)
    poses = rng.uniform((-0.2, -0.2, 0.12, -1), (0.2, 0.2, 0.2, 1), (count, 4))
    trajectory, profile = schedule(PosePath(poses), FREE, LIMITS)
    check_limits(trajectory, LIMITS)
    np.testing.assert_allclose(trajectory.poses[[0, -1]], poses[[0, -1]], atol=1e-12)
    assert (profile.speed_mps <= profile.limit_mps + 1e-9).all()


@pytest.mark.parametrize("seed", range(3))
def test_tracking_error_fits_the_clearance(
    seed: int, make_grid: Callable[..., OccupancyGrid], audit: Callable[..., float]
) -> None:
    """Audited along a trajectory sampled ten times finer, with the body enlarged by gamma(v) at the current speed."""
    field = DistanceField.build(make_grid(seed, count=5), 0.05)
    result = plan(Pose(-0.14, 0, 0.03), Pose(0.14, 0, 0.03), field, PlannerSettings(n_iterations=600), seed)
    assert result.path is not None
    fine = dataclasses.replace(LIMITS, rate_hz=10000.0)
    tracking = TrackingBound()
    trajectory, profile = schedule(result.path, field, fine)
    check_limits(trajectory, LIMITS)
    assert (tracking.error_m(profile.speed_mps) <= profile.clearance_m + 1e-12).all()
    places = np.linalg.norm(np.diff(trajectory.poses[:, :3], axis=0), axis=1).cumsum()
    limit = np.interp(places, profile.arc_length_m, profile.limit_mps)
    speeds = np.linalg.norm(trajectory.velocities[1:, :3], axis=1)
    assert (speeds <= limit + 0.02).all()
    for index in range(1, len(trajectory.time_s) - 1, 400):
        rate = trajectory.velocities[index]
        speed = np.linalg.norm(rate[:3]) + BODY.rho_max_m * abs(rate[3])
        pose = trajectory.poses[[index, index]]
        assert audit(field.grid, 0.05, BODY, float(tracking.error_m(speed)), pose) == 0


def test_path_too_close_to_obstacles_is_refused_and_located() -> None:
    p_occupied = np.zeros((80, 60, 10), np.float32)
    p_occupied[40:42, :30] = 1.0
    field = DistanceField.build(OccupancyGrid(p_occupied, np.zeros(3), 0.005), 0.05)
    path = PosePath(np.array([[0.05, 0.17, 0.03, 0], [0.35, 0.17, 0.03, 0]]))
    assert schedule(path, field, LIMITS)[0].duration_s > 0
    with pytest.raises(PlanningError, match=r"at 0\.1\d+ m along it.*clearance is") as caught:
        schedule(path, field, LIMITS, tracking=TrackingBound(gamma0_m=0.006))
    assert "gamma(v_min) is 6.50 mm" in str(caught.value)


def test_path_of_one_pose_gives_a_trajectory_at_rest() -> None:
    trajectory, profile = schedule(PosePath(np.array([[0, 0, 0.1, 0.5]])), FREE, LIMITS)
    assert trajectory.duration_s == 0
    assert isinstance(profile, SpeedProfile)
    with pytest.raises(PlanningError, match="clearance"):
        schedule(PosePath(np.array([[0, 0, 0.001, 0.5]])), FREE, LIMITS)


def test_refused_blend_is_halved_and_finally_becomes_a_stop() -> None:
    corner = np.array([[0, 0, 0.1, 0], [0.1, 0, 0.1, 0], [0.1, 0.1, 0.1, 0]])
    near = blend_corners(corner, 0.01, 0.02, 0.0005, lambda arc: True, 5e-5)
    tight = blend_corners(corner, 0.01, 0.02, 0.0005, lambda arc: bool(arc[0, 0] > 0.097), 5e-5)
    never = blend_corners(corner, 0.01, 0.02, 0.0005, lambda arc: False, 5e-5)
    gaps = [np.linalg.norm(curve.poses - corner[1], axis=1).min() for curve in (near, tight, never)]
    assert gaps[0] == pytest.approx(0.02 / np.sqrt(2) / 2, rel=1e-3)
    assert 0 == gaps[2] < gaps[1] < 0.0015
    assert [len(curve.stops) for curve in (near, tight, never)] == [2, 2, 3]
    for curve in (near, tight):
        places = np.linspace(0, curve.arc_length[-1], 5001)
        _, slopes = curve.at(places)
        np.testing.assert_allclose(np.linalg.norm(slopes[:, :3], axis=1), 1, atol=2e-3)
        turns = np.linalg.norm(np.diff(slopes, axis=0), axis=1) / np.diff(places)
        assert turns.max() <= curve.curvature.max() * 1.02


@pytest.mark.parametrize("weight_m2", [0.0, -1.0, float("nan"), float("inf")])
def test_rotation_weight_out_of_domain_is_refused(weight_m2: float) -> None:
    path = PosePath(np.array([[-0.2, 0, 0.1, 0], [0.2, 0, 0.1, 0]]))
    with pytest.raises(SettingsError, match="rotation_weight_m2"):
        schedule(path, FREE, LIMITS, rotation_weight_m2=weight_m2)
    with pytest.raises(SettingsError, match="rotation_weight_m2"):
        schedule_at_top_speed(path, lambda arc: True, LIMITS, rotation_weight_m2=weight_m2)


def test_motion_longer_than_a_day_is_refused() -> None:
    path = PosePath(np.array([[-0.2, 0, 0.1, 0], [0.2, 0, 0.1, 0]]))
    with pytest.raises(PlanningError, match="raise v_min_mps"):
        schedule(path, FREE, dataclasses.replace(LIMITS, v_min_mps=1e-9, v_max_mps=1e-9))


@pytest.mark.parametrize("weight_m2", [1e-3, 0.01, 0.25])
@pytest.mark.parametrize("semi_axis_m", [0.005, 0.03, 0.3])
def test_acceleration_of_the_fastest_point_is_limited(weight_m2: float, semi_axis_m: float) -> None:
    body = ToolBody(semi_axis_m, 0.005, shaft_radius_m=0.004)
    poses = np.array([[-0.1, 0, 0.4, 0], [0.05, 0.02, 0.4, 0.6], [0.06, 0.1, 0.45, -0.4], [0.06, 0.1, 0.45, 0.9]])
    field = DistanceField.build(OccupancyGrid(np.zeros((400, 400, 2), np.float32), np.array([-1, -1, 0]), 0.005), 0.05)
    trajectory, _ = schedule(PosePath(poses), field, LIMITS, body, rotation_weight_m2=weight_m2)
    reached = fastest_acceleration(trajectory, body.rho_max_m).max()
    assert 0.45 * LIMITS.acceleration_mps2 <= reached <= LIMITS.acceleration_mps2 * 1.002


def test_motion_without_path_length_is_a_standstill() -> None:
    """Poses closer than 1e-9 m, any number of them."""
    pose = np.array([0.1, 0.0, 0.1, 0.3])
    for path in ([pose, pose], [pose] * 5, [pose, pose + 1e-11], [pose, pose + 1e-10 * np.eye(4)[3], pose]):
        trajectory, profile = schedule(PosePath(np.array(path)), FREE, LIMITS)
        assert (trajectory.duration_s, len(profile.poses)) == (0, 1)
        with pytest.raises(SettingsError, match="without motion"):
            schedule_at_top_speed(PosePath(np.array(path)), lambda arc: True, LIMITS)


@pytest.mark.parametrize("spacing_m", [1e-6, 1e-4, 3e-4, 0.002])
def test_dense_way_points_do_not_slow_the_motion_down(spacing_m: float) -> None:
    """A line of 0.1 m, and a quarter circle of 0.1 m radius, with any spacing of the way-points."""
    count = max(2, min(round(0.1 / spacing_m), 4000))
    line = np.linspace([-0.05, 0, 0.1, 0], [0.05, 0, 0.1, 0.3], count + 1)
    trajectory, _ = schedule(PosePath(line), FREE, LIMITS)
    whole, _ = schedule(PosePath(line[[0, -1]]), FREE, LIMITS)
    assert trajectory.duration_s == pytest.approx(whole.duration_s, rel=0.02)
    angle = np.linspace(0, np.pi / 2, count + 1)
    circle = np.column_stack([0.1 * np.cos(angle), 0.1 * np.sin(angle), 0 * angle + 0.1, 0 * angle])
    trajectory, profile = schedule(PosePath(circle), FREE, LIMITS)
    check_limits(trajectory, LIMITS)
    assert trajectory.duration_s < 2.0
    assert np.abs(np.hypot(profile.poses[:, 0], profile.poses[:, 1]) - 0.1).max() < 0.0003


def test_way_points_that_turn_back_are_kept() -> None:
    there = np.linspace([0, 0, 0.1, 0], [0.02, 0, 0.1, 0], 101)
    trajectory, _ = schedule(PosePath(np.concatenate([there, there[::-1]])), FREE, LIMITS)
    assert trajectory.poses[:, 0].max() == pytest.approx(0.02, abs=1e-4)
    assert trajectory.poses[-1, 0] == pytest.approx(0, abs=1e-12)


def test_rate_that_cannot_represent_the_path_is_refused() -> None:
    """dt^2 a / 8 is the largest distance of a line between two samples from a path of acceleration a."""
    for acceleration_mps2 in (0.1, 0.5, 5.0):
        least_hz = (acceleration_mps2 / 8e-5) ** 0.5
        with pytest.raises(SettingsError, match="rate_hz must be at least"):
            VelocitySettings(acceleration_mps2=acceleration_mps2, rate_hz=0.99 * least_hz)
        slow = VelocitySettings(acceleration_mps2=acceleration_mps2, rate_hz=1.01 * least_hz)
        corner = np.array([[0, 0, 0.1, 0], [0.1, 0, 0.1, 0.5], [0.1, 0.1, 0.1, 0]])
        coarse = schedule(PosePath(corner), FREE, slow)[0]
        fine = schedule(PosePath(corner), FREE, dataclasses.replace(slow, rate_hz=1e4))[0]
        between = [
            np.interp(fine.time_s * coarse.duration_s / fine.duration_s, coarse.time_s, c) for c in coarse.poses.T
        ]
        off = np.abs(np.stack(between, axis=1) - fine.poses)
        assert (off[:, :3].max(axis=1) + BODY.rho_max_m * off[:, 3]).max() <= 2e-5


@pytest.mark.parametrize("changes", [{"spacing_m": 1e-300}, {"rate_hz": 1e300}])
def test_resolution_that_exceeds_memory_is_refused(changes: dict) -> None:
    with pytest.raises(SettingsError, match=next(iter(changes))):
        dataclasses.replace(LIMITS, **changes)


@pytest.mark.parametrize("name", ["v_min_mps", "acceleration_mps2", "rate_hz"])
def test_settings_out_of_domain_are_refused(name: str) -> None:
    with pytest.raises(SettingsError, match=name):
        dataclasses.replace(LIMITS, **{name: 0.0})
