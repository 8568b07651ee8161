"""What stops the arm: a push, a load that the model does not know, a wrong place, a camera that no longer sees."""

import concurrent.futures
import dataclasses
import itertools
import multiprocessing

import numpy as np
import pytest

from deltasafe.errors import SettingsError, StaleImageError
from deltasafe.execution import (
    PHASES,
    CameraWatch,
    ExecutionSettings,
    FloatingTool,
    Payload,
    Push,
    execute,
    iiwa_for,
)
from deltasafe.execution.arm import ArmState
from deltasafe.execution.impedance import TaskReference
from deltasafe.execution.kinematics import IIWA14_LIMITS
from deltasafe.execution.monitor import Monitor
from deltasafe.planning import CheckSettings, DistanceField, body_clearance_m, is_segment_safe, segment_test
from deltasafe.planning.tracking_bound import TrackingBound
from deltasafe.scene import OccupancyGrid, Sphere, grid_from_shapes
from deltasafe.scene.image_stamp import ImageStamp
from tests.unit.execution.conftest import BODY, quintic

SETTINGS = ExecutionSettings(approach_m=0.02, settle_s=0.1)
ABOVE = quintic((-0.06, 0, 0.12, 0), (0.06, 0.03, 0.12, 0.8), 1.2)


def run(hand, *disturbances, seed=3, **options):
    return execute(ABOVE, hand, BODY, SETTINGS, seed, make_arm=iiwa_for(BODY, hand, 0.0, disturbances), **options)


def digest(hand):
    return run(hand, Push((60.0, 0.0, -40.0), 0.8, 0.05)).digest()


def stopped_at_s(execution):
    return float(execution.time_s[execution.phase == PHASES.index("stopped")][0])


def at_rest_from_s(execution):
    speed = np.linalg.norm(np.gradient(execution.tool_positions_m, execution.time_s, axis=0), axis=1)
    return float(execution.time_s[np.flatnonzero(speed > 0.005)[-1]])


def test_without_disturbances_nothing_is_stopped(hand):
    for seed in range(3):
        assert run(hand, seed=seed).completed


@pytest.mark.parametrize(
    ("link", "force_n"), [(8, (0.0, 0.0, -80.0)), (7, (100.0, 0.0, 0.0)), (4, (0.0, -150.0, -150.0))]
)
def test_a_push_stops_the_arm_before_the_hand_is_reached(hand, link, force_n):
    pushed = run(hand, Push(force_n, 1.0, 0.1, link))
    assert "workspace error" in pushed.stop_reason or "times as fast" in pushed.stop_reason
    assert stopped_at_s(pushed) - 1.0 <= 0.1
    assert at_rest_from_s(pushed) - stopped_at_s(pushed) <= 0.1
    assert pushed.contacts.sum() == 0
    assert pushed.tool_to_hand_m.min() > 0.02
    still = pushed.tool_positions_m[pushed.time_s > at_rest_from_s(pushed) + 0.05]
    assert np.ptp(still, axis=0).max() < 1e-3


def test_a_light_touch_is_borne(hand):
    assert run(hand, Push((2.0, 0.0, 0.0), 1.0, 0.05, 8)).completed


def test_a_payload_that_the_model_does_not_know_stops_the_arm_and_the_brakes_hold_it(hand):
    loaded = run(hand, Payload(3.0))
    assert "workspace error" in loaded.stop_reason
    assert stopped_at_s(loaded) <= 0.2
    heights = loaded.tool_positions_m[:, 2]
    assert heights[0] - heights[-1] < 0.01  # 3 kg on 5000 N/m would sag by 6 mm and more, and go on after a hold
    late = heights[loaded.time_s > stopped_at_s(loaded) + 0.1]
    assert np.ptp(late) < 1e-4
    assert loaded.tool_to_hand_m.min() > 0.02


def test_leaving_what_is_known_to_be_free_stops_the_arm_within_its_tracking_bound():
    """The bound allows 20 mm, a push moves the tool by 8 mm, and 5 mm beside its path something may be."""
    free = np.zeros((200, 120, 60), np.float32)
    walled, wall_m = free.copy(), BODY.semi_axis_y_m + 0.005
    walled[:, round((wall_m + 0.12) / 0.002) :] = 1.0
    straight = quintic((-0.06, 0, 0.07, 0), (0.06, 0, 0.07, 0), 1.2)
    bound, push = TrackingBound(0.02, 0.0), Push((0.0, 40.0, 0.0), 0.9, 0.4, 8)

    def go(p_occupied, *disturbances):
        field = DistanceField.build(OccupancyGrid(p_occupied, np.array([-0.2, -0.12, 0.0]), 0.002), 0.05)
        make_arm = iiwa_for(BODY, None, 0.0, disturbances)
        return execute(straight, None, BODY, SETTINGS, 3, bound=bound, field=field, make_arm=make_arm)

    assert go(free, push).completed
    assert go(walled).completed
    stopped = go(walled, push)
    assert "not known to be free" in stopped.stop_reason
    assert stopped.tool_positions_m[:, 1].max() + BODY.semi_axis_y_m < wall_m + 0.01  # 30 ms until the brakes hold


