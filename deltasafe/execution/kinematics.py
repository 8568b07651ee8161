"""Kinematics of the LBR iiwa 14 R820 in closed form, pure numpy.

The arm is S-R-S: three axes meet in the shoulder, three in the wrist, one bends the elbow. With
R(q) = Rz(q1) Ry(q2) Rz(q3) Ry(-q4) Rz(q5) Ry(q6) Rz(q7) the inverse is exact, and one parameter, the arm angle of
the elbow about the line from shoulder to wrist, settles the redundancy. A fixed branch and arm angle make
joint positions a smooth function of the tool pose, so a continuous path of the tool stays one in the joints.
"""

import dataclasses
import itertools
import math

import numba
import numpy as np
from numpy.typing import NDArray

from deltasafe.errors import PlanningError, SettingsError
from deltasafe.geometry import as_rows

__all__ = ["IIWA14_LIMITS", "ArmMount", "IiwaKinematics", "JointLimits"]

Array = NDArray[np.float64]

BASE_TO_SHOULDER_M = 0.36
SHOULDER_TO_ELBOW_M = 0.42
ELBOW_TO_WRIST_M = 0.40
WRIST_TO_FLANGE_M = 0.126

_AXES = np.array([[0, 0, 1], [0, 1, 0], [0, 0, 1], [0, -1, 0], [0, 0, 1], [0, 1, 0], [0, 0, 1]], dtype=np.float64)
_BRANCHES = tuple(itertools.product((1.0, -1.0), repeat=3))  # signs of q2, q4 and q6


@dataclasses.dataclass(frozen=True)
class JointLimits:
    """Symmetric limits of each joint: position in rad, velocity in rad/s, torque in N m."""

    position_rad: tuple[float, ...]
    velocity_radps: tuple[float, ...]
    torque_nm: tuple[float, ...]


IIWA14_LIMITS = JointLimits(
    position_rad=tuple(math.radians(a) for a in (170, 120, 170, 120, 170, 120, 175)),
    velocity_radps=tuple(math.radians(a) for a in (85, 85, 100, 75, 130, 135, 135)),
    torque_nm=(320.0, 320.0, 176.0, 176.0, 110.0, 40.0, 40.0),
)
"""Data sheet of the LBR iiwa 14 R820 (decision 26)."""


@dataclasses.dataclass(frozen=True)
class ArmMount:
    """Where the arm stands and how its elbow is held."""

    base_x_m: float = 0.0
    base_y_m: float = 0.65
    base_z_m: float = 0.1
    base_yaw_rad: float = -math.pi / 2
    arm_angle_rad: float = 0.0

    def __post_init__(self) -> None:
        for name, value in dataclasses.asdict(self).items():
            if not math.isfinite(value):
                raise SettingsError(f"{name} must be finite, got {value}")

    @classmethod
    def beside(cls, table_z_m: float) -> "ArmMount":
        """The usual place, for a table of that height."""
        return cls(base_z_m=cls.base_z_m + table_z_m)


