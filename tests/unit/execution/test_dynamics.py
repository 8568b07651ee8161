"""The controller's model against PyBullet, the closed-form kinematics, and closed forms."""

import xml.etree.ElementTree as ET

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from deltasafe.errors import SettingsError
from deltasafe.execution import Workcell
from deltasafe.execution.arm import ArmMount
from deltasafe.execution.arm_models import ArmModel, ArmSettings
from deltasafe.execution.chain_model import ChainModel
from deltasafe.execution.dynamics import forward_kinematics, rigid_body_dynamics
from deltasafe.execution.iiwa_kinematics import IiwaKinematics
from deltasafe.execution.world import World
from tests.unit.execution.closed_form import tool_pose
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
KINEMATICS = IiwaKinematics(ArmMount(), BODY.shaft_length_m)


@pytest.fixture(scope="module")
def world():
    opened = World(Workcell(BODY), ArmModel.of(ArmSettings()))
    yield opened
    opened.close()


def states(count):
    rng = np.random.default_rng(0)
    return zip(rng.uniform(-2, 2, (count, 7)), rng.uniform(-2, 2, (count, 7)), strict=True)


def test_mass_matrix_and_bias_agree_with_pybullet(world):
    for q, q_dot in states(30):
        model = rigid_body_dynamics(world.model, q, q_dot)
        p, client = world.bullet, world.client
        mass = p.calculateMassMatrix(world.arm, q.tolist(), physicsClientId=client)
        np.testing.assert_allclose(model.mass_matrix, mass, rtol=0, atol=1e-9)
        torques = p.calculateInverseDynamics(world.arm, q.tolist(), q_dot.tolist(), [0.0] * 7, physicsClientId=client)
        np.testing.assert_allclose(model.bias_nm, torques, rtol=0, atol=1e-9)


def test_forward_kinematics_agree_with_the_closed_form(world):
    for q, _ in states(30):
        position, quaternion = forward_kinematics(world.model, q)
        expected, rotation = tool_pose(q)
        np.testing.assert_allclose(position, expected, atol=1e-9)
        np.testing.assert_allclose(Rotation.from_quat(quaternion).as_matrix(), rotation, atol=1e-9)


def test_jacobian_and_bias_acceleration_agree_with_differences_of_the_closed_form(world):
    h = 1e-5
    for q, q_dot in states(30):
        model = rigid_body_dynamics(world.model, q, q_dot)
        ahead, behind = q + h * q_dot, q - h * q_dot
        twist = model.jacobian @ q_dot
        (p_ahead, r_ahead), (p_behind, r_behind) = tool_pose(ahead), tool_pose(behind)
        np.testing.assert_allclose(twist[:3], (p_ahead - p_behind) / (2 * h), atol=1e-7)
        spin = (r_ahead - r_behind) / (2 * h) @ tool_pose(q)[1].T
        np.testing.assert_allclose(twist[3:], [spin[2, 1], spin[0, 2], spin[1, 0]], atol=1e-7)
        jacobians = [rigid_body_dynamics(world.model, at, q_dot).jacobian for at in (ahead, behind)]
        change = (jacobians[0] - jacobians[1]) @ q_dot / (2 * h)
        np.testing.assert_allclose(model.bias_acceleration, change, atol=1e-6)


def test_every_column_of_the_jacobian_agrees_with_differences(world):
    h = 1e-6
    for q, _ in states(5):
        jacobian = rigid_body_dynamics(world.model, q, np.zeros(7)).jacobian
        for joint, step in enumerate(h * np.eye(7)):
            moved = tool_pose(q + step)[0] - tool_pose(q - step)[0]
            np.testing.assert_allclose(jacobian[:3, joint], moved / (2 * h), atol=1e-8)


def test_the_mount_keeps_manipulability_over_the_working_area(world):
    """The smallest sqrt(det J J^T) (Yoshikawa 1985), which is 0 in a singularity."""
    axes = [np.linspace(-0.17, 0.17, 5), np.linspace(-0.12, 0.12, 5), np.linspace(0.02, 0.2, 4)]
    poses = np.stack(np.meshgrid(*axes, [0.0]), axis=-1).reshape(-1, 4)
    smallest = np.inf
    for pose in poses:
        jacobian = rigid_body_dynamics(world.model, KINEMATICS.inverse(pose[None])[0], np.zeros(7)).jacobian
        smallest = min(smallest, np.sqrt(np.linalg.det(jacobian @ jacobian.T)))
    assert smallest >= 0.08


def test_energy_is_conserved_without_torque(world):
    """With q'' = -M^-1 bias the kinetic energy changes by the power of gravity, to second order."""
    for q, q_dot in states(5):
        model = rigid_body_dynamics(world.model, q, q_dot)
        acceleration = np.linalg.solve(model.mass_matrix, -model.bias_nm)

        def kinetic_energy(time_s, q=q, q_dot=q_dot, acceleration=acceleration):
            speed = q_dot + time_s * acceleration
            position = q + time_s * q_dot + time_s**2 / 2 * acceleration
            return speed @ rigid_body_dynamics(world.model, position, speed).mass_matrix @ speed / 2

        gained = (kinetic_energy(1e-5) - kinetic_energy(-1e-5)) / 2e-5
        gravity = rigid_body_dynamics(world.model, q, np.zeros(7)).bias_nm
        assert gained == pytest.approx(-gravity @ q_dot, rel=1e-5, abs=1e-5)


def test_pendulum_with_a_fixed_bob_in_closed_form():
    model = ChainModel.from_urdf(ET.fromstring(PENDULUM), np.eye(3), np.zeros(3), (0, 0, -9.81))
    angle, rate = 0.7, 1.3
    mass, bias, jacobian, acceleration = rigid_body_dynamics(model, np.array([angle]), np.array([rate]))
    assert mass[0, 0] == pytest.approx(0.06 + 2 * 0.3**2 + 1 * 0.6**2)
    assert bias[0] == pytest.approx(9.81 * np.sin(angle) * (2 * 0.3 + 1 * 0.6))
    np.testing.assert_allclose(jacobian[:3, 0], [-0.6 * np.cos(angle), 0, 0.6 * np.sin(angle)], atol=1e-12)
    centripetal = 0.6 * rate**2 * np.array([np.sin(angle), 0, np.cos(angle)])
    np.testing.assert_allclose(acceleration[:3], centripetal, atol=1e-12)


def test_robots_other_than_revolute_chains_are_refused():
    with pytest.raises(SettingsError, match="prismatic"):
        ChainModel.from_urdf(
            ET.fromstring(PENDULUM.replace("revolute", "prismatic")), np.eye(3), np.zeros(3), (0, 0, 0)
        )
    branched = PENDULUM.replace('<parent link="rod"/>', '<parent link="base"/>')
    with pytest.raises(SettingsError, match="branches"):
        ChainModel.from_urdf(ET.fromstring(branched), np.eye(3), np.zeros(3), (0, 0, 0))
