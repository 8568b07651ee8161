"""Evaluation of constructed recordings; film and figure."""

import dataclasses
import json

import numpy as np
import pytest
from PIL import Image

from deltasafe.errors import SettingsError
from deltasafe.execution import Execution, Workcell, evaluate_execution, save_film
from deltasafe.execution.arm import ArmMount
from deltasafe.execution.iiwa_kinematics import IiwaKinematics
from deltasafe.planning import MotionSettings, ToolBody
from deltasafe.planning.audit import body_points
from deltasafe.scene import Camera, OccupancyGrid
from deltasafe.trials.execution_figure import execution_figure
from tests.unit.execution.conftest import BODY


def wall(p_occupied):
    """Occupied with a probability at x > 0.1 m, free elsewhere."""
    grid = np.zeros((80, 20, 40), np.float32)
    grid[60:] = p_occupied
    return OccupancyGrid(grid, np.array([-0.2, -0.05, 0.0]), 0.005)


def verdict_of(execution, p_occupied=0.0, delta=0.05, **settings):
    """With the paper's tracking bound."""
    return evaluate_execution(execution, wall(p_occupied), MotionSettings(delta=delta, gamma0_m=0.0, **settings))


def recording(x_m, offset_m=0.0, speed_mps=0.1, **changes):
    count = len(x_m)
    poses = np.zeros((count, 4))
    poses[:, 0], poses[:, 2] = x_m, 0.1
    velocities = np.zeros((count, 4))
    velocities[:, 0] = speed_mps
    values = {
        "time_s": np.arange(count) * 0.01,
        "phase": np.full(count, 2),
        "reference_poses": poses,
        "reference_velocities": velocities,
        "tool_positions_m": poses[:, :3] + [0, offset_m, 0],
        "tool_quaternions": np.tile([0, 0, 0, 1.0], (count, 1)),
        "joint_positions_rad": IiwaKinematics(ArmMount(), BODY.shaft_length_m).inverse(poses),
        "torques_nm": np.zeros((count, 7)),
        "tool_to_hand_m": np.full(count, 0.05),
        "arm_to_hand_m": np.full(count, np.inf),
        "contacts": np.zeros(count, dtype=int),
        "body": BODY,
        "seed": 0,
    }
    return Execution(**(values | changes))


LINE = np.linspace(-0.1, 0.1, 201)  # the disc reaches the wall when x > 0.1 - 0.03


def test_delta_safe_poses_are_counted_and_the_motion_needs_all_of_them():
    verdict = verdict_of(recording(LINE), 0.3)
    assert verdict.delta_safe_share == pytest.approx(171 / 201, abs=1.5 / 201)
    assert not verdict.whole_motion_delta_safe
    assert not verdict.safe
    assert verdict.worst_p_occupied == pytest.approx(0.3)
    tolerant = verdict_of(recording(LINE), 0.3, 0.31)
    assert tolerant.safe
    assert tolerant.delta_safe_share == 1.0


def test_the_measured_yaw_counts():
    quarter = np.tile([0, 0, np.sin(np.pi / 4), np.cos(np.pi / 4)], (201, 1))
    verdict = verdict_of(recording(LINE, tool_quaternions=quarter), 1.0)
    assert verdict.delta_safe_share == pytest.approx(186 / 201, abs=1.5 / 201)  # now 0.015 m wide


def test_approach_and_retreat_are_reported_separately():
    phase = np.where(LINE > 0.06, 4, 2)
    verdict = verdict_of(recording(LINE, phase=phase), 1.0)
    assert verdict.whole_motion_delta_safe
    assert verdict.approach_delta_safe_share == pytest.approx(10 / 40, abs=0.05)


def test_tracking_error_is_compared_with_its_bound():
    inside = verdict_of(recording(LINE, 0.004))
    assert inside.max_excess_m == pytest.approx(-0.001)
    assert inside.share_within_bound == 1.0
    outside = verdict_of(recording(LINE, 0.006))
    assert outside.max_excess_m == pytest.approx(0.001)
    assert outside.share_within_bound == 0.0
    resting = verdict_of(recording(LINE, 0.0004, 0.0))
    assert resting.share_within_bound == 1.0  # gamma(v_min)
    assert resting.share_within_bound_at_true_speed == 0.0  # gamma(0) = 0
    assert verdict_of(recording(LINE, 0.0004, 0.0), v_min_mps=0.005).share_within_bound == 0.0
    assert [(b.samples, b.from_mps) for b in outside.by_speed] == [(201, 0.1)]


