"""Cartesian impedance control: the tool is held by springs and dampers to a moving reference. Compiled.

    torque = J^T (Λ (a_ref - dJ/dt q') + K e + D e') + bias + N^T torque_posture,

Λ = (J M^-1 J^T)^-1, N^T = 1 - J^T Λ J M^-1 (Khatib 1987), D from K and Λ by the factorisation of Albu-Schäffer
et al. (2003), so that every direction is damped alike although the inertia differs a thousandfold between pushing the
arm and turning its flange. Gravity, Coriolis and centrifugal torques are compensated from the model, friction is not:
what remains of it makes the tracking error.
"""

import dataclasses
import math

import numba
import numpy as np
from numpy.typing import NDArray

from deltasafe.errors import SettingsError
from deltasafe.execution.arm import ArmState, Dynamics

__all__ = ["ImpedanceSettings", "TaskReference", "impedance_torques", "pose_error", "rotation_error"]

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
    """Joint torques (n,) in N m before saturation.

    Raises:
        SettingsError: the torques are not finite: a measurement, the model or the reference is not.
        numpy.linalg.LinAlgError: the model is singular.
    """
    torques = np.asarray(
        _torques(
            state.joint_positions_rad,
            state.joint_velocities_radps,
            pose_error(reference.position_m, reference.quaternion, state.tool_position_m, state.tool_quaternion),
            *(dynamics.mass_matrix, dynamics.bias_nm, dynamics.jacobian, dynamics.drift),
            *(reference.twist, reference.acceleration),
            *(reference.joint_positions_rad, reference.joint_velocities_radps),
            settings.stiffness_npm,
            settings.rotational_stiffness_nmprad,
            settings.damping_ratio,
            settings.posture_frequency_radps,
        )
    )
    if not math.isfinite(sum(torques.tolist())):
        raise SettingsError(f"the torques must be finite, got {torques.tolist()}")
    return torques


@numba.njit(cache=True)
def pose_error(position_m, quaternion, measured_m, measured_quaternion):  # type: ignore[no-untyped-def]  # pragma: no cover
    """(6,) what is missing to the reference: meters, then the rotation vector in rad, world frame."""
    error = np.empty(6)
    for i in range(3):
        error[i] = position_m[i] - measured_m[i]
    x, y, z, w = quaternion[0], quaternion[1], quaternion[2], quaternion[3]
    a, b, c = -measured_quaternion[0], -measured_quaternion[1], -measured_quaternion[2]
    d = measured_quaternion[3]
    error[3] = w * a + x * d + y * c - z * b
    error[4] = w * b - x * c + y * d + z * a
    error[5] = w * c + x * b - y * a + z * d
    scalar = w * d - x * a - y * b - z * c
    length = math.sqrt(error[3] ** 2 + error[4] ** 2 + error[5] ** 2)
    if length < 1e-12:
        scale = 2.0 * math.copysign(1.0, scalar)
    else:
        scale = 2.0 * math.atan2(math.copysign(length, scalar), abs(scalar)) / length
    for i in range(3, 6):
        error[i] *= scale
    return error


def rotation_error(reference: Array, measured: Array) -> Array:
    """(3,) rotation vector in rad that turns ``measured`` into ``reference`` (quaternions x, y, z, w), world frame."""
    nowhere = np.zeros(3)
    return np.asarray(pose_error(nowhere, np.asarray(reference), nowhere, np.asarray(measured))[3:])


@numba.njit(cache=True)
def _torques(  # type: ignore[no-untyped-def]  # pragma: no cover
    q, q_dot, error, mass, bias, jacobian, drift, twist, acceleration, q_ref, q_dot_ref, linear, angular, ratio, posture
):
    n = len(q)
    spread = np.linalg.solve(mass, jacobian.T)
    inertia = np.linalg.inv(jacobian @ spread)
    inertia = (inertia + inertia.T) / 2
    values, vectors = np.linalg.eigh(inertia)
    error_rate = twist - jacobian @ q_dot
    soft = np.empty(6)
    for i in range(6):
        soft[i] = math.sqrt(linear if i < 3 else angular)
    root = (vectors * np.sqrt(np.maximum(values, 0.0))) @ vectors.T
    # damping D = ratio (root(inertia) root(stiffness) + its transpose)
    damping = ratio * (root @ (soft * error_rate) + soft * (root @ error_rate))
    force = inertia @ (acceleration - drift) + soft * soft * error + damping
    wanted = np.empty(n)
    for i in range(n):
        wanted[i] = posture**2 * (q_ref[i] - q[i]) + 2 * posture * (q_dot_ref[i] - q_dot[i])
    wanted = mass @ wanted
    hidden = wanted - jacobian.T @ (inertia @ (spread.T @ wanted))
    return jacobian.T @ force + bias + hidden
