"""What stops the arm: pushes, unknown payloads, lost clearance, invalid measurements, a dead camera."""

import concurrent.futures
import dataclasses
import itertools
import multiprocessing

import numpy as np
import pytest

from deltasafe.errors import PlanningError, SettingsError, StaleImageError
from deltasafe.execution import (
    PHASES,
    CameraWatch,
    ExecutionSettings,
    MonitorLimits,
    Workcell,
    execute,
)
from deltasafe.execution.arm import ArmState
from deltasafe.execution.iiwa_kinematics import IIWA14_LIMITS
from deltasafe.execution.impedance import TaskReference
from deltasafe.execution.monitor import Monitor
from deltasafe.planning import (
    CheckSettings,
    DistanceField,
    MotionSettings,
    is_segment_safe,
    segment_test,
)
from deltasafe.planning.tracking_bound import TrackingBound
from deltasafe.scene import OccupancyGrid, Sphere, grid_from_shapes
from deltasafe.scene.image_stamp import ImageStamp
from tests.unit.execution.conftest import BODY, quintic
from tests.unit.execution.disturbed_arm import Push, disturbed
from tests.unit.execution.floating_tool import FloatingTool

SETTINGS = ExecutionSettings(approach_m=0.02, settle_s=0.1)
ABOVE = quintic((-0.06, 0, 0.12, 0), (0.06, 0.03, 0.12, 0.8), 1.2)


def run(hand, push=None, payload_kg=0.0, seed=3, **options):
    return execute(ABOVE, disturbed(BODY, hand, push, payload_kg), SETTINGS, seed, **options)


def run_with(arm, hand, settings=SETTINGS, **limits):
    cell = Workcell(BODY, hand, make_arm=lambda seed: arm)
    return execute(ABOVE, cell, settings, 0, limits=MonitorLimits(**limits))


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


def test_a_light_push_is_tolerated(hand):
    assert run(hand, Push((2.0, 0.0, 0.0), 1.0, 0.05, 8)).completed


def test_an_unknown_payload_stops_the_arm_and_the_brakes_hold_it(hand):
    loaded = run(hand, payload_kg=3.0)
    assert "workspace error" in loaded.stop_reason
    assert stopped_at_s(loaded) <= 0.2
    heights = loaded.tool_positions_m[:, 2]
    assert heights[0] - heights[-1] < 0.01  # without brakes 3 kg on 5000 N/m sag by 6 mm
    late = heights[loaded.time_s > stopped_at_s(loaded) + 0.1]
    assert np.ptp(late) < 1e-4
    assert loaded.tool_to_hand_m.min() > 0.02


def test_lost_clearance_stops_the_arm_within_its_tracking_bound():
    """The bound allows 20 mm, a push moves the tool by 8 mm, and a wall stands 5 mm beside the path."""
    free = np.zeros((200, 120, 60), np.float32)
    walled, wall_m = free.copy(), BODY.semi_axis_y_m + 0.005
    walled[:, round((wall_m + 0.12) / 0.002) :] = 1.0
    straight = quintic((-0.06, 0, 0.07, 0), (0.06, 0, 0.07, 0), 1.2)
    bound, push = TrackingBound(0.02, 0.0), Push((0.0, 40.0, 0.0), 0.9, 0.4, 8)

    def go(p_occupied, push=None):
        field = DistanceField.build(OccupancyGrid(p_occupied, np.array([-0.2, -0.12, 0.0]), 0.002), 0.05)
        return execute(straight, disturbed(BODY, push=push), SETTINGS, 3, limits=MonitorLimits(bound, field=field))

    assert go(free, push).completed
    assert go(walled).completed
    stopped = go(walled, push)
    assert "not known to be free" in stopped.stop_reason
    assert stopped.tool_positions_m[:, 1].max() + BODY.semi_axis_y_m < wall_m + 0.01  # 30 ms until the brakes hold


