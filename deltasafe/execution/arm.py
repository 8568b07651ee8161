"""Interface of a torque-controlled arm: its limits, measured state, and the dynamics that its controller uses."""

import dataclasses
import math
from typing import NamedTuple, Protocol, Self

import numpy as np
from numpy.typing import NDArray

from deltasafe.errors import SettingsError
from deltasafe.geometry import MAX_COORDINATE

Array = NDArray[np.float64]

_UNIT_TOLERANCE = 1e-3
"""Largest deviation of a measured quaternion's squared norm from 1: rounding to float32 gives 1e-7, a dead sensor 1."""


@dataclasses.dataclass(frozen=True)
class JointLimits:
    """Limits of each joint: lowest and highest position in rad, speed in rad/s, torque in N m."""

    lower_rad: tuple[float, ...]
    upper_rad: tuple[float, ...]
    velocity_radps: tuple[float, ...]
    torque_nm: tuple[float, ...]

    def __post_init__(self) -> None:
        values = dataclasses.astuple(self)
        if len({len(one) for one in values}) != 1 or not all(math.isfinite(x) for one in values for x in one):
            raise SettingsError(f"joint limits must be finite numbers, one of each kind for each joint, got {self}")
        for joint, (low, high, speed, torque) in enumerate(zip(*values, strict=True), start=1):
            if not (low < high and speed > 0 and torque > 0):
                raise SettingsError(
                    f"joint {joint} needs a range, a speed and a torque above 0, got {low} to {high} rad, "
                    f"{speed} rad/s and {torque} N m"
                )


@dataclasses.dataclass(frozen=True)
class ArmMount:
    """Pose of the arm's base in the world."""

    base_x_m: float = 0.0
    base_y_m: float = 0.65
    base_z_m: float = 0.1
    base_yaw_rad: float = -math.pi / 2

    def __post_init__(self) -> None:
        for name, value in dataclasses.asdict(self).items():
            if not math.isfinite(value):
                raise SettingsError(f"{name} must be finite, got {value}")

    def on_table(self, table_z_m: float) -> "ArmMount":
        """Return the same mount beside a table of that height."""
        return dataclasses.replace(self, base_z_m=self.base_z_m + table_z_m)

    @property
    def base_m(self) -> Array:
        """(3,) position of the base in the world."""
        return np.array([self.base_x_m, self.base_y_m, self.base_z_m])

    @property
    def base_rotation(self) -> Array:
        """(3, 3) world from base."""
        c, s = np.cos(self.base_yaw_rad), np.sin(self.base_yaw_rad)
        return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


@dataclasses.dataclass(frozen=True)
class ArmState:
    """Measurements at one instant.

    Attributes:
        joint_positions_rad, joint_velocities_radps: (n,).
        tool_position_m: (3,) center of the disc.
        tool_quaternion: (4,) x, y, z, w; rotation of the tool frame (z along the shaft, upward) in the world.
    """

    joint_positions_rad: Array
    joint_velocities_radps: Array
    tool_position_m: Array
    tool_quaternion: Array


def measurement_fault(state: ArmState) -> str:
    """Return why a measurement is unusable, or an empty string.

    Faults are NaN, infinity, a position farther than 1000 m, and a quaternion that is not of unit length.
    """
    position, quaternion = state.tool_position_m.tolist(), state.tool_quaternion.tolist()
    for name, values in (
        ("joint positions", state.joint_positions_rad.tolist()),
        ("joint velocities", state.joint_velocities_radps.tolist()),
        ("tool position", position),
        ("tool rotation", quaternion),
    ):
        if not math.isfinite(sum(values)):  # cheaper than np.isfinite at every control step
            return f"the measured {name} are not finite: {values}"
    if len(position) != 3 or max(map(abs, position)) > MAX_COORDINATE:
        return f"the measured tool position is not within {MAX_COORDINATE:g} m: {position}"
    if len(quaternion) != 4 or not abs(sum(value * value for value in quaternion) - 1) <= _UNIT_TOLERANCE:
        return f"the measured tool rotation is not a unit quaternion: {quaternion}"
    return ""


class Dynamics(NamedTuple):
    """Dynamics of the arm at one state, as its controller models them: M q'' + bias = torque, twist = J q'.

    Attributes:
        mass_matrix: (n, n).
        bias_nm: (n,) gravity, Coriolis and centrifugal torques; no friction.
        jacobian: (6, n) linear, then angular velocity of the tool frame in the world.
        bias_acceleration: (6,) dJ/dt q'.
    """

    mass_matrix: Array
    bias_nm: Array
    jacobian: Array
    bias_acceleration: Array


class Arm(Protocol):
    """A torque-controlled arm that carries the tool. Use it as a context manager."""

    @property
    def limits(self) -> JointLimits: ...

    @property
    def control_period_s(self) -> float: ...

    def __enter__(self) -> Self: ...

    def __exit__(self, *exception: object) -> None: ...

    def inverse(self, poses: Array) -> Array:
        """Return joint positions (N, n), continuous along tool poses (N, 4); raise PlanningError if there are none."""

    def reset(self, joint_positions_rad: Array) -> None:
        """Put the arm at rest into a posture."""

    def state(self) -> ArmState:
        """Measure joints and tool."""

    def dynamics(self, state: ArmState) -> Dynamics:
        """Evaluate the controller's model at a state."""

    def step(self, torques_nm: Array) -> int:
        """Apply joint torques (n,) for one control period; return the number of contacts with hand or table."""

    def brake(self) -> None:
        """Close the joint brakes: torques have no effect until the next reset."""

    def link_points_m(self) -> Array:
        """Return (P, 3) points on the surface of the links above the tool."""
