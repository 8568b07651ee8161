"""Forward kinematics of the iiwa 14 with tool in closed form, independent of the URDF."""

import numpy as np

from deltasafe.execution.arm import ArmMount
from deltasafe.execution.iiwa_kinematics import (
    BASE_TO_SHOULDER_M,
    ELBOW_TO_WRIST_M,
    SHOULDER_TO_ELBOW_M,
    WRIST_TO_FLANGE_M,
)
from tests.unit.execution.conftest import BODY

MOUNT = ArmMount()


def about_z(angle):
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])


def about_y(angle):
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]])


def tool_pose(q, tool_length_m=BODY.shaft_length_m):
    """Position (3,) of the disc and rotation (3, 3) of the tool for joint positions (7,)."""
    upper = about_z(MOUNT.base_yaw_rad) @ about_z(q[0]) @ about_y(q[1])
    lower = upper @ about_z(q[2]) @ about_y(-q[3])
    hand = lower @ about_z(q[4]) @ about_y(q[5]) @ about_z(q[6])
    shoulder = np.array([MOUNT.base_x_m, MOUNT.base_y_m, MOUNT.base_z_m + BASE_TO_SHOULDER_M])
    wrist = shoulder + SHOULDER_TO_ELBOW_M * upper[:, 2] + ELBOW_TO_WRIST_M * lower[:, 2]
    position = wrist + (WRIST_TO_FLANGE_M + tool_length_m) * hand[:, 2]
    return position, hand @ np.diag([1.0, -1.0, -1.0])
