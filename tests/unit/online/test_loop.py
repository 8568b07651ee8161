"""The loop in simulated time: it reaches the goal, any fault brings the arm to rest in time, and a log replays."""

import dataclasses
import pathlib
from collections.abc import Callable

import numpy as np
import pytest

from deltasafe.geometry import Pose
from deltasafe.online.decision_log import record_run, replay, same
from deltasafe.online.frames import Frame
from deltasafe.online.loop import OnlineLoop, Task
from deltasafe.online.moving_scene import MovingHand, SimulatedCamera
from deltasafe.online.settings import OnlineSettings
from deltasafe.online.simulation import KinematicArm, LiveRun, run_simulated
from deltasafe.planning import MotionSettings
from deltasafe.scene import Camera, FieldSettings
from evidence.online_audit import AuditResult, Driven, Tool, audit

CAMERA = Camera(80, 60, 96.0, 96.0, 40.0, 30.0, np.array([0.0, 0.0, 0.9]), np.diag([1.0, -1.0, -1.0]))
MOTION = MotionSettings(n_iterations=300, n_refinements=50)
SETTINGS = OnlineSettings(v_hand_mps=0.1)
TASK = Task(CAMERA, 0.0, 0.06, Pose(-0.15, 0.0, 0.05), Pose(0.15, 0.0, 0.05))
FAULT_S = 1.0


def camera_above(displacement: Callable[[float], np.ndarray]) -> SimulatedCamera:
    """A camera above a bright box that moves over a dark table."""
    x, y, z = np.meshgrid(np.linspace(-0.02, 0.02, 11), np.linspace(-0.12, -0.06, 16), [0.0, 0.03, 0.055])
    points = np.column_stack([x.ravel(), y.ravel(), z.ravel()])
    hand = MovingHand(points, np.full(points.shape, 220, np.uint8), displacement)
    return SimulatedCamera(hand, CAMERA, np.full((60, 80, 3), 40, np.uint8))


def bright(rgb: np.ndarray) -> np.ndarray:
    """Perception of that box: bright pixels and their neighbors."""
    mask = np.pad(rgb[:, :, 0] > 120, 2)
    reach = range(5)
    return np.max([mask[i : i + 60, j : j + 80] for i in reach for j in reach], axis=0).astype(np.float32)


def run(camera=None, perceive=bright, arm=None, clock=None, duration_s=8.0, note=None) -> tuple[LiveRun, OnlineLoop]:  # type: ignore[no-untyped-def]
    """One run; the hand rests beside the path unless the camera says otherwise."""
    camera = camera or camera_above(lambda time_s: np.zeros(2))
    loop = OnlineLoop(TASK, perceive, MOTION, SETTINGS, field=FieldSettings(voxel_m=0.015))
    arm = arm or KinematicArm(lambda v: float(MOTION.tracking.error_m(max(v, MOTION.v_min_mps))), 0)
    extra = {} if note is None else {"note": note(loop)}
    return run_simulated(loop, camera, arm, duration_s, clock=clock or (lambda t: t), **extra), loop


def audited(live: LiveRun, camera: SimulatedCamera) -> AuditResult:
    driven = Driven(live.time_s, live.reference, live.tool, live.speed_mps, live.captured_s)
    return audit(
        Tool(),
        driven,
        camera.hand.at,
        lambda age, v: SETTINGS.v_hand_mps * age + float(MOTION.tracking.error_m(max(v, 0.01))),
    )


def test_reaches_the_goal_and_the_audit_finds_nothing() -> None:
    camera = camera_above(lambda time_s: np.zeros(2))
    live, _ = run(camera)
    assert live.reached_goal
    np.testing.assert_allclose(live.reference[-1], TASK.goal.as_array(), atol=1e-6)
    found = audited(live, camera)
    assert found.contacts_moving == 0
    assert found.least_spare_m >= 0
    assert found.is_continuous


def test_a_hand_across_the_path_is_waited_for_or_passed_without_contact() -> None:
    camera = camera_above(lambda time_s: np.array([0.0, min(0.09, 0.1 * max(0.0, time_s - 1.2))]))
    live, _ = run(camera, duration_s=4.0)
    found = audited(live, camera)
    assert found.contacts_moving == 0
    assert found.least_spare_m >= 0
    assert {"brake", "rest"} & {decision.kind for decision in live.decisions if decision.now_s > FAULT_S}


class FaultyCamera:
    """Delivers good images until the fault begins."""

    def __init__(self, change: Callable[[Frame, float], Frame | None]) -> None:
        self._camera, self._change = camera_above(lambda time_s: np.zeros(2)), change
        self.last = self._camera.newest(FAULT_S)

    def newest(self, now_s: float) -> Frame | None:
        frame = self._camera.newest(now_s)
        return frame if now_s < FAULT_S or frame is None else self._change(frame, now_s)


def black(frame: Frame, now_s: float) -> Frame:
    return dataclasses.replace(frame, rgb=np.zeros_like(frame.rgb))


def frozen(frame: Frame, now_s: float) -> Frame:
    return dataclasses.replace(frame, rgb=np.full_like(frame.rgb, 40) + np.eye(60, 80, dtype=np.uint8)[..., None] * 99)