class IiwaKinematics:
    """Forward and inverse kinematics of an iiwa 14 with a straight tool below its flange.

    The tool frame sits in the disc's center, z along the shaft to the flange, x along the ellipse's first
    semi-axis: with the shaft vertical its rotation in the world is Rz(yaw).
    """

    def __init__(self, mount: ArmMount, tool_length_m: float) -> None:
        if not (math.isfinite(tool_length_m) and tool_length_m > 0):
            raise SettingsError(f"tool_length_m must be a positive length in meters, got {tool_length_m}")
        self.mount = mount
        self.tool_length_m = tool_length_m
        self.limits = IIWA14_LIMITS
        self._base_rotation = _rotation_z(np.array(mount.base_yaw_rad))
        self._base_m = np.array([mount.base_x_m, mount.base_y_m, mount.base_z_m])
        self._shoulder_m = self._base_m + np.array([0.0, 0.0, BASE_TO_SHOULDER_M])

    def forward(self, joint_positions_rad: Array) -> tuple[Array, Array, Array, Array]:
        """Elbow, wrist and flange (N, 3) in meters and rotation (N, 3, 3) of the tool for (N, 7) joints."""
        q = np.asarray(joint_positions_rad, dtype=np.float64)
        upper = self._base_rotation @ _rotation_z(q[:, 0]) @ _rotation_y(q[:, 1])
        lower = upper @ _rotation_z(q[:, 2]) @ _rotation_y(-q[:, 3])
        hand = lower @ _rotation_z(q[:, 4]) @ _rotation_y(q[:, 5]) @ _rotation_z(q[:, 6])
        elbow = self._shoulder_m + SHOULDER_TO_ELBOW_M * upper[:, :, 2]
        wrist = elbow + ELBOW_TO_WRIST_M * lower[:, :, 2]
        flange = wrist + WRIST_TO_FLANGE_M * hand[:, :, 2]
        return elbow, wrist, flange, hand @ np.diag([1.0, -1.0, -1.0])

    def tool_position_m(self, joint_positions_rad: Array) -> Array:
        """(N, 3) center of the disc for (N, 7) joints."""
        _, _, flange, rotation = self.forward(joint_positions_rad)
        return np.asarray(flange - self.tool_length_m * rotation[:, :, 2])

    def differential(self, q: Array, q_dot: Array) -> tuple[Array, Array]:
        """Jacobian J (6, 7) of the tool's twist (linear, then angular) and the acceleration dJ/dt q_dot (6,)."""
        reach = WRIST_TO_FLANGE_M + self.tool_length_m
        return _differential(q, q_dot, self._base_rotation, reach)

    def inverse(self, poses: Array) -> Array:
        """Joint positions (N, 7), continuous along the path, for tool poses (N, 4), shaft vertical.

        Of the eight branches, and of the half turns of q7 under which the elliptic tool looks the same, the one
        whose smallest margin to a joint limit is largest serves the whole path.

        Raises:
            PlanningError: a pose is out of reach, or every branch leaves a joint's range; names pose and joint.
            SettingsError: a pose is not finite, or farther than 1000 m or 1000 rad from 0.
        """
        poses = as_rows(poses, 4, "poses")
        candidates = [self._branch(poses, signs) for signs in _BRANCHES]
        limits = np.array(self.limits.position_rad)
        margins = [float((1 - np.abs(q) / limits).min()) for q in candidates]
        best = candidates[int(np.argmax(margins))]
        if max(margins) < 0:
            sample, joint = np.unravel_index(np.argmax(np.abs(best) / limits), best.shape)
            raise PlanningError(
                f"the arm cannot take the pose {_say(poses[sample])}: joint {joint + 1} would need "
                f"{math.degrees(best[sample, joint]):.0f} of +-{math.degrees(limits[joint]):.0f} degrees; "
                "shorten the turn of the path or move the base of the arm"
            )
        return best

    def manipulability(self, joint_positions_rad: Array) -> Array:
        """(N,) sqrt(det J J^T) of the tool's Jacobian (Yoshikawa 1985): zero in a singularity."""
        still = np.zeros(7)
        jacobians = np.array([self.differential(q, still)[0] for q in np.asarray(joint_positions_rad)])
        return np.asarray(np.sqrt(np.linalg.det(jacobians @ jacobians.transpose(0, 2, 1))))

    def _branch(self, poses: Array, signs: tuple[float, ...]) -> Array:
        """One branch of the inverse for (N, 4) poses: (N, 7), q1, q3, q5, q7 unwrapped."""
        sign2, sign4, sign6 = signs
        wrist = poses[:, :3] + [0.0, 0.0, self.tool_length_m + WRIST_TO_FLANGE_M]
        reach = (wrist - self._shoulder_m) @ self._base_rotation
        distance = np.linalg.norm(reach, axis=1)
        a, b = SHOULDER_TO_ELBOW_M, ELBOW_TO_WRIST_M
        bend = (distance**2 - a**2 - b**2) / (2 * a * b)
        if (np.abs(bend) > 1).any():
            sample = int(np.argmax(np.abs(bend)))
            raise PlanningError(
                f"the arm cannot reach the pose {_say(poses[sample])}: its wrist would be "
                f"{distance[sample]:.2f} m from the shoulder, at most {a + b:.2f} m are possible"
            )
        q4 = sign4 * np.arccos(bend)
        along = reach / distance[:, None]
        # arm angle 0: the elbow in the vertical plane through shoulder and wrist, above the line between them
        side = np.stack([-along[:, 1], along[:, 0], np.zeros(len(along))], axis=1)
        side /= np.linalg.norm(side, axis=1, keepdims=True)
        above = np.cross(along, side)
        angle = self.mount.arm_angle_rad
        out = math.cos(angle) * above + math.sin(angle) * side
        cosine = (a + b * bend) / distance
        upper = cosine[:, None] * along + np.sqrt(np.clip(1 - cosine**2, 0, 1))[:, None] * out
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
        joints[:, 6] -= math.pi * round(middle / math.pi)
        return joints


