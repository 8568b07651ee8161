"""The simulated arm."""

import numpy as np
import pytest

from deltasafe.errors import PlanningError, SettingsError
from deltasafe.execution import ExecutionSettings, Workcell, execute
from deltasafe.execution.arm_models import JointFriction
from deltasafe.execution.arm_view import ArmView, Viewpoint
from deltasafe.execution.distance import MeshDistance
from deltasafe.execution.iiwa_kinematics import IIWA14_LIMITS
from deltasafe.execution.simulated_arm import SimulatedArm
from deltasafe.geometry import yaw_of
from deltasafe.planning.body import ToolBody
from deltasafe.planning.parts import ToolPart
from deltasafe.planning.tracking_bound import TrackingBound
from deltasafe.scene.camera import Camera
from tests.unit.execution.closed_form import tool_pose
from tests.unit.execution.conftest import BODY, quintic

SETTINGS = ExecutionSettings(approach_m=0.02, settle_s=0.2)
ABOVE = quintic((-0.06, 0, 0.12, 0), (0.06, 0.03, 0.12, 0.8), 1.6)
CAMERA = Camera(640, 480, 768.75, 768.75, 320.0, 240.0, np.array([0, 0, 0.5]), np.diag([1.0, -1.0, -1.0]))


@pytest.fixture(scope="module")
def execution(hand):
    return execute(ABOVE, Workcell(BODY, hand), SETTINGS, 3)


def test_kinematics_agree_with_the_simulator():
    with SimulatedArm(Workcell(BODY)) as arm:
        for seed in range(5):
            q = np.random.default_rng(seed).uniform(-1, 1, 7)
            arm.reset(q)
            state = arm.state()
            frame = arm._bullet.getLinkState(arm._arm, 7, computeForwardKinematics=1, physicsClientId=arm._client)
            np.testing.assert_allclose(state.tool_position_m, frame[4], atol=1e-6)
            np.testing.assert_allclose(abs(state.tool_quaternion @ frame[5]), 1.0, atol=1e-6)
            np.testing.assert_allclose(tool_pose(q)[0], frame[4], atol=1e-6)


def test_the_model_predicts_the_simulator_without_friction():
    friction = JointFriction((0.0,) * 7, (0.0,) * 7, 0.0, 0.0)
    with SimulatedArm(Workcell(BODY), friction=friction) as arm:
        arm.reset(np.array([0.1, 0.8, 0.2, -1.2, 0.3, 0.9, 0.0]))
        push = np.array([2.0, -3.0, 1.0, 2.0, 0.2, 0.1, 0.002])
        state = arm.state()
        model = arm.dynamics(state)
        arm.step(model.bias_nm + push)
        gained = (arm.state().joint_velocities_radps - state.joint_velocities_radps) / arm.control_period_s
        np.testing.assert_allclose(model.mass_matrix @ gained, push, rtol=0.02, atol=2e-4)


PARTS = ToolBody(
    parts=(
        ToolPart("box", z_m=0.05, half_x_m=0.03, half_y_m=0.015, half_z_m=0.02, yaw_rad=0.5),
        ToolPart("capsule", x_m=0.02, z_m=0.02, half_z_m=0.01, radius_m=0.005),
        ToolPart("sphere", radius_m=0.01),
    )
)


def test_tool_of_parts_has_the_mass_of_its_model_and_touches_where_the_distance_is_zero(hand):
    friction = JointFriction((0.0,) * 7, (0.0,) * 7, 0.0, 0.0)
    with SimulatedArm(Workcell(PARTS, hand), friction=friction) as arm:
        for height_m, touches in ((0.005, False), (-0.003, True)):  # of the sphere above the top of the ball
            pose = np.array([[0.0, -0.02, 0.07 + 0.01 + height_m, 0.4]])
            arm.reset(arm.inverse(pose)[0])
            state = arm.state()
            np.testing.assert_allclose(state.tool_position_m, pose[0, :3], atol=1e-6)
            assert yaw_of(state.tool_quaternion) == pytest.approx(0.4, abs=1e-6)
            distance_m = MeshDistance(*hand).to_tool(PARTS, state.tool_position_m, np.diag([1.0, 1.0, 1.0]))
            assert distance_m == pytest.approx(max(height_m, 0.0), abs=5e-4)
            assert (arm.step(arm.dynamics(state).bias_nm) > 0) == touches
            if not touches:  # gravity is balanced, so the arm rests
                assert np.abs(arm.state().joint_velocities_radps).max() < 1e-4


def test_tracking_error_is_within_the_papers_bound_and_not_zero(execution):
    error = execution.workspace_error_m[execution.judged]
    speed = execution.reference_speed_mps[execution.judged]
    assert execution.completed
    assert (error <= TrackingBound().error_m(np.maximum(speed, 0.01))).all()
    assert error.max() > 5e-5