CAMERA_FAULTS: dict[str, tuple[Callable[[Frame, float], Frame | None], str]] = {
    "unplugged": (lambda frame, now_s: None, "s old"),
    "black": (black, "shows nothing"),
    "frozen": (frozen, "frozen"),
    "late": (lambda frame, now_s: dataclasses.replace(frame, captured_s=FAULT_S - 0.05), "s old"),
    "out of order": (lambda frame, now_s: dataclasses.replace(frame, captured_s=0.1), "older than the one before"),
    "from the future": (lambda frame, now_s: dataclasses.replace(frame, captured_s=now_s + 60), "ahead of the clock"),
    "no time": (lambda frame, now_s: dataclasses.replace(frame, captured_s=float("nan")), "time is nan"),
    "another size": (lambda frame, now_s: dataclasses.replace(frame, rgb=frame.rgb[:30]), "shape"),
}


def rests_in_time(live: LiveRun, reason: str, frames_may_age: bool) -> None:
    allowed_s = SETTINGS.stopping_time_s(MOTION.v_max_mps) + SETTINGS.cycle_s
    allowed_s += SETTINGS.max_frame_age_s if frames_may_age else 0.15  # the next image comes within a period
    assert live.is_moving[live.time_s < FAULT_S].any()
    assert not live.is_moving[live.time_s > FAULT_S + allowed_s].any()
    assert any(reason in decision.reason for decision in live.decisions), [d.reason for d in live.decisions][-3:]


@pytest.mark.parametrize("fault", CAMERA_FAULTS)
def test_a_fault_of_the_camera_brings_the_arm_to_rest_and_is_named(fault: str) -> None:
    change, reason = CAMERA_FAULTS[fault]
    live, _ = run(FaultyCamera(change), duration_s=2.2)
    rests_in_time(live, reason, frames_may_age=True)


def failing(rgb: np.ndarray) -> np.ndarray:
    raise RuntimeError("the network's process was killed")


@pytest.mark.parametrize(
    ("broken", "reason"),
    [
        (failing, "process was killed"),
        (lambda rgb: np.full(rgb.shape[:2], np.nan), "no probabilities"),
        (lambda rgb: np.full(rgb.shape[:2], 1.5), "no probabilities"),
    ],
)
def test_a_fault_of_perception_brings_the_arm_to_rest_and_is_named(
    broken: Callable[[np.ndarray], np.ndarray], reason: str
) -> None:
    count = iter(range(10**6))
    live, _ = run(perceive=lambda rgb: bright(rgb) if next(count) < 9 else broken(rgb), duration_s=2.2)
    rests_in_time(live, reason, frames_may_age=False)


class NanArm(KinematicArm):
    """Measures nothing after the fault."""

    def pose(self, reference: np.ndarray, speed_mps: float, time_s: float) -> np.ndarray:
        pose = super().pose(reference, speed_mps, time_s)
        return pose if time_s < FAULT_S else np.full(4, np.nan)


@pytest.mark.parametrize("step_s", [-5.0, 0.6, 3600.0])
def test_a_step_of_the_clock_brings_the_arm_to_rest_and_is_named(step_s: float) -> None:
    live, _ = run(clock=lambda t: t if t < FAULT_S else t + step_s, duration_s=2.2)
    rests_in_time(live, "clock advanced by -" if step_s < 0 else "off its reference", frames_may_age=False)


def test_nan_from_the_arm_and_a_push_stop_it_for_good() -> None:
    live, _ = run(arm=NanArm(lambda v: 0.0005, 0), duration_s=2.2)
    rests_in_time(live, "off its reference", frames_may_age=False)
    assert live.decisions[-1].kind == "stopped"


def test_a_log_replays_to_the_same_decisions(tmp_path: pathlib.Path) -> None:
    pytest.importorskip("mcap")
    camera = camera_above(lambda time_s: np.array([0.0, min(0.07, 0.1 * max(0.0, time_s - 1.0))]))
    log = tmp_path / "run.mcap"
    loop = OnlineLoop(TASK, bright, MOTION, SETTINGS, seed=3, field=FieldSettings(voxel_m=0.015))
    with record_run(log, loop, 0.0, 3) as note:
        arm = KinematicArm(lambda v: 0.001, 0)
        live = run_simulated(loop, camera, arm, 2.0, note=note)
    logged, again = replay(log)
    assert len(logged) == len(live.decisions) == len(again)
    assert all(map(same, logged, live.decisions))
    assert all(map(same, logged, again))
    assert {decision.kind for decision in again} >= {"follow"}


def test_the_newest_image_wins_and_none_queues_up() -> None:
    camera = camera_above(lambda time_s: np.zeros(2))
    seen: list[float] = []
    loop = OnlineLoop(TASK, bright, MOTION, SETTINGS, field=FieldSettings(voxel_m=0.015))
    for now_s in (0.3, 0.9):  # a loop that was held up takes the newest image, not the six between
        decision = loop.step(now_s, camera.newest(now_s), TASK.start.as_array())
        seen.append(decision.captured_s)
    assert seen == pytest.approx([0.2, 0.8])