def _rotation_z(angle_rad: Array) -> Array:
    c, s, zero = np.cos(angle_rad), np.sin(angle_rad), np.zeros_like(angle_rad)
    return np.moveaxis(np.array([[c, -s, zero], [s, c, zero], [zero, zero, zero + 1]]), (0, 1), (-2, -1))


def _rotation_y(angle_rad: Array) -> Array:
    c, s, zero = np.cos(angle_rad), np.sin(angle_rad), np.zeros_like(angle_rad)
    return np.moveaxis(np.array([[c, zero, s], [zero, zero + 1, zero], [-s, zero, c]]), (0, 1), (-2, -1))


def _say(pose: Array) -> str:
    return f"({pose[0]:.3f}, {pose[1]:.3f}, {pose[2]:.3f}) m, yaw {pose[3]:.2f} rad"


@numba.njit(cache=True)
def _differential(q: Array, q_dot: Array, base: Array, reach: float) -> tuple[Array, Array]:  # pragma: no cover
    # along the chain, relative to the shoulder: each axis, its point, and the velocities of both
    axes, points = np.zeros((7, 3)), np.zeros((7, 3))
    axis_rates, point_rates = np.zeros((7, 3)), np.zeros((7, 3))
    rotation = base.copy()
    point, rate, spin, turning = np.zeros(3), np.zeros(3), np.zeros(3), np.zeros(3)
    for joint in range(7):
        axis = rotation @ _AXES[joint]
        axes[joint], points[joint], point_rates[joint] = axis, point, rate
        axis_rates[joint] = _cross(spin, axis)
        turning = turning + axis_rates[joint] * q_dot[joint]
        spin = spin + axis * q_dot[joint]
        _, y, z = _AXES[joint]
        c, s = math.cos(q[joint]), math.sin(q[joint])
        if z != 0.0:
            turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
        else:
            turn = np.array([[c, 0.0, y * s], [0.0, 1.0, 0.0], [-y * s, 0.0, c]])
        rotation = rotation @ turn
        length = 0.0
        if joint == 1:
            length = SHOULDER_TO_ELBOW_M
        elif joint == 3:
            length = ELBOW_TO_WRIST_M
        elif joint == 6:
            length = reach
        step = length * rotation[:, 2].copy()
        point = point + step
        rate = rate + _cross(spin, step)
    jacobian, drift = np.zeros((6, 7)), np.zeros(6)
    for joint in range(7):
        arm = point - points[joint]
        jacobian[:3, joint] = _cross(axes[joint], arm)
        jacobian[3:, joint] = axes[joint]
        bend = _cross(axis_rates[joint], arm) + _cross(axes[joint], rate - point_rates[joint])
        drift[:3] += bend * q_dot[joint]
    drift[3:] = turning
    return jacobian, drift


@numba.njit(cache=True)
def _cross(a: Array, b: Array) -> Array:  # pragma: no cover
    return np.array([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]])