def test_poses_that_the_planner_accepts_are_not_stopped_within_the_margin():
    grid = grid_from_shapes([Sphere((0, 0, 0.05), 0.02)], 0.01, (-0.1, -0.1, 0.0), (0.1, 0.1, 0.12), 0.005)
    field = DistanceField.build(grid, 0.05)
    planned = segment_test(field, BODY, 0.002, CheckSettings())
    limits, settings = MonitorLimits(TrackingBound(0.002, 0.0), field=field), ExecutionSettings(monitor_margin_m=0.05)
    monitor = Monitor(limits, settings, IIWA14_LIMITS, BODY)
    rng, accepted, zero = np.random.default_rng(0), 0, np.zeros(7)
    times = itertools.count()
    for _ in range(3000):
        x, y, z = rng.uniform((-0.07, -0.07, 0.03), (0.07, 0.07, 0.1))
        pose = np.array([x, y, z, 0.0])
        if not is_segment_safe(planned, pose, pose):
            continue
        target = TaskReference(pose[:3], np.array([0.0, 0.0, 0.0, 1.0]), np.zeros(6), np.zeros(6), zero, zero)
        error_m = rng.normal(size=3)
        error_m *= 0.0019 / np.linalg.norm(error_m)
        for offset_m in (np.zeros(3), error_m):
            state = ArmState(zero, zero, pose[:3] + offset_m, target.quaternion)
            assert monitor.violation(float(next(times)), state, target, is_planned=True) == "", (pose, offset_m)
            accepted += 1
    assert accepted > 100


SOUND = ArmState(np.zeros(7), np.zeros(7), np.array([0.0, 0.0, 0.12]), np.array([0.0, 0.0, 0.0, 1.0]))
TARGET = TaskReference(SOUND.tool_position_m, SOUND.tool_quaternion, np.zeros(6), np.zeros(6), np.zeros(7), np.zeros(7))
EMPTY = DistanceField.build(OccupancyGrid(np.zeros((80, 80, 20), np.float32), np.array([-0.2, -0.2, 0.0]), 0.005), 0.05)


def monitor_with(field=None, bound=None):
    return Monitor(MonitorLimits(bound or TrackingBound(), field=field), SETTINGS, IIWA14_LIMITS, BODY)


def with_value(record, name, place, value):
    changed = getattr(record, name).copy()
    changed[place] = value
    return dataclasses.replace(record, **{name: changed})


@pytest.mark.parametrize("field", [None, EMPTY], ids=["no field", "field"])
@pytest.mark.parametrize("bound", [TrackingBound(), TrackingBound(1e300)], ids=["bound", "no bound"])
@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf, 1e300])
@pytest.mark.parametrize("name", [field.name for field in dataclasses.fields(ArmState)])
def test_a_nonfinite_measurement_stops(name, value, bound, field):
    assert monitor_with(field, bound).violation(0.0, SOUND, TARGET, is_planned=True) == ""
    for place in range(len(getattr(SOUND, name))):
        broken = with_value(SOUND, name, place, value)
        if name == "joint_positions_rad" and np.isfinite(value):  # the monitor does not watch joint ranges
            continue
        assert monitor_with(field, bound).violation(0.0, broken, TARGET, is_planned=True), (name, place)


@pytest.mark.parametrize("quaternion", [(0.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 2.0)])
def test_a_measured_quaternion_without_unit_norm_stops(quaternion):
    """All zeros, which many sensors deliver after a fault, have no rotation error."""
    state = dataclasses.replace(SOUND, tool_quaternion=np.array(quaternion))
    assert "not a unit quaternion" in monitor_with().violation(0.0, state, TARGET, is_planned=True)


@pytest.mark.parametrize(("name", "value"), [("position_m", np.nan), ("quaternion", np.nan), ("twist", np.inf)])
def test_a_nonfinite_target_stops(name, value):
    target = with_value(TARGET, name, 0, value)
    assert monitor_with(EMPTY).violation(0.0, SOUND, target, is_planned=True)


@pytest.mark.parametrize("time_s", [np.nan, np.inf, -np.inf, 0.5, 1.0])
def test_a_clock_that_does_not_advance_stops(time_s):
    monitor = monitor_with()
    assert monitor.violation(1.0, SOUND, TARGET, is_planned=True) == ""
    assert "clock" in monitor.violation(time_s, SOUND, TARGET, is_planned=True)


