"""Cartesian impedance control: springs and dampers hold the tool to a moving reference. Compiled.

    torque = J^T (Λ (a_ref - dJ/dt q') + K e + D e') + bias + N^T torque_posture,

with Λ = (J M^-1 J^T)^-1 and N^T = 1 - J^T Λ J M^-1 (Khatib 1987). D follows from K and Λ by the factorization of
Albu-Schäffer et al. (2003): the damping ratio is the same in every direction, although the inertia differs a
thousandfold between pushing the arm and turning its flange. Gravity, Coriolis and centrifugal torques are compensated
by the model. Friction is not compensated; it causes the tracking error.
"""

import dataclasses
import math

import numpy as np
from numpy.typing import NDArray

from deltasafe.compute.numba_cache import compiled
from deltasafe.errors import SettingsError
from deltasafe.execution.arm import ArmState, Dynamics
from deltasafe.setting_ranges import check_range

Array = NDArray[np.float64]


@dataclasses.dataclass(frozen=True)
class ImpedanceSettings:
    """Gains of the impedance controller.

    Attributes:
        stiffness_npm: translational stiffness in N/m. 5000 N/m is the largest that KUKA's own impedance mode allows:
            1 N of uncompensated friction then costs 0.2 mm of the 0.5 mm that the paper grants at 0.01 m/s.
        rotational_stiffness_nmprad: rotational stiffness in N m/rad; KUKA allows 300. The inertia of the tool about
            its own axis is about 0.002 kg m^2, so 150 N m/rad gives 44 Hz, far below the control rate of 1 kHz.
        damping_ratio: in all six directions; 0.7 is KUKA's default, well damped, and lags less than 1.
        posture_frequency_radps: natural frequency of the elbow's return to its reference posture, critically damped.
    """

    stiffness_npm: float = 5000.0
    rotational_stiffness_nmprad: float = 150.0
    damping_ratio: float = 0.7
    posture_frequency_radps: float = 10.0

    def __post_init__(self) -> None:
        check_range(self, "(0, inf)", *dataclasses.asdict(self))


@dataclasses.dataclass(frozen=True)
class TaskReference:
    """The reference of the controller at one instant.

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
    """Return the joint torques (n,) in N m before saturation.

    Raises:
        SettingsError: the torques are not finite, because a measurement, the model or the reference is not.
        numpy.linalg.LinAlgError: the model is singular.
    """
    torques = np.asarray(
        _torques(
            (state.joint_positions_rad, state.joint_velocities_radps),
            pose_error(reference.position_m, reference.quaternion, state.tool_position_m, state.tool_quaternion),
            dynamics,
            (reference.twist, reference.acceleration),
            (reference.joint_positions_rad, reference.joint_velocities_radps),
            (settings.stiffness_npm, settings.rotational_stiffness_nmprad),
            (settings.damping_ratio, settings.posture_frequency_radps),
        )
    )
    if not math.isfinite(sum(torques.tolist())):
        raise SettingsError(f"the torques must be finite, got {torques.tolist()}")
    return torques


@compiled
def pose_error(position_m, quaternion, measured_m, measured_quaternion):  # type: ignore[no-untyped-def]  # pragma: no cover
    """Return (6,) reference minus measured pose: meters, then the rotation vector in rad, world frame."""
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


@compiled
def _torques(joints, error, dynamics, task, posture, stiffness, damping):  # type: ignore[no-untyped-def]  # pragma: no cover
    """Each pair holds (position, velocity), (twist, acceleration), (linear, angular) or (ratio, posture frequency)."""
    q, q_dot = joints
    twist, acceleration = task
    q_ref, q_dot_ref = posture
    linear, angular = stiffness
    ratio, frequency = damping
    mass, jacobian = dynamics.mass_matrix, dynamics.jacobian
    n = len(q)
    inverse_mass_jt = np.linalg.solve(mass, jacobian.T)
    inertia = np.linalg.inv(jacobian @ inverse_mass_jt)
    inertia = (inertia + inertia.T) / 2
    values, vectors = np.linalg.eigh(inertia)
    error_rate = twist - jacobian @ q_dot
    root_stiffness = np.empty(6)
    for i in range(6):
        root_stiffness[i] = math.sqrt(linear if i < 3 else angular)
    root_inertia = (vectors * np.sqrt(np.maximum(values, 0.0))) @ vectors.T
    # D = ratio * (root_inertia root_stiffness + its transpose)
    damping_force = ratio * (
        root_inertia @ (root_stiffness * error_rate) + root_stiffness * (root_inertia @ error_rate)
    )
    spring_force = root_stiffness * root_stiffness * error
    force = inertia @ (acceleration - dynamics.bias_acceleration) + spring_force + damping_force
    posture_acceleration = np.empty(n)
    for i in range(n):
        posture_acceleration[i] = frequency**2 * (q_ref[i] - q[i]) + 2 * frequency * (q_dot_ref[i] - q_dot[i])
    posture_torque = mass @ posture_acceleration
    null_space_torque = posture_torque - jacobian.T @ (inertia @ (inverse_mass_jt.T @ posture_torque))
    return jacobian.T @ force + dynamics.bias_nm + null_space_torque
