"""Poses, paths and trajectories: wrapping, lengths, immutability, and refused values."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from deltasafe.errors import SettingsError
from deltasafe.geometry import Pose, PosePath, Trajectory, wrap_to_pi

angles = st.floats(-1e4, 1e4)


@given(angle=angles)
def test_wrapped_angles_keep_their_direction(angle):
    wrapped = float(wrap_to_pi(angle))
    assert -math.pi <= wrapped <= math.pi
    assert math.cos(wrapped) == pytest.approx(math.cos(angle), abs=1e-9)
    assert math.sin(wrapped) == pytest.approx(math.sin(angle), abs=1e-9)


def test_length_ignores_rotation():
    path = PosePath(np.array([[0, 0, 0, 0], [3, 4, 0, 1], [3, 4, 12, -2]], dtype=float))
    assert path.length_m == pytest.approx(17.0)


def test_arrays_are_copied_and_read_only():
    poses = np.zeros((2, 4))
    path = PosePath(poses)
    poses[0, 0] = 1.0
    assert path.poses[0, 0] == 0.0
    with pytest.raises(ValueError, match="read-only"):
        path.poses[0, 0] = 1.0


@pytest.mark.parametrize("poses", [np.zeros((0, 4)), np.zeros((2, 3)), np.full((1, 4), np.nan)])
def test_paths_of_wrong_shape_are_refused(poses):
    with pytest.raises(SettingsError):
        PosePath(poses)


def test_non_finite_pose_is_refused():
    with pytest.raises(SettingsError, match="finite"):
        Pose(0.0, math.inf, 0.0)


@pytest.mark.parametrize("time_s", [[0.0, 0.0], [0.1, 0.2], [0.0, 0.2, 0.1]])
def test_time_that_does_not_increase_from_zero_is_refused(time_s):
    n = len(time_s)
    with pytest.raises(SettingsError):
        Trajectory(np.array(time_s), np.zeros((n, 4)), np.zeros((n, 4)))


def test_speed_ignores_rotation():
    velocities = np.array([[0, 0, 0, 9], [3, 0, 4, 0]], dtype=float)
    trajectory = Trajectory(np.array([0.0, 1.0]), np.zeros((2, 4)), velocities)
    assert trajectory.speed_mps.tolist() == [0.0, 5.0]
    assert trajectory.duration_s == 1.0


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf, 1e300, -1e300, 1001.0])
def test_non_finite_or_large_values_are_refused(value):
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
def test_values_that_are_no_poses_are_refused(poses):
    with pytest.raises(SettingsError, match="poses must"):
        PosePath(poses)


@pytest.mark.parametrize("coordinates", [(1e300, 0.0, 0.0), (0.0, -2000.0, 0.0), (0.0, 0.0, 0.0, 1e9)])
def test_far_pose_is_refused(coordinates):
    with pytest.raises(SettingsError, match="within 1000 meters"):
        Pose(*coordinates)