def test_limits_hold_without_contact(execution):
    assert execution.contacts.sum() == 0
    assert execution.tool_to_hand_m.min() > 0.02
    assert execution.arm_to_hand_m.min() > 0.1
    assert (np.abs(execution.torques_nm) <= IIWA14_LIMITS.torque_nm).all()
    assert (np.abs(execution.joint_positions_rad) <= IIWA14_LIMITS.upper_rad).all()
    speeds = np.gradient(execution.joint_positions_rad, execution.time_s, axis=0)
    assert (np.abs(speeds) <= IIWA14_LIMITS.velocity_radps).all()


def test_a_run_is_a_function_of_its_seed(execution, hand):
    cell = Workcell(BODY, hand)
    assert execute(ABOVE, cell, SETTINGS, 3).digest() == execution.digest()
    assert execute(ABOVE, cell, SETTINGS, 4).digest() != execution.digest()


def test_a_collision_with_the_hand_stops_the_arm(hand):
    into_the_hand = quintic((-0.08, -0.02, 0.05, 0), (0.08, -0.02, 0.05, 0), 2.0)
    run = execute(into_the_hand, Workcell(BODY, hand), SETTINGS, 0)
    assert run.contacts.sum() > 0
    assert run.tool_to_hand_m.min() < 0.0015  # PyBullet pads the tool by 1 mm
    assert "workspace error" in run.stop_reason
    assert run.tool_positions_m[:, 0].max() < 0.0  # it did not penetrate the sphere


def test_the_first_contact_is_where_the_distance_vanishes(hand):
    run = execute(quintic((0, -0.02, 0.085, 0), (0, -0.02, 0.06, 0), 1.0), Workcell(BODY, hand), SETTINGS, 0)
    first = int(np.argmax(run.contacts > 0))
    assert run.contacts[first] > 0
    assert run.tool_to_hand_m[first] < 0.0015
    assert run.tool_to_hand_m[: max(first - 2, 1)].min() > 0.0


def test_links_must_stay_above_the_field(hand):
    with pytest.raises(PlanningError, match=r"a link of the arm comes down to 0\.3\d+ m"):
        execute(ABOVE, Workcell(BODY, hand), SETTINGS, 0, unsafe_below_m=0.4)
    high = quintic((0, 0, 0.2, 0), (0, 0, 0.2, 0.01), 0.1)
    execute(high, Workcell(BODY, hand), SETTINGS, 0, unsafe_below_m=0.2)


def test_links_are_in_view_only_between_start_and_goal():
    view = Viewpoint.of_camera(CAMERA, 320)
    with ArmView(Workcell(BODY)) as arm, SimulatedArm(Workcell(BODY)) as solver:
        for x in (-0.15, 0.15):
            for y in (-0.085, 0.0, 0.09):
                assert arm.links_in_view(solver.inverse(np.array([[x, y, 0.03, 0.0]]))[0], view) == {}
        assert arm.links_in_view(solver.inverse(np.array([[0, 0, 0.12, 0.0]]))[0], view)


def test_viewpoint_projects_like_the_camera():
    points = np.array([[0.1, -0.05, 0.03], [-0.12, 0.08, 0.0]])
    pixels = Viewpoint.of_camera(CAMERA, 640).pixels(points)
    depth = 0.5 - points[:, 2]
    expected = np.stack([320 + 768.75 * points[:, 0] / depth, 240 - 768.75 * points[:, 1] / depth], axis=1)
    np.testing.assert_allclose(pixels, expected, atol=1e-6)


def test_a_mesh_that_is_larger_than_pybullet_takes_is_refused():
    """B12: it raised SystemError."""
    mesh = np.eye(3) / 10, np.tile([[0, 1, 2]], (174_763, 1))
    with pytest.raises(SettingsError, match="174763 triangles; simplify it"):
        SimulatedArm(Workcell(BODY, mesh))


def test_friction_is_validated():
    with pytest.raises(SettingsError, match="coulomb_nm"):
        JointFriction((-1.0,), (1.0,))
    with pytest.raises(SettingsError, match="viscous_nms"):
        JointFriction((1.0, 1.0), (1.0,))
    with pytest.raises(SettingsError, match="variation"):
        JointFriction((1.0,), (1.0,), variation=1.0)
    with pytest.raises(SettingsError, match="7 joints, got 1"):
        SimulatedArm(Workcell(BODY), friction=JointFriction((1.0,), (1.0,)))


def test_loading_the_world_prints_nothing(capfd):
    with SimulatedArm(Workcell(BODY)):
        pass
    captured = capfd.readouterr()
    assert (captured.out, captured.err) == ("", "")
