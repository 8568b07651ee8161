"""What an arm can do, in a handful of verbs, and an arm in memory for tests of whoever drives one."""

import dataclasses
import math
from typing import Protocol, Self

import numpy as np
from numpy.typing import NDArray

from deltasafe.execution.kinematics import JointLimits
from deltasafe.geometry import MAX_COORDINATE

__all__ = ["Arm", "ArmState", "Dynamics", "FloatingTool", "measurement_fault"]

Array = NDArray[np.float64]

_UNIT_TOLERANCE = 1e-3
"""By which the squared norm of a measured quaternion may differ from 1: single precision is 1e-7, a failed sensor 1."""


@dataclasses.dataclass(frozen=True)
class ArmState:
    """What is measured at one instant.

    Attributes:
        joint_positions_rad, joint_velocities_radps: (n,).
        tool_position_m: (3,) center of the disc.
        tool_quaternion: (4,) x, y, z, w; rotates the tool's frame (z along the shaft, upward) into the world's.
    """

    joint_positions_rad: Array
    joint_velocities_radps: Array
    tool_position_m: Array
    tool_quaternion: Array


def measurement_fault(state: ArmState) -> str:
    """Return why a measurement cannot be trusted, or an empty string.

    NaN, infinity, a position farther than 1000 m, or a quaternion that is no rotation (all zeros after a sensor fault).
    Sums instead of ``np.isfinite``: this runs at every step of control, and a sum is finite only if every term is.
    """
    position, quaternion = state.tool_position_m.tolist(), state.tool_quaternion.tolist()
    for name, values in (
        ("joint positions", state.joint_positions_rad.tolist()),
        ("joint velocities", state.joint_velocities_radps.tolist()),
        ("tool position", position),
        ("tool rotation", quaternion),
    ):
        if not math.isfinite(sum(values)):
            return f"the measured {name} are not finite: {values}"
    if len(position) != 3 or max(map(abs, position)) > MAX_COORDINATE:
        return f"the measured tool position is no place within {MAX_COORDINATE:g} m: {position}"
    if len(quaternion) != 4 or not abs(sum(value * value for value in quaternion) - 1) <= _UNIT_TOLERANCE:
        return f"the measured tool rotation is no unit quaternion: {quaternion}"
    return ""


@dataclasses.dataclass(frozen=True)
class Dynamics:
    """The model of the arm that its controller has: M q'' + bias = torque, twist = J q'.

    Attributes:
        mass_matrix: (n, n).
        bias_nm: (n,) gravity, Coriolis and centrifugal torques; no friction.
        jacobian: (6, n) linear, then angular velocity of the tool's frame in the world.
        drift: (6,) dJ/dt q'.
    """

    mass_matrix: Array
    bias_nm: Array
    jacobian: Array
    drift: Array


class Arm(Protocol):
    """A torque-controlled arm that carries the tool. Use it as a context manager."""

    @property
    def limits(self) -> JointLimits: ...

    @property
    def control_period_s(self) -> float: ...

    def __enter__(self) -> Self: ...

    def __exit__(self, *exception: object) -> None: ...

    def inverse(self, poses: Array) -> Array:
        """Joint positions (N, n), continuous along tool poses (N, 4); raises PlanningError if impossible."""

    def reset(self, joint_positions_rad: Array) -> None:
        """Put the arm at rest into a posture."""

    def state(self) -> ArmState:
        """Measure joints and tool."""

    def dynamics(self, state: ArmState) -> Dynamics:
        """The controller's model at a state."""

    def step(self, torques_nm: Array) -> int:
        """Apply joint torques (n,) for one control period; number of contacts with hand or table in it."""

    def brake(self) -> None:
        """Close the joints' brakes: torques are ignored from now on, until the next reset."""

    def link_points_m(self) -> Array:
        """(P, 3) points on the surface of the links above the tool."""


class FloatingTool:
    """The tool as a free unit mass without gravity: three axes of position, one of yaw. Frictionless, exact.

    Its "joints" are x, y, z [m] and three angles of which only the last (yaw, rad) may move.
    """

    def __init__(self, control_period_s: float = 1e-3, drag_ns_per_m: float = 0.0) -> None:
        self.control_period_s = control_period_s
        self.limits = JointLimits((10.0,) * 6, (10.0,) * 6, (100.0,) * 6)
        self._drag = drag_ns_per_m
        self._q, self._q_dot = np.zeros(6), np.zeros(6)
        self._braked = False

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exception: object) -> None:
        return None

    def inverse(self, poses: Array) -> Array:
        return np.insert(np.asarray(poses, dtype=np.float64), [3, 3], 0.0, axis=1)

    def reset(self, joint_positions_rad: Array) -> None:
        self._q, self._q_dot = np.array(joint_positions_rad, dtype=np.float64), np.zeros(6)
        self._braked = False

    def state(self) -> ArmState:
        half = self._q[5] / 2
        quaternion = np.array([0.0, 0.0, np.sin(half), np.cos(half)])
        return ArmState(self._q.copy(), self._q_dot.copy(), self._q[:3].copy(), quaternion)

    def dynamics(self, state: ArmState) -> Dynamics:
        return Dynamics(np.eye(6), np.zeros(6), np.eye(6), np.zeros(6))

    def step(self, torques_nm: Array) -> int:
        acceleration = np.asarray(torques_nm) - self._drag * self._q_dot
        acceleration[3:5] = 0.0
        if self._braked:
            acceleration = -self._q_dot / self.control_period_s
        self._q_dot = self._q_dot + self.control_period_s * acceleration
        self._q = self._q + self.control_period_s * self._q_dot
        return 0

    def brake(self) -> None:
        self._braked = True

    def link_points_m(self) -> Array:
        return np.zeros((0, 3))