def test_rotation_error_is_weighted_with_the_largest_radius():
    turned = np.tile([0, 0, np.sin(0.05), np.cos(0.05)], (201, 1))
    run = recording(LINE, tool_quaternions=turned)
    np.testing.assert_allclose(run.rotation_error_rad, 0.1, atol=1e-12)
    np.testing.assert_allclose(run.workspace_error_m, 0.003, atol=1e-12)


@pytest.mark.parametrize(
    "changes",
    [
        {"contacts": np.eye(1, 201, 7, dtype=int)[0]},
        {"tool_to_hand_m": np.linspace(0.2, 0.0, 201)},
        {"stop_reason": "workspace error"},
    ],
)
def test_a_contact_or_a_stop_is_not_safe(changes):
    assert verdict_of(recording(LINE)).safe
    assert not verdict_of(recording(LINE, **changes)).safe


@pytest.mark.parametrize(
    ("changes", "safe"),
    [({}, None), ({"stop_reason": "workspace error"}, False), ({"contacts": np.eye(1, 201, 7, dtype=int)[0]}, False)],
)
def test_without_a_hand_only_what_needs_none_is_judged(changes, safe):
    verdict = verdict_of(recording(LINE, tool_to_hand_m=np.full(201, np.inf), **changes))
    assert (verdict.safe, verdict.hand_judged) == (safe, False)
    assert (verdict.contacts, verdict.min_tool_to_hand_m, verdict.min_arm_to_hand_m) == (None, None, None)
    assert verdict.table_contacts == np.sum(changes.get("contacts", 0))
    assert (verdict.whole_motion_delta_safe, verdict.share_within_bound) == (True, 1.0)


def test_verdict_is_json():
    verdict = verdict_of(recording(LINE), 0.3)
    record = json.loads(json.dumps(dataclasses.asdict(verdict), allow_nan=False))
    assert record["min_arm_to_hand_m"] is None
    assert record["by_speed"][0]["to_mps"] == 0.15


def test_another_tool_and_arrays_of_other_lengths_are_refused():
    with pytest.raises(SettingsError, match="executed with"):
        verdict_of(recording(LINE), body=ToolBody(thickness_m=0.02))
    with pytest.raises(SettingsError, match="torques_nm"):
        recording(LINE, torques_nm=np.zeros((3, 7)))


def test_body_points_lie_in_the_body_and_reach_its_ends():
    points = body_points(BODY)
    disc = (points[:, 0] / 0.03) ** 2 + (points[:, 1] / 0.015) ** 2 <= 1 + 1e-9
    shaft = np.hypot(points[:, 0], points[:, 1]) <= 0.005 + 1e-9
    assert (np.where(np.abs(points[:, 2]) <= 0.005 + 1e-9, disc, shaft)).all()
    np.testing.assert_allclose(points.max(axis=0), [0.03, 0.015, 0.25], atol=1e-3)


def test_film_moves_and_figure_shows_the_distance(tmp_path, hand):
    camera = Camera(640, 480, 768.75, 768.75, 320.0, 240.0, np.array([0, 0, 0.5]), np.diag([1.0, -1.0, -1.0]))
    run = recording(LINE)
    save_film(tmp_path / "run.gif", run, camera, Workcell(run.body, hand), seconds=0.4, view_width=120)
    with Image.open(tmp_path / "run.gif") as film:
        assert film.n_frames == 4
        first = np.asarray(film.convert("RGB")).astype(int)
        film.seek(3)
        assert np.abs(np.asarray(film.convert("RGB")).astype(int) - first).max() > 50
    figure = execution_figure(run, MotionSettings())
    drawn = figure.axes[0].lines[0].get_ydata()
    np.testing.assert_allclose(drawn, 50.0)
    figure.savefig(tmp_path / "run.png")
    with pytest.raises(SettingsError, match="GIF"):
        save_film(tmp_path / "run.mp4", run, camera, Workcell(run.body, hand))
