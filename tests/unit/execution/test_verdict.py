"""Verdicts on recordings made by hand, and what is drawn of them."""

import dataclasses
import json

import numpy as np
import pytest
from PIL import Image

from deltasafe.errors import SettingsError
from deltasafe.execution import Execution, FilmSettings, judge, save_film
from deltasafe.execution.kinematics import ArmMount, IiwaKinematics
from deltasafe.planning.audit import body_points
from deltasafe.planning.body import ToolBody
from deltasafe.planning.tracking_bound import TrackingBound
from deltasafe.scene.camera import Camera
from deltasafe.trials.execution_figure import execution_figure
from tests.unit.execution.conftest import BODY


class Wall:
    """Occupied with p at x > 0.1 m, free elsewhere."""

    def __init__(self, p_occupied):
        self.p_occupied = p_occupied

    def at(self, points_m):
        return np.where(points_m[:, 0] > 0.1, self.p_occupied, 0.0).astype(np.float32)


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


def test_share_of_safe_poses_is_counted_pointwise_and_the_whole_motion_jointly():
    verdict = judge(recording(LINE), Wall(0.3), BODY, 0.05, TrackingBound())
    assert verdict.delta_safe_share == pytest.approx(171 / 201, abs=1.5 / 201)
    assert not verdict.whole_motion_delta_safe
    assert not verdict.safe
    assert verdict.worst_p_occupied == pytest.approx(0.3)
    tolerant = judge(recording(LINE), Wall(0.3), BODY, 0.31, TrackingBound())
    assert tolerant.safe
    assert tolerant.delta_safe_share == 1.0


def test_yaw_counts():
    quarter = np.tile([0, 0, np.sin(np.pi / 4), np.cos(np.pi / 4)], (201, 1))
    verdict = judge(recording(LINE, tool_quaternions=quarter), Wall(1.0), BODY, 0.05, TrackingBound())
    assert verdict.delta_safe_share == pytest.approx(186 / 201, abs=1.5 / 201)  # now 0.015 m wide


def test_the_approach_is_reported_apart():
    phase = np.where(LINE > 0.06, 4, 2)
    verdict = judge(recording(LINE, phase=phase), Wall(1.0), BODY, 0.05, TrackingBound())
    assert verdict.whole_motion_delta_safe
    assert verdict.approach_delta_safe_share == pytest.approx(10 / 40, abs=0.05)


def test_tracking_against_its_bound():
    inside = judge(recording(LINE, 0.004), Wall(0.0), BODY, 0.05, TrackingBound())
    assert inside.max_excess_m == pytest.approx(-0.001)
    assert inside.share_within_bound == 1.0
    outside = judge(recording(LINE, 0.006), Wall(0.0), BODY, 0.05, TrackingBound())
    assert outside.max_excess_m == pytest.approx(0.001)
    assert outside.share_within_bound == 0.0
    resting = judge(recording(LINE, 0.0004, 0.0), Wall(0.0), BODY, 0.05, TrackingBound())
    assert resting.share_within_bound == 1.0  # read at min_speed_mps ...
    assert resting.share_within_bound_at_true_speed == 0.0  # ... since gamma(0) = 0
    assert [(b.samples, b.from_mps) for b in outside.by_speed] == [(201, 0.1)]


def test_rotation_error_counts_with_the_longest_arm():
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
def test_touching_or_stopping_is_not_safe(changes):
    assert judge(recording(LINE), Wall(0.0), BODY, 0.05, TrackingBound()).safe
    assert not judge(recording(LINE, **changes), Wall(0.0), BODY, 0.05, TrackingBound()).safe


def test_verdict_is_json():
    verdict = judge(recording(LINE), Wall(0.3), BODY, 0.05, TrackingBound())
    record = json.loads(json.dumps(dataclasses.asdict(verdict), allow_nan=False))
    assert record["min_arm_to_hand_m"] is None
    assert record["by_speed"][0]["to_mps"] == 0.15


def test_questions_without_an_answer_are_refused():
    with pytest.raises(SettingsError, match="delta"):
        judge(recording(LINE), Wall(0.3), BODY, 0.0, TrackingBound())
    with pytest.raises(SettingsError, match="executed with"):
        judge(recording(LINE), Wall(0.3), ToolBody(thickness_m=0.02), 0.1, TrackingBound())
    with pytest.raises(SettingsError, match="torques_nm"):
        recording(LINE, torques_nm=np.zeros((3, 7)))


def test_body_points_lie_in_the_body_and_reach_its_ends():
    points = body_points(BODY)
    disc = (points[:, 0] / 0.03) ** 2 + (points[:, 1] / 0.015) ** 2 <= 1 + 1e-9
    shaft = np.hypot(points[:, 0], points[:, 1]) <= 0.005 + 1e-9
    assert (np.where(np.abs(points[:, 2]) <= 0.005 + 1e-9, disc, shaft)).all()
    np.testing.assert_allclose(points.max(axis=0), [0.03, 0.015, 0.25], atol=1e-3)


def test_film_and_figure(tmp_path, hand):
    camera = Camera(640, 480, 768.75, 768.75, 320.0, 240.0, np.array([0, 0, 0.5]), np.diag([1.0, -1.0, -1.0]))
    run = recording(LINE)
    save_film(tmp_path / "run.gif", run, camera, hand, FilmSettings(0.4, 10, 120))
    with Image.open(tmp_path / "run.gif") as film:
        assert film.n_frames == 4
        first = np.asarray(film.convert("RGB")).astype(int)
        film.seek(3)
        assert np.abs(np.asarray(film.convert("RGB")).astype(int) - first).max() > 50  # something moved
    figure = execution_figure(run, TrackingBound())
    drawn = figure.axes[0].lines[0].get_ydata()
    np.testing.assert_allclose(drawn, 50.0)
    figure.savefig(tmp_path / "run.png")
    with pytest.raises(SettingsError, match="GIF"):
        save_film(tmp_path / "run.mp4", run, camera, hand)
