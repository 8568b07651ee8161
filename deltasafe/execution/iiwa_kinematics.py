"""Inverse kinematics of the LBR iiwa 14 R820 in closed form.

The arm is S-R-S: three axes intersect in the shoulder, one axis is the elbow, three intersect in the wrist. With
R(q) = Rz(q1) Ry(q2) Rz(q3) Ry(-q4) Rz(q5) Ry(q6) Rz(q7) the inverse is exact. The arm angle of the elbow about the
line from shoulder to wrist resolves the redundancy. For a fixed branch and arm angle the joint positions are a smooth
function of the tool pose, so a continuous tool path gives a continuous joint path.
"""

import itertools
import math

import numpy as np
from numpy.typing import NDArray

from deltasafe.errors import PlanningError, SettingsError
from deltasafe.execution.arm import ArmMount, JointLimits
from deltasafe.geometry import as_rows

Array = NDArray[np.float64]

BASE_TO_SHOULDER_M = 0.36
SHOULDER_TO_ELBOW_M = 0.42
ELBOW_TO_WRIST_M = 0.40
WRIST_TO_FLANGE_M = 0.126
SINGULAR = 1e-6
"""Smallest horizontal fraction of the direction from shoulder to wrist."""

_BRANCHES = tuple(itertools.product((1.0, -1.0), repeat=3))  # signs of q2, q4 and q6


_REACH_RAD = tuple(math.radians(a) for a in (170, 120, 170, 120, 170, 120, 175))
IIWA14_LIMITS = JointLimits(
    lower_rad=tuple(-reach for reach in _REACH_RAD),
    upper_rad=_REACH_RAD,
    velocity_radps=tuple(math.radians(a) for a in (85, 85, 100, 75, 130, 135, 135)),
    torque_nm=(320.0, 320.0, 176.0, 176.0, 110.0, 40.0, 40.0),
)
"""Data sheet of the LBR iiwa 14 R820 (decision 26)."""


