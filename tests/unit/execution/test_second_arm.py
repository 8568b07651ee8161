"""The second arm, the Franka Panda, and arms from any URDF file: nothing of them is written by hand but data."""

import math
import pathlib

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from deltasafe.errors import DataError, PlanningError, SettingsError
from deltasafe.execution import ArmSettings, ExecutionSettings, Workcell, execute
from deltasafe.execution.chain_kinematics import ChainKinematics
from deltasafe.execution.dynamics import forward_kinematics, rigid_body_dynamics, tool_jacobian
from deltasafe.execution.iiwa_kinematics import IIWA14_LIMITS
from deltasafe.execution.recording import Execution
from deltasafe.execution.simulated_arm import SimulatedArm
from deltasafe.geometry import yaw_of
from deltasafe.studies.tracking import TrackingStudySettings
from deltasafe.studies.tracking.tracking_errors import record_runs
from tests.unit.execution.conftest import BODY, quintic

PANDA = ArmSettings("panda")
SETTINGS = ExecutionSettings(approach_m=0.02, settle_s=0.2, arm=PANDA)
DATA_SHEET = (-2.8973, -1.7628, -2.8973, -3.0718, -2.8973, -0.0175, -2.8973)
poses = st.tuples(st.floats(-0.17, 0.17), st.floats(-0.12, 0.12), st.floats(0.02, 0.2), st.floats(-1.5, 1.5))


@pytest.fixture(scope="module")
def panda():
    with SimulatedArm(Workcell(BODY), 0, PANDA) as arm:
        yield arm


@pytest.fixture(scope="module")
def model_folder():
    return pathlib.Path(pytest.importorskip("pybullet_data").getDataPath())


def states(count):
    rng = np.random.default_rng(0)
    return zip(rng.uniform(-2, 2, (count, 7)), rng.uniform(-2, 2, (count, 7)), strict=True)


def test_limits_are_those_of_the_data_sheet(panda):
    assert panda.limits.lower_rad == DATA_SHEET
    assert panda.limits.torque_nm == (87.0,) * 4 + (12.0,) * 3


def test_model_agrees_with_the_simulator(panda):
    p, client, arm = panda._bullet, panda._client, panda._arm
    for q, q_dot in states(20):
        model = rigid_body_dynamics(panda._model, q, q_dot)
        mass = p.calculateMassMatrix(arm, q.tolist(), physicsClientId=client)
        np.testing.assert_allclose(model.mass_matrix, mass, rtol=0, atol=1e-8)
        torques = p.calculateInverseDynamics(arm, q.tolist(), q_dot.tolist(), [0.0] * 7, physicsClientId=client)
        np.testing.assert_allclose(model.bias_nm, torques, rtol=0, atol=1e-8)
        panda.reset(q)
        state = panda.state()
        frame = p.getLinkState(arm, panda._world.tool_link, computeForwardKinematics=1, physicsClientId=client)
        np.testing.assert_allclose(state.tool_position_m, frame[4], atol=1e-6)
        assert abs(state.tool_quaternion @ frame[5]) == pytest.approx(1, abs=1e-6)


def test_jacobian_of_the_inverse_is_that_of_the_dynamics(panda):
    for q, q_dot in states(10):
        position, quaternion, jacobian = tool_jacobian(panda._model, q)
        expected = forward_kinematics(panda._model, q)
        np.testing.assert_allclose(position, expected[0], atol=1e-13)
        np.testing.assert_allclose(quaternion, expected[1], atol=1e-13)
        np.testing.assert_allclose(jacobian, rigid_body_dynamics(panda._model, q, q_dot).jacobian, atol=1e-13)


@settings(deadline=None, max_examples=40)
@given(poses)
def test_forward_inverts_inverse_up_to_a_half_turn(panda, pose):
    joints = panda.inverse(np.array([pose]))[0]
    assert (joints >= panda.limits.lower_rad).all()
    assert (joints <= panda.limits.upper_rad).all()
    position, quaternion = forward_kinematics(panda._model, joints)
    np.testing.assert_allclose(position, pose[:3], atol=2e-9)
    rotation = Rotation.from_quat(quaternion).as_matrix()
    np.testing.assert_allclose(rotation[:, 2], [0, 0, 1], atol=2e-9)
    assert abs(math.sin(math.atan2(rotation[1, 0], rotation[0, 0]) - pose[3])) < 1e-8