class BrokenSensor(FloatingTool):
    """Measures a constant for ``for_steps`` from the given step on."""

    def __init__(self, name, value, step, for_steps=10**9):
        super().__init__()
        self._broken = name, value, step, step + for_steps
        self._step, self.braked_at = -1, None

    def reset(self, joint_positions_rad):
        super().reset(joint_positions_rad)
        self._step = -1

    def step(self, torques_nm):
        assert np.isfinite(torques_nm).all()
        return super().step(torques_nm)

    def brake(self):
        self.braked_at = self._step if self.braked_at is None else self.braked_at
        super().brake()

    def state(self):
        self._step += 1
        name, value, begin, end = self._broken
        state = super().state()
        return with_value(state, name, 0, value) if begin <= self._step < end else state


@pytest.mark.parametrize("field", [None, EMPTY], ids=["no field", "field"])
@pytest.mark.parametrize("name", [field.name for field in dataclasses.fields(ArmState)])
@pytest.mark.parametrize(("step", "for_steps"), [(900, 10**9), (900, 1), (1, 10**9), (0, 10**9)])
def test_nan_from_a_sensor_stops_the_arm_at_once(hand, name, step, for_steps, field):
    arm = BrokenSensor(name, np.nan, step + (step > 0), for_steps)
    if step == 0:
        with pytest.raises(PlanningError, match="cannot start"):
            run_with(arm, hand, field=field)
        return
    stopped = run_with(arm, hand, field=field)
    assert "not finite" in stopped.stop_reason
    assert arm.braked_at <= step + 1 + SETTINGS.brake_delay_s / arm.control_period_s
    assert np.isfinite(stopped.tool_positions_m).all()
    assert np.ptp(stopped.tool_positions_m[stopped.time_s > (step + 40) * arm.control_period_s], axis=0).max() < 1e-3


def test_a_model_without_finite_torques_stops_the_arm(hand):
    class NoModel(FloatingTool):
        def dynamics(self, state):
            model = super().dynamics(state)
            return model._replace(bias_nm=np.full(6, np.nan)) if state.tool_position_m[0] > 0 else model

    stopped = run_with(NoModel(), hand)
    assert "no torques" in stopped.stop_reason
    assert np.isfinite(stopped.torques_nm).all()


def test_a_nonfinite_height_is_refused(hand):
    with pytest.raises(SettingsError, match="unsafe_below_m"):
        run(hand, unsafe_below_m=float("nan"))


def test_a_recording_refuses_nan(hand):
    with pytest.raises(SettingsError, match="tool_positions_m must be finite"):
        with_value(run_with(FloatingTool(), hand), "tool_positions_m", 0, np.nan)


@pytest.mark.parametrize("v_min_mps", [0.0, -0.01, np.nan, np.inf])
def test_limits_without_a_positive_v_min_are_refused(v_min_mps):
    with pytest.raises(SettingsError, match="v_min_mps"):
        MonitorLimits(v_min_mps=v_min_mps)


def test_limits_of_a_motion_are_those_of_its_settings():
    settings = MotionSettings(gamma0_m=0.002, gamma1_s=0.01, v_min_mps=0.03)
    limits = MonitorLimits.of(settings, EMPTY)
    assert (limits.tracking, limits.v_min_mps, limits.field) == (TrackingBound(0.002, 0.01), 0.03, EMPTY)


def test_the_bound_is_evaluated_at_v_min_at_rest():
    state = dataclasses.replace(SOUND, tool_position_m=np.array([0.0019, 0.0, 0.12]))
    for v_min_mps, stops in ((0.01, True), (0.02, False)):  # gamma and the margin allow 1.5 mm and 2 mm
        monitor = Monitor(MonitorLimits(v_min_mps=v_min_mps), SETTINGS, IIWA14_LIMITS, BODY)
        assert bool(monitor.violation(0.0, state, TARGET, is_planned=True)) == stops


def stamp_of(number, taken_s):
    return ImageStamp.of(np.full((2, 2, 3), number, np.uint8), taken_s)


def watch(newest, starts_s=10.0):
    def go(hand, **changes):
        camera = CameraWatch(newest, stamp_of(0, 8.0), starts_s)
        return run_with(FloatingTool(), hand, dataclasses.replace(SETTINGS, **changes), camera=camera)

    return go