class IiwaKinematics:
    """Inverse kinematics of an iiwa 14 with a straight tool below its flange.

    The origin of the tool frame is the center of the disc, z points along the shaft to the flange, x along the first
    semi-axis of the ellipse. With a vertical shaft its rotation in the world is Rz(yaw). A tool that half a turn maps
    to itself may also be held turned by half a turn.
    """

    def __init__(
        self, mount: ArmMount, tool_length_m: float, is_symmetric: bool = True, arm_angle_rad: float = 0.0
    ) -> None:
        if not (math.isfinite(tool_length_m) and tool_length_m > 0):
            raise SettingsError(f"tool_length_m must be a positive length in meters, got {tool_length_m}")
        self.mount = mount
        self.tool_length_m = tool_length_m
        self.limits, self._arm_angle_rad = IIWA14_LIMITS, arm_angle_rad
        self._period_rad = math.pi if is_symmetric else 2 * math.pi
        self._base_rotation = mount.base_rotation
        self._shoulder_m = mount.base_m + np.array([0.0, 0.0, BASE_TO_SHOULDER_M])

    def inverse(self, poses: Array) -> Array:
        """Return joint positions (N, 7), continuous along the path, for tool poses (N, 4) with a vertical shaft.

        The whole path uses one of the eight branches, and one half turn of q7 (the elliptic tool is symmetric): those
        with the largest smallest margin to a joint limit.

        Raises:
            PlanningError: a pose is out of reach, or every branch exceeds a joint limit; names pose and joint.
            SettingsError: a pose is not finite, or farther than 1000 m or 1000 rad from 0.
        """
        poses = as_rows(poses, 4, "poses")
        candidates = [self._branch(poses, signs) for signs in _BRANCHES]
        limits = np.array(self.limits.upper_rad)
        margins = [float((1 - np.abs(q) / limits).min()) for q in candidates]
        best = candidates[int(np.argmax(margins))]
        if max(margins) < 0:
            sample, joint = np.unravel_index(np.argmax(np.abs(best) / limits), best.shape)
            raise PlanningError(
                f"the arm cannot take the pose {_text(poses[sample])}: joint {joint + 1} would need "
                f"{math.degrees(best[sample, joint]):.0f} of +-{math.degrees(limits[joint]):.0f} degrees; "
                "shorten the turn of the path or move the base of the arm"
            )
        return best

    def _branch(self, poses: Array, signs: tuple[float, ...]) -> Array:
        """One branch of the inverse for (N, 4) poses: (N, 7), q1, q3, q5, q7 unwrapped."""
        sign2, sign4, sign6 = signs
        wrist = poses[:, :3] + [0.0, 0.0, self.tool_length_m + WRIST_TO_FLANGE_M]
        reach = (wrist - self._shoulder_m) @ self._base_rotation
        distance = np.linalg.norm(reach, axis=1)
        a, b = SHOULDER_TO_ELBOW_M, ELBOW_TO_WRIST_M
        cos_q4 = (distance**2 - a**2 - b**2) / (2 * a * b)
        if (np.abs(cos_q4) > 1).any():
            sample = int(np.argmax(np.abs(cos_q4)))
            raise PlanningError(
                f"the arm cannot reach the pose {_text(poses[sample])}: its wrist would be "
                f"{distance[sample]:.2f} m from the shoulder, at most {a + b:.2f} m are possible"
            )
        q4 = sign4 * np.arccos(cos_q4)
        direction = reach / distance[:, None]
        # arm angle 0: the elbow lies in the vertical plane through shoulder and wrist, above the line between them
        side = np.stack([-direction[:, 1], direction[:, 0], np.zeros(len(direction))], axis=1)
        beside = np.linalg.norm(side, axis=1, keepdims=True)
        if beside.min() < SINGULAR:
            raise PlanningError(
                f"the arm cannot take the pose {_text(poses[int(beside.argmin())])}: its wrist would be straight above "
                "or below the shoulder, where the plane of the elbow is undefined; move the path or the base of the arm"
            )
        side /= beside
        above = np.cross(direction, side)
        angle = self._arm_angle_rad
        outward = math.cos(angle) * above + math.sin(angle) * side
        cosine = (a + b * cos_q4) / distance
        upper = cosine[:, None] * direction + np.sqrt(np.clip(1 - cosine**2, 0, 1))[:, None] * outward
        lower = (reach - a * upper) / b
        q2 = sign2 * np.arccos(np.clip(upper[:, 2], -1, 1))
        q1 = np.arctan2(sign2 * upper[:, 1], sign2 * upper[:, 0])
        frame = _rotation_z(q1) @ _rotation_y(q2)
        local = np.einsum("nji,nj->ni", frame, lower)
        q3 = np.arctan2(-sign4 * local[:, 1], -sign4 * local[:, 0])
        frame = frame @ _rotation_z(q3) @ _rotation_y(-q4)
        flange = self._base_rotation.T @ _rotation_z(poses[:, 3]) @ np.diag([1.0, -1.0, -1.0])
        hand = frame.transpose(0, 2, 1) @ flange
        q6 = sign6 * np.arccos(np.clip(hand[:, 2, 2], -1, 1))
        q5 = np.arctan2(sign6 * hand[:, 1, 2], sign6 * hand[:, 0, 2])
        q7 = np.arctan2(sign6 * hand[:, 2, 1], -sign6 * hand[:, 2, 0])
        joints = np.unwrap(np.stack([q1, q2, q3, q4, q5, q6, q7], axis=1), axis=0)
        middle = (joints[:, 6].max() + joints[:, 6].min()) / 2
        joints[:, 6] -= self._period_rad * round(middle / self._period_rad)
        return joints


def _rotation_z(angle_rad: Array) -> Array:
    c, s, zero = np.cos(angle_rad), np.sin(angle_rad), np.zeros_like(angle_rad)
    return np.moveaxis(np.array([[c, -s, zero], [s, c, zero], [zero, zero, zero + 1]]), (0, 1), (-2, -1))


def _rotation_y(angle_rad: Array) -> Array:
    c, s, zero = np.cos(angle_rad), np.sin(angle_rad), np.zeros_like(angle_rad)
    return np.moveaxis(np.array([[c, zero, s], [zero, zero + 1, zero], [-s, zero, c]]), (0, 1), (-2, -1))


def _text(pose: Array) -> str:
    return f"({pose[0]:.3f}, {pose[1]:.3f}, {pose[2]:.3f}) m, yaw {pose[3]:.2f} rad"
