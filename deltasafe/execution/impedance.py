"""Cartesian impedance control: the tool is held by springs and dampers to a moving reference. Pure numpy.

    torque = J^T (Λ (a_ref - dJ/dt q') + K e + D e') + bias + N^T torque_posture,

Λ = (J M^-1 J^T)^-1, N^T = 1 - J^T Λ J M^-1 (Khatib 1987), D from K and Λ by the factorisation of Albu-Schäffer
et al. (2003), so that every direction is damped alike although the inertia differs a thousandfold between pushing the
arm and turning its flange. Gravity, Coriolis and centrifugal torques are compensated from the model, friction is not:
what remains of it makes the tracking error.
"""

import dataclasses
import math

import numpy as np
from numpy.typing import NDArray

from deltasafe.errors import SettingsError
from deltasafe.execution.arm import ArmState, Dynamics

__all__ = ["ImpedanceSettings", "TaskReference", "impedance_torques", "rotation_error"]

Array = NDArray[np.float64]


@dataclasses.dataclass(frozen=True)
class ImpedanceSettings:
    """Gains.

    Attributes:
        stiffness_npm: spring to the reference position. 5000 N/m is the most that KUKA's own impedance mode allows:
            1 N of uncompensated friction then costs 0.2 mm of the 0.5 mm that the paper grants at 0.01 m/s.
        rotational_stiffness_nmprad: spring to the reference rotation, KUKA allows 300 N m/rad. The tool turns about
            its own axis with some 0.002 kg m^2, so 150 N m/rad is already 44 Hz, far enough below the 1 kHz of control.
        damping_ratio: of all six directions; 0.7 as KUKA's default is well damped and lags less than 1.
        posture_frequency_radps: how fast the elbow returns to its reference posture, critically damped.
    """

    stiffness_npm: float = 5000.0
    rotational_stiffness_nmprad: float = 150.0
    damping_ratio: float = 0.7
    posture_frequency_radps: float = 10.0

    def __post_init__(self) -> None:
        for name, value in dataclasses.asdict(self).items():
            if not (math.isfinite(value) and value > 0):
                raise SettingsError(f"{name} must be positive, got {value}")


@dataclasses.dataclass(frozen=True)
class TaskReference:
    """Where the tool shall be now.

    Attributes:
        position_m: (3,); quaternion: (4,) x, y, z, w.
        twist, acceleration: (6,) linear then angular, m/s and rad/s (per s).
        joint_positions_rad, joint_velocities_radps: (n,) posture that the null space follows.
    """

    position_m: Array
    quaternion: Array
    twist: Array
    acceleration: Array
    joint_positions_rad: Array
    joint_velocities_radps: Array


def impedance_torques(
    state: ArmState, dynamics: Dynamics, reference: TaskReference, settings: ImpedanceSettings
) -> Array:
    """Joint torques (n,) in N m before saturation."""
    jacobian, mass = dynamics.jacobian, dynamics.mass_matrix
    spread = np.linalg.solve(mass, jacobian.T)
    inertia = np.linalg.inv(jacobian @ spread)
    inertia = (inertia + inertia.T) / 2
    stiffness = np.repeat([settings.stiffness_npm, settings.rotational_stiffness_nmprad], 3)
    error = np.concatenate(
        [
            reference.position_m - state.tool_position_m,
            rotation_error(reference.quaternion, state.tool_quaternion),
        ]
    )
    error_rate = reference.twist - jacobian @ state.joint_velocities_radps
    root = _symmetric_root(inertia) * np.sqrt(stiffness)
    damping = settings.damping_ratio * (root + root.T)
    force = inertia @ (reference.acceleration - dynamics.drift) + stiffness * error + damping @ error_rate
    frequency = settings.posture_frequency_radps
    posture = mass @ (
        frequency**2 * (reference.joint_positions_rad - state.joint_positions_rad)
        + 2 * frequency * (reference.joint_velocities_radps - state.joint_velocities_radps)
    )
    hidden = posture - jacobian.T @ (inertia @ (spread.T @ posture))
    return np.asarray(jacobian.T @ force + dynamics.bias_nm + hidden)


def rotation_error(reference: Array, measured: Array) -> Array:
    """(3,) rotation vector in rad that turns ``measured`` into ``reference`` (quaternions x, y, z, w), world frame."""
    x, y, z, w = reference
    a, b, c, d = -measured[0], -measured[1], -measured[2], measured[3]
    vector = np.array([w * a + x * d + y * c - z * b, w * b - x * c + y * d + z * a, w * c + x * b - y * a + z * d])
    scalar = w * d - x * a - y * b - z * c
    length = math.sqrt(vector @ vector)
    if length < 1e-12:
        return 2.0 * math.copysign(1.0, scalar) * vector
    return np.asarray(vector * (2.0 * math.atan2(math.copysign(length, scalar), abs(scalar)) / length))


def _symmetric_root(matrix: Array) -> Array:
    values, vectors = np.linalg.eigh(matrix)
    return np.asarray((vectors * np.sqrt(np.maximum(values, 0.0))) @ vectors.T)
