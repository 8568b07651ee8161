import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from deltasafe.errors import PlanningError, SettingsError
from deltasafe.execution.arm import ArmMount
from deltasafe.execution.iiwa_kinematics import IIWA14_LIMITS, IiwaKinematics
from tests.unit.execution.closed_form import tool_pose

KINEMATICS = IiwaKinematics(ArmMount(), 0.25)
LIMITS = np.array(IIWA14_LIMITS.upper_rad)
poses = st.tuples(st.floats(-0.17, 0.17), st.floats(-0.12, 0.12), st.floats(0.02, 0.2), st.floats(-math.pi, math.pi))


@settings(deadline=None, max_examples=40)
@given(poses)
def test_forward_inverts_inverse_up_to_a_half_turn(pose):
    joints = KINEMATICS.inverse(np.array([pose]))
    assert (np.abs(joints) <= LIMITS).all()
    position, rotation = tool_pose(joints[0], 0.25)
    np.testing.assert_allclose(position, pose[:3], atol=1e-9)
    np.testing.assert_allclose(rotation[:, 2], [0, 0, 1], atol=1e-9)
    assert abs(math.sin(math.atan2(rotation[1, 0], rotation[0, 0]) - pose[3])) < 1e-7


@settings(deadline=None, max_examples=40)
@given(poses, poses)
def test_joints_are_continuous_along_a_line(a, b):
    s = np.linspace(0, 1, 200)[:, None]
    path = np.array(a) + s * (np.array(b) - np.array(a))
    path[:, 3] = np.array(a)[3] + s[:, 0] * np.clip(b[3] - a[3], -2.5, 2.5)
    joints = KINEMATICS.inverse(path)
    step = np.abs(np.diff(path, axis=0)).max(axis=0)
    assert np.abs(np.diff(joints, axis=0)).max() <= 8 * (step[:3].sum() + step[3]) + 1e-9


def test_the_mount_keeps_joint_margin_over_the_working_area():
    axes = [np.linspace(-0.17, 0.17, 5), np.linspace(-0.12, 0.12, 5), np.linspace(0.02, 0.2, 4)]
    poses = np.stack(np.meshgrid(*axes, [0.0]), axis=-1).reshape(-1, 4)
    joints = np.concatenate([KINEMATICS.inverse(pose[None]) for pose in poses])
    assert (1 - np.abs(joints) / LIMITS).min() >= 0.17


def test_a_pose_out_of_reach_is_named():
    with pytest.raises(PlanningError, match=r"\(0\.000, -0\.900, 0\.030\) m.*at most 0\.82 m"):
        KINEMATICS.inverse(np.array([[0, -0.9, 0.03, 0]]))


def test_wrist_straight_above_the_shoulder_is_refused():
    above = np.array([[0.0, 0.65, 0.8, 0.0]])
    for path in (above, np.concatenate([above + 0.2 * np.eye(4)[:1], above])):
        with pytest.raises(PlanningError, match="above or below the shoulder"):
            KINEMATICS.inverse(path)


def test_tool_without_symmetry_is_not_turned_by_half_a_turn():
    kinematics = IiwaKinematics(ArmMount(), 0.25, is_symmetric=False)
    for yaw in (-1.2, -0.4, 0.3, 0.9):
        rotation = tool_pose(kinematics.inverse(np.array([[0.05, 0.02, 0.1, yaw]]))[0], 0.25)[1]
        assert math.atan2(rotation[1, 0], rotation[0, 0]) == pytest.approx(yaw, abs=1e-7)


def test_two_full_turns_exceed_a_joint_limit():
    path = np.zeros((400, 4))
    path[:, 2], path[:, 3] = 0.1, np.linspace(0, 4 * math.pi, 400)
    with pytest.raises(PlanningError, match="joint 7"):
        KINEMATICS.inverse(path)


def test_mount_and_tool_are_validated():
    with pytest.raises(SettingsError, match="base_y_m"):
        ArmMount(base_y_m=math.nan)
    with pytest.raises(SettingsError, match="tool_length_m"):
        IiwaKinematics(ArmMount(), 0.0)
