"""Committed motions: they end at rest within the braking time, stay on the path, and keep the acceleration."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from deltasafe.errors import SettingsError
from deltasafe.geometry import Trajectory
from deltasafe.online.committed import TimedPath, piece_and_brake, standstill
from deltasafe.online.settings import OnlineSettings

SETTINGS = OnlineSettings()
V_MPS, A_MPS2, LENGTH_M = 0.2, 0.5, 0.3


def straight_path(z_m: float = 0.0) -> TimedPath:
    """A trapezoidal speed profile along x: closed form of the schedule of a straight path."""
    ramp_s, cruise_s = V_MPS / A_MPS2, LENGTH_M / V_MPS - V_MPS / A_MPS2
    time_s = np.arange(0, round((2 * ramp_s + cruise_s) * 1000) + 1) / 1000
    speed = np.clip(np.minimum(A_MPS2 * time_s, A_MPS2 * (time_s[-1] - time_s)), 0, V_MPS)
    x = np.append(0.0, np.cumsum((speed[1:] + speed[:-1]) / 2 / 1000))
    poses, velocities = np.zeros((len(x), 4)), np.zeros((len(x), 4))
    poses[:, 2] = z_m
    poses[:, 0], velocities[:, 0] = x, speed
    return TimedPath(Trajectory(time_s, poses, velocities), 1, 0.03)


PATH = straight_path()
STATES = {
    "progress": st.floats(0, PATH.trajectory.duration_s),
    "rate": st.floats(0, 1),
    "target": st.floats(0, 1),
}


@settings(max_examples=60, deadline=None)
@given(**STATES)
def test_ends_at_rest_within_braking_time(progress: float, rate: float, target: float) -> None:
    motion = piece_and_brake(PATH, 3.0, progress, rate, target, 2.9, SETTINGS)
    assert motion.time_s[0] == 3.0
    assert motion.rate[-1] == 0.0
    assert motion.speed_mps[-1] == 0.0
    assert motion.time_s[-1] <= 3.0 + SETTINGS.cycle_s + SETTINGS.braking_time_s(V_MPS) + 1e-9
    assert not motion.is_moving_at(float(motion.time_s[-1]) + 1.0)


@settings(max_examples=60, deadline=None)
@given(**STATES)
def test_stays_on_path_and_keeps_speed_and_acceleration(progress: float, rate: float, target: float) -> None:
    motion = piece_and_brake(PATH, 0.0, progress, rate, target, 0.0, SETTINGS)
    assert (np.diff(motion.progress_s) >= 0).all()
    assert np.abs(motion.poses[:, 1:]).max() == 0.0
    assert motion.poses[:, 0].max() <= LENGTH_M + 1e-9
    steps_s = np.diff(motion.time_s)
    speed = np.diff(motion.poses[:, 0]) / steps_s
    assert (speed <= motion.speed_mps[:-1] + 1e-12).all()
    assert (speed <= motion.speed_mps[1:] + 1e-12)[:-1].all()
    assert speed.max(initial=0.0) <= V_MPS + 1e-9
    most = A_MPS2 + SETTINGS.brake_mps2
    assert np.abs(np.diff(speed)).max(initial=0.0) <= 1.05 * most * steps_s[0] + 1e-9


def test_braking_from_full_speed_takes_the_closed_form_distance() -> None:
    middle_s = PATH.trajectory.duration_s / 2
    motion = piece_and_brake(PATH, 0.0, middle_s, 1.0, 1.0, 0.0, SETTINGS)
    moved_m = motion.poses[-1, 0] - motion.poses[0, 0]
    assert moved_m == pytest.approx(V_MPS * SETTINGS.cycle_s + V_MPS**2 / (2 * SETTINGS.brake_mps2), rel=0.01)


def test_standstill_never_moves() -> None:
    held = standstill(np.array([0.1, 0.2, 0.3, 0.4]), 1.0)
    assert not held.is_moving_at(1.0)
    assert not held.is_moving_at(9.0)
    np.testing.assert_array_equal(held.at(5.0)[0], [0.1, 0.2, 0.3, 0.4])


def test_settings_refuse_a_reach_that_the_hand_leaves() -> None:
    with pytest.raises(SettingsError, match="reach_m"):
        OnlineSettings(v_hand_mps=1.0, horizon_s=0.35, reach_m=0.2)