def live(now_s):
    frame = int(now_s * 20)
    return stamp_of(frame % 251 + 1, frame / 20)


def test_a_live_camera_changes_nothing(hand):
    watched = watch(live)(hand)
    assert watched.completed
    assert watched.digest() == run_with(FloatingTool(), hand).digest()


def test_a_camera_that_repeats_an_image_stops_the_arm(hand):
    frozen = watch(lambda now_s: live(now_s) if now_s < 11.0 else stamp_of(77, int(now_s * 20) / 20))(hand)
    assert "frozen" in frozen.stop_reason
    assert 1.0 <= stopped_at_s(frozen) <= 1.15


def test_a_dead_camera_stops_the_arm(hand):
    dead = watch(lambda now_s: live(min(now_s, 11.0)))(hand, max_frame_age_s=0.2)
    assert "old" in dead.stop_reason
    assert 1.2 <= stopped_at_s(dead) <= 1.25


def test_an_arm_does_not_start_with_an_old_image_or_a_frozen_camera(hand):
    with pytest.raises(StaleImageError, match=r"2\.0 s old, 1 s are allowed"):
        watch(live)(hand, max_look_age_s=1.0)
    with pytest.raises(StaleImageError, match="restart the camera"):
        watch(lambda now_s: stamp_of(0, now_s))(hand)
    with pytest.raises(StaleImageError, match="camera's newest image is 2"):
        watch(lambda now_s: stamp_of(0, 8.0))(hand)


UNIX_S = 1.7e9


@pytest.mark.parametrize("starts_s", [0.0, 7.9, np.nan, np.inf, -np.inf])
def test_an_arm_does_not_start_with_an_image_from_the_future(hand, starts_s):
    """Unix time beside a clock that starts at 0: the age is negative, and never exceeds its limit."""
    with pytest.raises(StaleImageError, match=r"camera's clock|old"):
        watch(live, starts_s)(hand)


def test_an_arm_does_not_start_if_the_camera_clock_is_ahead(hand):
    with pytest.raises(StaleImageError, match=r"ahead of the clock.*by the camera's clock"):
        watch(lambda now_s: live(now_s + UNIX_S))(hand)


def test_a_camera_clock_that_jumps_ahead_stops_the_arm(hand):
    jumped = watch(lambda now_s: live(now_s if now_s < 11.0 else now_s + 10.0))(hand)
    assert "ahead of the clock" in jumped.stop_reason
    assert 1.0 <= stopped_at_s(jumped) <= 1.02


def test_clocks_that_differ_by_milliseconds_are_tolerated(hand):
    assert watch(lambda now_s: live(now_s + 0.04))(hand).completed


def test_frozen_stamps_stop_the_arm(hand):
    frames = itertools.count(1)
    frozen = watch(lambda now_s: live(now_s) if now_s < 11.0 else stamp_of(next(frames) % 251, 11.0))(hand)
    assert "old" in frozen.stop_reason
    assert 1.5 <= stopped_at_s(frozen) <= 1.52


@pytest.mark.parametrize("stamp", [np.nan, np.inf, -np.inf])
def test_a_nonfinite_stamp_stops_the_arm(hand, stamp):
    with pytest.raises(StaleImageError, match="unusable"):
        watch(lambda now_s: stamp_of(1, stamp))(hand)
    broken = watch(lambda now_s: live(now_s) if now_s < 11.0 else stamp_of(1, stamp))(hand)
    assert "taken_s must be a finite time" in broken.stop_reason


def test_the_same_seed_gives_the_same_digest_in_three_processes(hand):
    context = multiprocessing.get_context("spawn")
    digests = set()
    for _ in range(3):
        with concurrent.futures.ProcessPoolExecutor(1, mp_context=context) as pool:
            digests.add(pool.submit(digest, hand).result())
    assert digests == {digest(hand)}


def test_invalid_settings_are_refused():
    for wrong in (
        lambda: ImageStamp("abc"),
        lambda: ExecutionSettings(brake_delay_s=-1),
        lambda: ExecutionSettings(max_frame_age_s=0),
    ):
        with pytest.raises(SettingsError):
            wrong()