def test_where_the_planner_may_go_the_monitor_stops_nothing_and_no_farther_than_the_margin():
    """The planner's test shows more than the bound of a single pose does: both count, and the truth limits them."""
    grid = grid_from_shapes([Sphere((0, 0, 0.05), 0.02)], 0.01, (-0.1, -0.1, 0.0), (0.1, 0.1, 0.12), 0.005)
    field, bound, limits = DistanceField.build(grid, 0.05), TrackingBound(0.002, 0.0), IIWA14_LIMITS
    planned = segment_test(field, BODY, 0.002, CheckSettings())
    monitor = Monitor(bound, dataclasses.replace(SETTINGS, monitor_margin_m=0.05), limits, BODY, field, None)
    rng, only_by_the_test, zero = np.random.default_rng(0), 0, np.zeros(7)
    times = itertools.count()
    for _ in range(3000):
        x, y, z = rng.uniform((-0.07, -0.07, 0.03), (0.07, 0.07, 0.1))
        pose = np.array([x, y, z, 0.0])
        if not is_segment_safe(planned, pose, pose):
            continue
        target = TaskReference(pose[:3], np.array([0.0, 0.0, 0.0, 1.0]), np.zeros(6), np.zeros(6), zero, zero)
        away_m = rng.normal(size=3)
        away_m *= 0.0019 / np.linalg.norm(away_m)
        for offset_m in (np.zeros(3), away_m):
            state = ArmState(zero, zero, pose[:3] + offset_m, target.quaternion)
            assert monitor.violation(float(next(times)), state, target, is_planned=True) == "", (pose, offset_m)
            only_by_the_test += float(body_clearance_m(planned, (pose + np.append(offset_m, 0))[None])[0]) < 0
    assert only_by_the_test > 10


def sighting(number, taken_s):
    return ImageStamp.of(np.full((2, 2, 3), number, np.uint8), taken_s)


def watch(newest, starts_s=10.0):
    def go(hand, **changes):
        settings = dataclasses.replace(SETTINGS, **changes)
        camera = CameraWatch(newest, sighting(0, 8.0), starts_s)
        return execute(ABOVE, hand, BODY, settings, 0, camera=camera, make_arm=lambda seed: FloatingTool())

    return go


def live(now_s):
    frame = int(now_s * 20)
    return sighting(frame % 251 + 1, frame / 20)


def test_a_live_camera_changes_nothing(hand):
    seen = watch(live)(hand)
    assert seen.completed
    plain = execute(ABOVE, hand, BODY, SETTINGS, 0, make_arm=lambda seed: FloatingTool())
    assert seen.digest() == plain.digest()


def test_a_camera_that_repeats_an_image_stops_the_arm(hand):
    frozen = watch(lambda now_s: live(now_s) if now_s < 11.0 else sighting(77, int(now_s * 20) / 20))(hand)
    assert "frozen" in frozen.stop_reason
    assert 1.0 <= stopped_at_s(frozen) <= 1.15


def test_a_camera_that_delivers_no_more_stops_the_arm(hand):
    dead = watch(lambda now_s: live(min(now_s, 11.0)))(hand, max_frame_age_s=0.2)
    assert "old" in dead.stop_reason
    assert 1.2 <= stopped_at_s(dead) <= 1.25


def test_an_arm_does_not_start_on_an_old_image_or_beside_a_frozen_camera(hand):
    with pytest.raises(StaleImageError, match=r"2\.0 s old, 1 s are allowed"):
        watch(live)(hand, max_look_age_s=1.0)
    with pytest.raises(StaleImageError, match="restart the camera"):
        watch(lambda now_s: sighting(0, now_s))(hand)
    with pytest.raises(StaleImageError, match="camera's newest image is 2"):
        watch(lambda now_s: sighting(0, 8.0))(hand)


def test_the_same_seed_gives_the_same_digest_in_three_processes(hand):
    context = multiprocessing.get_context("spawn")
    digests = set()
    for _ in range(3):
        with concurrent.futures.ProcessPoolExecutor(1, mp_context=context) as pool:
            digests.add(pool.submit(digest, hand).result())
    assert digests == {digest(hand)}


def test_disturbances_are_validated():
    for wrong in (
        lambda: Push((1.0, 0.0), 0.0, 1.0),
        lambda: Push((1.0, 0.0, 0.0), -1.0, 1.0),
        lambda: Push((1.0, 0.0, 0.0), 0.0, 0.0),
        lambda: Push((1.0, 0.0, 0.0), 0.0, 1.0, 9),
        lambda: Payload(0.0),
        lambda: ImageStamp("abc"),
        lambda: ExecutionSettings(brake_delay_s=-1),
        lambda: ExecutionSettings(max_frame_age_s=0),
    ):
        with pytest.raises(SettingsError):
            wrong()
