"""The controller's model against the simulator's own, against its own kinematics, and in closed form."""

import xml.etree.ElementTree as ET

import numpy as np
import pytest

from deltasafe.errors import SettingsError
from deltasafe.execution.dynamics import ChainModel, forward_kinematics, rigid_body
from deltasafe.execution.iiwa import World
from deltasafe.execution.kinematics import ArmMount, IiwaKinematics
from tests.unit.execution.conftest import BODY

PENDULUM = """<robot name="pendulum">
  <link name="base"/>
  <link name="rod"><inertial><origin xyz="0 0 -0.3"/><mass value="2"/>
    <inertia ixx="0.06" iyy="0.06" izz="0.001" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <link name="bob"><inertial><mass value="1"/>
    <inertia ixx="0" iyy="0" izz="0" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <joint name="hinge" type="revolute"><parent link="base"/><child link="rod"/><axis xyz="0 1 0"/></joint>
  <joint name="weld" type="fixed"><parent link="rod"/><child link="bob"/><origin xyz="0 0 -0.6"/></joint>
</robot>"""


@pytest.fixture(scope="module")
def world():
    made = World(BODY, ArmMount())
    yield made
    made.close()


def states(count):
    rng = np.random.default_rng(0)
    return zip(rng.uniform(-2, 2, (count, 7)), rng.uniform(-2, 2, (count, 7)), strict=True)


def test_mass_matrix_and_bias_are_the_simulators(world):
    for q, q_dot in states(30):
        mass, bias, _, _ = rigid_body(world.model, q, q_dot)
        p, client = world.bullet, world.client
        theirs = p.calculateMassMatrix(world.arm, q.tolist(), physicsClientId=client)
        np.testing.assert_allclose(mass, theirs, rtol=0, atol=1e-9)
        torques = p.calculateInverseDynamics(world.arm, q.tolist(), q_dot.tolist(), [0.0] * 7, physicsClientId=client)
        np.testing.assert_allclose(bias, torques, rtol=0, atol=1e-9)


def test_jacobian_drift_and_tool_are_those_of_the_closed_form_kinematics(world):
    kinematics = IiwaKinematics(ArmMount(), BODY.shaft_length_m)
    for q, q_dot in states(30):
        _, _, jacobian, drift = rigid_body(world.model, q, q_dot)
        theirs, their_drift = kinematics.differential(q, q_dot)
        np.testing.assert_allclose(jacobian, theirs, atol=1e-9)
        np.testing.assert_allclose(drift, their_drift, atol=1e-9)
        position, (x, y, z, w) = forward_kinematics(world.model, q)
        np.testing.assert_allclose(position, kinematics.tool_position_m(q[None])[0], atol=1e-9)
        shaft = [2 * (x * z + y * w), 2 * (y * z - x * w), 1 - 2 * (x * x + y * y)]
        np.testing.assert_allclose(shaft, kinematics.forward(q[None])[3][0, :, 2], atol=1e-9)


def test_the_power_of_the_bias_is_what_potential_and_kinetic_energy_change_by(world):
    """With no torque q'' = -M^-1 bias, and the energy stays: T + V after a small step, to second order."""
    for q, q_dot in states(5):
        mass, bias, _, _ = rigid_body(world.model, q, q_dot)
        acceleration = np.linalg.solve(mass, -bias)

        def kinetic_energy(time_s, q=q, q_dot=q_dot, acceleration=acceleration):
            speed = q_dot + time_s * acceleration
            there = q + time_s * q_dot + time_s**2 / 2 * acceleration
            return speed @ rigid_body(world.model, there, speed)[0] @ speed / 2

        gained = (kinetic_energy(1e-5) - kinetic_energy(-1e-5)) / 2e-5
        gravity = rigid_body(world.model, q, np.zeros(7))[1]
        assert gained == pytest.approx(-gravity @ q_dot, rel=1e-5, abs=1e-5)


def test_a_pendulum_with_a_welded_bob_in_closed_form():
    model = ChainModel.from_urdf(ET.fromstring(PENDULUM), np.eye(3), np.zeros(3), (0, 0, -9.81))
    angle, rate = 0.7, 1.3
    mass, bias, jacobian, drift = rigid_body(model, np.array([angle]), np.array([rate]))
    assert mass[0, 0] == pytest.approx(0.06 + 2 * 0.3**2 + 1 * 0.6**2)
    assert bias[0] == pytest.approx(9.81 * np.sin(angle) * (2 * 0.3 + 1 * 0.6))
    np.testing.assert_allclose(jacobian[:3, 0], [-0.6 * np.cos(angle), 0, 0.6 * np.sin(angle)], atol=1e-12)
    np.testing.assert_allclose(drift[:3], 0.6 * rate**2 * np.array([np.sin(angle), 0, np.cos(angle)]), atol=1e-12)


def test_only_chains_of_revolute_joints_are_modeled():
    with pytest.raises(SettingsError, match="prismatic"):
        ChainModel.from_urdf(
            ET.fromstring(PENDULUM.replace("revolute", "prismatic")), np.eye(3), np.zeros(3), (0, 0, 0)
        )
    twice = PENDULUM.replace('<parent link="rod"/>', '<parent link="base"/>')
    with pytest.raises(SettingsError, match="branches"):
        ChainModel.from_urdf(ET.fromstring(twice), np.eye(3), np.zeros(3), (0, 0, 0))
