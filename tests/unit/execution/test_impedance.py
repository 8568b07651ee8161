import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from deltasafe.errors import SettingsError
from deltasafe.execution.arm import ArmState, Dynamics
from deltasafe.execution.impedance import ImpedanceSettings, TaskReference, impedance_torques, pose_error
from tests.unit.execution.floating_tool import FloatingTool

SETTINGS = ImpedanceSettings(stiffness_npm=100.0, rotational_stiffness_nmprad=100.0, damping_ratio=0.3)
UPRIGHT = np.array([0.0, 0.0, 0.0, 1.0])


def reference(position=(0, 0, 0), n=6, twist=None, acceleration=None, posture=None):
    return TaskReference(
        np.array(position, dtype=float),
        UPRIGHT,
        np.zeros(6) if twist is None else twist,
        np.zeros(6) if acceleration is None else acceleration,
        np.zeros(n) if posture is None else posture,
        np.zeros(n),
    )


def random_dynamics(rng):
    root = rng.standard_normal((7, 7))
    jacobian = rng.standard_normal((6, 7))
    return Dynamics(root @ root.T + np.eye(7), rng.standard_normal(7), jacobian, rng.standard_normal(6))


def test_point_mass_is_a_damped_oscillator():
    tool = FloatingTool(control_period_s=1e-4)
    tool.reset(np.array([0.01, 0, 0, 0, 0, 0]))
    omega, zeta = 10.0, 0.3
    damped = omega * math.sqrt(1 - zeta**2)
    for step in range(6000):
        if step % 500 == 0:
            t = step * 1e-4
            wave = math.cos(damped * t) + zeta / math.sqrt(1 - zeta**2) * math.sin(damped * t)
            expected = 0.01 * math.exp(-zeta * omega * t) * wave
            assert tool.state().tool_position_m[0] == pytest.approx(expected, abs=2e-5)
        state = tool.state()
        tool.step(impedance_torques(state, tool.dynamics(state), reference(), SETTINGS))


@settings(deadline=None, max_examples=25)
@given(st.integers(0, 2**32 - 1))
def test_task_acceleration_follows_the_impedance_for_any_arm(seed):
    """J q'' + dJ/dt q' = a_ref + Λ^-1 (K e + D e'); gravity and Coriolis torques are compensated."""
    rng = np.random.default_rng(seed)
    dynamics = random_dynamics(rng)
    state = ArmState(rng.standard_normal(7), rng.standard_normal(7), 0.1 * rng.standard_normal(3), UPRIGHT)
    target = reference(n=7, twist=rng.standard_normal(6), acceleration=rng.standard_normal(6))
    torques = impedance_torques(state, dynamics, target, SETTINGS)
    q_ddot = np.linalg.solve(dynamics.mass_matrix, torques - dynamics.bias_nm)
    task = dynamics.jacobian @ q_ddot + dynamics.bias_acceleration
    mobility = dynamics.jacobian @ np.linalg.solve(dynamics.mass_matrix, dynamics.jacobian.T)
    values, vectors = np.linalg.eigh(np.linalg.inv(mobility))
    damping = 2 * 0.3 * 10.0 * (vectors * np.sqrt(values)) @ vectors.T  # K is 100 in all directions
    error = np.concatenate([-state.tool_position_m, np.zeros(3)])
    rate = target.twist - dynamics.jacobian @ state.joint_velocities_radps
    expected = target.acceleration + mobility @ (100.0 * error + damping @ rate)
    np.testing.assert_allclose(task, expected, rtol=1e-6, atol=1e-6 * np.abs(expected).max())


@settings(deadline=None, max_examples=25)
@given(st.integers(0, 2**32 - 1))
def test_null_space_torque_does_not_accelerate_the_tool(seed):
    rng = np.random.default_rng(seed)
    dynamics = random_dynamics(rng)
    state = ArmState(np.zeros(7), np.zeros(7), np.zeros(3), UPRIGHT)
    torques = impedance_torques(state, dynamics, reference(n=7), SETTINGS)
    other = impedance_torques(state, dynamics, reference(n=7, posture=10 * rng.standard_normal(7)), SETTINGS)
    difference = np.linalg.solve(dynamics.mass_matrix, other - torques)
    assert np.linalg.norm(difference) > 1e-6  # the elbow does move
    assert np.linalg.norm(dynamics.jacobian @ difference) < 1e-7 * (1 + np.linalg.norm(difference)) * np.linalg.norm(
        dynamics.jacobian
    )


@settings(deadline=None, max_examples=25)
@given(st.integers(0, 2**32 - 1))
def test_energy_never_grows_while_the_reference_rests(seed):
    rng = np.random.default_rng(seed)
    tool = FloatingTool(control_period_s=1e-4)
    tool.reset(np.concatenate([0.1 * rng.standard_normal(3), np.zeros(3)]))
    previous = math.inf
    for _ in range(400):
        state = tool.state()
        position, velocity = state.tool_position_m, state.joint_velocities_radps
        energy = 50.0 * position @ position + 0.5 * velocity @ velocity
        assert energy <= previous * (1 + 1e-6) + 1e-12
        # the integrator adds O(dt) of the energy exchange between spring and mass
        previous = energy + 1e-4 * 100.0 * abs(position @ velocity[:3])
        tool.step(impedance_torques(state, tool.dynamics(state), reference(), SETTINGS))


def test_damping_ratio_holds_in_every_direction():
    """With a diagonal Λ whose masses differ ten-thousandfold."""
    mass = np.diag([1e-3, 1.0, 10.0, 1e-3, 0.1, 1.0])
    dynamics = Dynamics(mass, np.zeros(6), np.eye(6), np.zeros(6))
    state = ArmState(np.zeros(6), np.ones(6), np.zeros(3), UPRIGHT)
    force = -impedance_torques(state, dynamics, reference(), SETTINGS)
    np.testing.assert_allclose(force, 2 * 0.3 * np.sqrt(100.0 * np.diag(mass)), rtol=1e-9)


@settings(deadline=None, max_examples=25)
@given(st.integers(0, 2**32 - 1), st.floats(1e-9, 3.1))
def test_rotation_error_agrees_with_scipy(seed, angle):
    rng = np.random.default_rng(seed)
    measured = Rotation.random(rng=rng)
    axis = rng.standard_normal(3)
    turn = Rotation.from_rotvec(angle * axis / np.linalg.norm(axis))
    for sign in (1, -1):
        error = pose_error(np.zeros(3), sign * (turn * measured).as_quat(), np.zeros(3), measured.as_quat())
        np.testing.assert_allclose(error[3:], turn.as_rotvec(), atol=1e-7)


def test_gains_are_validated():
    with pytest.raises(SettingsError, match="damping_ratio"):
        ImpedanceSettings(damping_ratio=0)
