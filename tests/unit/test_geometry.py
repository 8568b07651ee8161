import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from deltasafe.errors import SettingsError
from deltasafe.geometry import Pose, PosePath, Trajectory, wrap_to_pi

angles = st.floats(-1e4, 1e4)


@given(angle=angles)
def test_wrapping_keeps_the_direction_and_the_range(angle):
    wrapped = float(wrap_to_pi(angle))
    assert -math.pi <= wrapped <= math.pi
    assert math.cos(wrapped) == pytest.approx(math.cos(angle), abs=1e-9)
    assert math.sin(wrapped) == pytest.approx(math.sin(angle), abs=1e-9)


def test_length_counts_positions_and_not_rotation():
    path = PosePath(np.array([[0, 0, 0, 0], [3, 4, 0, 1], [3, 4, 12, -2]], dtype=float))
    assert path.length_m == pytest.approx(17.0)


def test_arrays_are_copied_and_cannot_be_changed():
    poses = np.zeros((2, 4))
    path = PosePath(poses)
    poses[0, 0] = 1.0
    assert path.poses[0, 0] == 0.0
    with pytest.raises(ValueError, match="read-only"):
        path.poses[0, 0] = 1.0


@pytest.mark.parametrize("poses", [np.zeros((0, 4)), np.zeros((2, 3)), np.full((1, 4), np.nan)])
def test_a_path_of_a_wrong_shape_is_refused(poses):
    with pytest.raises(SettingsError):
        PosePath(poses)


def test_a_pose_must_be_finite():
    with pytest.raises(SettingsError, match="finite"):
        Pose(0.0, math.inf, 0.0)


@pytest.mark.parametrize("time_s", [[0.0, 0.0], [0.1, 0.2], [0.0, 0.2, 0.1]])
def test_time_starts_at_zero_and_increases(time_s):
    n = len(time_s)
    with pytest.raises(SettingsError):
        Trajectory(np.array(time_s), np.zeros((n, 4)), np.zeros((n, 4)))


def test_speed_is_that_of_the_position_alone():
    velocities = np.array([[0, 0, 0, 9], [3, 0, 4, 0]], dtype=float)
    trajectory = Trajectory(np.array([0.0, 1.0]), np.zeros((2, 4)), velocities)
    assert trajectory.speed_mps.tolist() == [0.0, 5.0]
    assert trajectory.duration_s == 1.0


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf, 1e300, -1e300, 1001.0])
def test_paths_and_trajectories_hold_no_value_that_is_not_finite_or_too_large(value):
    rows = np.zeros((2, 4))
    broken = rows.copy()
    broken[1, 3] = value
    with pytest.raises(SettingsError, match=r"poses must be finite and within 1000 .* in row 1"):
        PosePath(broken)
    for poses, velocities in ((broken, rows), (rows, broken)):
        with pytest.raises(SettingsError, match="must be finite and within 1000"):
            Trajectory(np.array([0.0, 1.0]), poses, velocities)
    with pytest.raises(SettingsError, match="time_s"):
        Trajectory(np.array([0.0, value * 1e9]), rows, rows)


@pytest.mark.parametrize("poses", [None, "path", [[0, 0, 0, 0], [0, 0]], [["a", 0, 0, 0]], np.zeros(4), 3.0])
def test_what_is_no_array_of_poses_is_refused(poses):
    with pytest.raises(SettingsError, match="poses must"):
        PosePath(poses)


@pytest.mark.parametrize("far", [(1e300, 0.0, 0.0), (0.0, -2000.0, 0.0), (0.0, 0.0, 0.0, 1e9)])
def test_a_pose_farther_than_any_robot_is_refused(far):
    with pytest.raises(SettingsError, match="within 1000 meters"):
        Pose(*far)