@settings(deadline=None, max_examples=30)
@given(poses, poses)
def test_joints_are_continuous_and_a_function_of_the_pose(panda, a, b):
    path = np.linspace(a, b, 101)
    joints = panda.inverse(path)
    step = np.abs(path[1] - path[0])
    assert np.abs(np.diff(joints, axis=0)).max() <= 12 * (step[:3].sum() + step[3]) + 1e-6
    there_and_back = panda.inverse(np.concatenate([path[::20], path[::-10]]))
    np.testing.assert_allclose(there_and_back[-1], joints[0], atol=1e-5)
    np.testing.assert_allclose(there_and_back[:6], joints[::20], atol=1e-5)


def test_joints_are_the_nearest_to_rest(panda):
    """At the optimum, motion in the null space does not bring the joints nearer to the posture of rest."""
    kinematics = panda.kinematics
    for pose in ([0.1, 0.05, 0.1, 0.3], [-0.15, -0.1, 0.03, -1.0]):
        joints = panda.inverse(np.array([pose]))[0]
        null = np.linalg.svd(tool_jacobian(panda._model, joints)[2])[2][-1]
        assert abs(null @ ((joints - kinematics._rest) / kinematics._half**2)) < 1e-5


def test_refusals_name_pose_and_reason(panda):
    with pytest.raises(PlanningError, match=r"\(0\.000, -0\.900, 0\.030\) m.*out of reach or near a singularity"):
        panda.inverse(np.array([[0, -0.9, 0.03, 0]]))
    turning = np.zeros((400, 4))
    turning[:, 2], turning[:, 3] = 0.1, np.linspace(0, 4 * math.pi, 400)
    with pytest.raises(PlanningError, match="the arm cannot take the pose"):
        panda.inverse(turning)


def test_the_iiwa_has_the_same_tool_pose_by_the_chain_as_in_closed_form():
    """The numerical inverse works for another arm whose answer is known."""
    with SimulatedArm(Workcell(BODY)) as arm:
        chain = ChainKinematics(arm._model, IIWA14_LIMITS, (0.0, 0.4, 0.0, -1.6, 0.0, 1.1, 0.0))
        for pose in ([0.1, 0.05, 0.1, 0.3], [-0.1, 0.0, 0.05, -0.4]):
            reached = forward_kinematics(arm._model, chain.inverse(np.array([pose]))[0])
            expected = forward_kinematics(arm._model, arm.inverse(np.array([pose]))[0])
            np.testing.assert_allclose(reached[0], expected[0], atol=2e-9)
            turn = float(yaw_of(reached[1]) - yaw_of(expected[1]))
            assert abs(math.sin(turn)) < 1e-8


def test_execution_tracks_and_records_its_arm(hand, tmp_path):
    motion = quintic((-0.06, 0, 0.12, 0), (0.06, 0.03, 0.12, 0.8), 1.6)
    run = execute(motion, Workcell(BODY, hand), SETTINGS, 3)
    assert run.completed
    assert run.contacts.sum() == 0
    assert 5e-5 < run.workspace_error_m[run.judged].max() < 5e-3
    run.save(tmp_path / "run")
    loaded = Execution.load(tmp_path / "run")
    assert loaded.arm == PANDA
    assert loaded.digest() == run.digest() == execute(motion, Workcell(BODY, hand), SETTINGS, 3).digest()


def test_an_arm_from_a_urdf_file_with_six_joints(model_folder):
    file = model_folder / "xarm" / "xarm6_robot.urdf"
    arm_settings = ArmSettings(
        str(file), "link6", base_pose=(0.0, 0.55, 0.0, -math.pi / 2), rest_rad=(0, -0.6, -0.9, 0, 1.5, 0)
    )
    with SimulatedArm(Workcell(BODY), 0, arm_settings) as arm:
        path = np.linspace([-0.1, 0.0, 0.08, 0.0], [0.1, 0.0, 0.08, 0.5], 50)
        joints = arm.inverse(path)
        assert joints.shape == (50, 6)
        reached = [forward_kinematics(arm._model, q)[0] for q in joints]
        np.testing.assert_allclose(reached, path[:, :3], atol=2e-9)


