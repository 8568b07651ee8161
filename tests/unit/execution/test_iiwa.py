"""The simulated arm itself."""

import numpy as np
import pytest

from deltasafe.errors import PlanningError, SettingsError
from deltasafe.execution import ExecutionSettings, execute
from deltasafe.execution.iiwa import IiwaArm, JointFriction
from deltasafe.execution.iiwa_view import ArmView, Viewpoint
from deltasafe.execution.kinematics import IIWA14_LIMITS
from deltasafe.planning.tracking_bound import TrackingBound
from deltasafe.scene.camera import Camera
from tests.unit.execution.conftest import BODY, quintic

SETTINGS = ExecutionSettings(approach_m=0.02, settle_s=0.2)
ABOVE = quintic((-0.06, 0, 0.12, 0), (0.06, 0.03, 0.12, 0.8), 1.6)
CAMERA = Camera(640, 480, 768.75, 768.75, 320.0, 240.0, np.array([0, 0, 0.5]), np.diag([1.0, -1.0, -1.0]))


@pytest.fixture(scope="module")
def execution(hand):
    return execute(ABOVE, hand, BODY, SETTINGS, 3)


def test_our_kinematics_and_the_simulator_agree():
    with IiwaArm(BODY) as arm:
        for seed in range(5):
            q = np.random.default_rng(seed).uniform(-1, 1, 7)
            arm.reset(q)
            state = arm.state()
            np.testing.assert_allclose(arm.kinematics.tool_position_m(q[None])[0], state.tool_position_m, atol=1e-6)


def test_the_model_predicts_the_simulator_without_friction():
    friction = JointFriction((0.0,) * 7, (0.0,) * 7, 0.0, 0.0)
    with IiwaArm(BODY, friction=friction) as arm:
        arm.reset(np.array([0.1, 0.8, 0.2, -1.2, 0.3, 0.9, 0.0]))
        push = np.array([2.0, -3.0, 1.0, 2.0, 0.2, 0.1, 0.002])
        state = arm.state()
        model = arm.dynamics(state)
        arm.step(model.bias_nm + push)
        gained = (arm.state().joint_velocities_radps - state.joint_velocities_radps) / arm.control_period_s
        np.testing.assert_allclose(model.mass_matrix @ gained, push, rtol=0.02, atol=2e-4)


def test_tracking_stays_within_the_papers_line_and_is_not_perfect(execution):
    error = execution.workspace_error_m[execution.judged]
    speed = execution.reference_speed_mps[execution.judged]
    assert execution.completed
    assert (error <= TrackingBound().error_m(np.maximum(speed, 0.01))).all()
    assert error.max() > 5e-5


def test_nothing_is_touched_and_limits_hold(execution):
    assert execution.contacts.sum() == 0
    assert execution.tool_to_hand_m.min() > 0.02
    assert execution.arm_to_hand_m.min() > 0.1
    assert (np.abs(execution.torques_nm) <= IIWA14_LIMITS.torque_nm).all()
    assert (np.abs(execution.joint_positions_rad) <= IIWA14_LIMITS.position_rad).all()
    speeds = np.gradient(execution.joint_positions_rad, execution.time_s, axis=0)
    assert (np.abs(speeds) <= IIWA14_LIMITS.velocity_radps).all()


def test_a_run_is_a_function_of_its_seed(execution, hand):
    assert execute(ABOVE, hand, BODY, SETTINGS, 3).digest() == execution.digest()
    assert execute(ABOVE, hand, BODY, SETTINGS, 4).digest() != execution.digest()


def test_driving_into_the_hand_is_felt_and_stopped(hand):
    run = execute(quintic((-0.08, -0.02, 0.05, 0), (0.08, -0.02, 0.05, 0), 2.0), hand, BODY, SETTINGS, 0)
    assert run.contacts.sum() > 0
    assert run.tool_to_hand_m.min() < 0.0015  # the physics pads the tool by 1 mm
    assert "workspace error" in run.stop_reason
    assert run.tool_positions_m[:, 0].max() < 0.0  # it did not push through the ball


def test_distance_and_contact_agree(hand):
    """The physics counts a contact exactly where the distance is next to nothing."""
    run = execute(quintic((0, -0.02, 0.085, 0), (0, -0.02, 0.06, 0), 1.0), hand, BODY, SETTINGS, 0)
    first = int(np.argmax(run.contacts > 0))
    assert run.contacts[first] > 0
    assert run.tool_to_hand_m[first] < 0.0015
    assert run.tool_to_hand_m[: max(first - 2, 1)].min() > 0.0


def test_links_must_stay_above_the_field(hand):
    with pytest.raises(PlanningError, match=r"a link of the arm comes down to 0\.3\d+ m"):
        execute(ABOVE, hand, BODY, SETTINGS, 0, unsafe_below_m=0.4)
    execute(quintic((0, 0, 0.2, 0), (0, 0, 0.2, 0.01), 0.1), hand, BODY, SETTINGS, 0, unsafe_below_m=0.2)


def test_the_camera_sees_no_link_at_start_and_goal_but_does_between():
    view = Viewpoint.of_camera(CAMERA, 320)
    with ArmView(BODY, None) as arm, IiwaArm(BODY) as solver:
        for x in (-0.15, 0.15):
            for y in (-0.085, 0.0, 0.09):
                assert arm.links_in_view(solver.inverse(np.array([[x, y, 0.03, 0.0]]))[0], view) == {}
        assert arm.links_in_view(solver.inverse(np.array([[0, 0, 0.12, 0.0]]))[0], view)


def test_viewpoint_projects_as_the_camera_does():
    points = np.array([[0.1, -0.05, 0.03], [-0.12, 0.08, 0.0]])
    seen = Viewpoint.of_camera(CAMERA, 640).pixels(points)
    depth = 0.5 - points[:, 2]
    expected = np.stack([320 + 768.75 * points[:, 0] / depth, 240 - 768.75 * points[:, 1] / depth], axis=1)
    np.testing.assert_allclose(seen, expected, atol=1e-6)


def test_friction_is_validated():
    with pytest.raises(SettingsError, match="coulomb_nm"):
        JointFriction(coulomb_nm=(1.0,))
    with pytest.raises(SettingsError, match="variation"):
        JointFriction(variation=1.0)


def test_no_output(capfd):
    with IiwaArm(BODY):
        pass
    captured = capfd.readouterr()
    assert (captured.out, captured.err) == ("", "")