def test_a_gripper_and_massless_links_are_left_out_or_merged(model_folder):
    at_link_8 = ArmSettings(
        str(model_folder / "franka_panda" / "panda.urdf"),
        "panda_link8",
        flange_rpy_rad=(0.0, 0.0, math.pi / 4),
        base_pose=(0.0, 0.6, 0.0, -math.pi / 2),
        rest_rad=(0.0, -math.pi / 4, 0.0, -3 * math.pi / 4, 0.0, math.pi / 2, math.pi / 4),
    )
    with SimulatedArm(Workcell(BODY), 0, at_link_8) as arm, SimulatedArm(Workcell(BODY), 0, PANDA) as named:
        pose = np.array([[0.05, 0.0, 0.1, 0.2]])
        np.testing.assert_allclose(arm.inverse(pose), named.inverse(pose), atol=1e-6)
        q = arm.inverse(pose)[0]
        mass = arm._bullet.calculateMassMatrix(arm._arm, q.tolist(), physicsClientId=arm._client)
        np.testing.assert_allclose(rigid_body_dynamics(arm._model, q, 0 * q).mass_matrix, mass, atol=1e-8)


def test_the_tracking_study_runs_on_the_chosen_arm():
    errors_m = {
        name: record_runs(TrackingStudySettings(arm=ArmSettings(name)), 0, 1)["error_m"] for name in ("iiwa", "panda")
    }
    assert len(errors_m["iiwa"]) == len(errors_m["panda"])  # the same motion
    assert np.abs(errors_m["iiwa"] - errors_m["panda"]).max() > 1e-5


URDF = """<robot name="two"><link name="base"/><link name="one"/><link name="two">{extra}</link>
  <joint name="a" type="revolute"><parent link="base"/><child link="one"/>{limit}</joint>
  <joint name="b" type="revolute"><parent link="one"/><child link="two"/></joint></robot>"""
MESH = '<visual><geometry><mesh filename="package://none/gone.obj"/></geometry></visual>'
LIMIT = '<limit lower="-1" upper="1" velocity="1" effort="1"/>'


@pytest.mark.parametrize(
    ("text", "flange", "words"),
    [
        ("<robot", "two", "not a readable URDF"),
        (URDF, "three", "has no link 'three'; it has base, one, two"),
        (URDF.format(extra=MESH, limit=LIMIT), "two", "meshes that do not exist: package://none/gone.obj"),
        (URDF.format(extra="", limit=LIMIT), "two", "no usable limits .* for b"),
        (URDF.format(extra="", limit='<limit lower="x" upper="1"/>'), "two", "for a, b"),
    ],
)
def test_unusable_files_are_named(tmp_path, text, flange, words):
    file = tmp_path / "arm.urdf"
    file.write_text(text)
    with pytest.raises(DataError, match=words):
        SimulatedArm(Workcell(BODY), 0, ArmSettings(str(file), flange))


@pytest.mark.parametrize(
    ("values", "words"),
    [
        ({"model": "ur5"}, "iiwa, panda or the path"),
        ({"model": "ur5.urdf"}, "flange_link must name"),
        ({"model": "panda", "flange_link": "panda_hand"}, "flange_link cannot be changed"),
        ({"rest_rad": (0.0,) * 7}, "rest_rad cannot be changed for the arm 'iiwa'"),
        ({"base_pose": (0.0, 1.0)}, "base_pose must be empty or hold 4"),
        ({"base_pose": (0.0, 1.0, math.nan, 0.0)}, "finite"),
    ],
)
def test_settings_that_would_be_ignored_are_refused(values, words):
    with pytest.raises(SettingsError, match=words):
        ArmSettings(**values)


def test_rest_must_fit_the_joints():
    for rest in ((0.0,) * 6, (0.0,) * 7):  # joint 4 cannot be at 0
        with pytest.raises(SettingsError, match="rest_rad must hold 7 angles within"):
            SimulatedArm(Workcell(BODY), 0, ArmSettings("panda", rest_rad=rest))
