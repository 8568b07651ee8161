"""The loop: newest image -> p_occupied -> growing unsafe set -> verify, follow, plan again or brake -> reference."""

import dataclasses
import math
import time
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from deltasafe.geometry import Pose, wrap_to_pi
from deltasafe.online.committed import Committed, TimedPath
from deltasafe.online.frames import Frame, FrameCheck
from deltasafe.online.moving_set import MovingSet
from deltasafe.online.replanning import Replanner, is_blocked
from deltasafe.online.settings import OnlineSettings
from deltasafe.online.supervisor import Outcome, Supervisor
from deltasafe.planning import MotionSettings
from deltasafe.scene import Camera, FieldSettings, grid_from_image

Array = NDArray[np.float64]
Perception = Callable[[NDArray[np.uint8]], NDArray[np.float32]]
"""Maps an image (H, W, 3) uint8 to p_occupied (H, W)."""

AT_GOAL = 1e-6
LEVELS = 255
"""p_occupied is rounded up to multiples of 1 / 255 before it is used: a log of bytes then replays exactly."""


@dataclasses.dataclass(frozen=True)
class Task:
    """What the loop does: a motion from start to goal under a camera.

    Attributes:
        camera: that takes the images.
        table_z_m: height of the table.
        hand_height_m: greatest height of the hand above the table at the time of an image.
        start, goal: poses of the tool.
    """

    camera: Camera
    table_z_m: float
    hand_height_m: float
    start: Pose
    goal: Pose


@dataclasses.dataclass(frozen=True)
class Observation:
    """A new image as the loop uses it: p_occupied (H, W) in units of 1 / 255, or None and the defect."""

    captured_s: float
    p_occupied: NDArray[np.uint8] | None
    defect: str = ""


@dataclasses.dataclass(frozen=True)
class Decision:
    """What a cycle decided.

    Attributes:
        now_s: begin of the cycle.
        kind: ``follow`` (a piece was committed), ``brake`` (the last braking trajectory runs), ``rest`` (no motion is
            safe or planned now), ``goal`` or ``stopped`` (at rest after a fault that needs a person).
        reason: why the arm does not follow its path at full rate; may be empty.
        rate: target rate of the committed piece.
        plan: number of the path; 0 without one.
        planned: whether a new path was planned in this cycle.
        captured_s: of the image that was used; NaN without one.
    """

    now_s: float
    kind: str
    reason: str
    rate: float
    plan: int
    planned: bool
    captured_s: float


class OnlineLoop:
    """Decides once per control cycle. Deterministic: equal inputs give equal decisions.

    Attributes:
        p_occupied: (H, W) of the newest usable image; None before the first one.
        timing_ms: duration of the last ``perception``, ``field`` and ``motion``.

    Args:
        task: camera and motion.
        perceive: image -> p_occupied.
        motion: delta, tool, tracking bound, search and speed limits.
        settings: of the loop.
        now_s: control's clock at the start; the arm rests at the start pose.
        seed: of the search.
        field: resolution of the occupancy grid.
    """

    def __init__(
        self,
        task: Task,
        perceive: Perception,
        motion: MotionSettings,
        settings: OnlineSettings,
        now_s: float = 0.0,
        seed: int = 0,
        field: FieldSettings | None = None,
    ) -> None:
        self.task, self.motion, self.settings = task, motion, settings
        self.p_occupied: NDArray[np.uint8] | None = None
        self.timing_ms: dict[str, float] = {}
        self._perceive, self.field = perceive, field or FieldSettings(voxel_m=0.005)
        self._supervisor = Supervisor(task.start.as_array(), now_s, motion.tracking, motion.v_min_mps, settings)
        self._check = FrameCheck(task.camera.height, task.camera.width, settings.max_ahead_s)
        self._replanner = Replanner(task.goal, motion, settings, seed)
        self._least_m = float(motion.tracking.error_m(motion.v_min_mps))
        self._set: MovingSet | None = None
        self._frame_defect = "no image has arrived"
        self._path: TimedPath | None = None
        self._resting_cycles = settings.patience_cycles
        self._previous_s, self._stopped = now_s - settings.cycle_s, ""

    @property
    def committed(self) -> Committed:
        """The reference of the arm, which ends at rest."""
        return self._supervisor.committed

    def step(self, now_s: float, frame: Frame | None, tool_pose: Array) -> Decision:
        """Take the newest image and the measured pose of the tool (4,) at the begin of a cycle, and decide."""
        return self.decide(now_s, self.observe(now_s, frame), tool_pose)

    def observe(self, now_s: float, frame: Frame | None) -> Observation | None:
        """Turn a new image into p_occupied, or say why it is unusable; None: there is no new image."""
        if frame is None or not self._check.is_new(frame):
            return None
        began_s = time.perf_counter()
        defect = self._check.defect(frame, now_s)
        if defect:
            return Observation(frame.captured_s, None, defect)
        try:
            p_occupied = np.asarray(self._perceive(frame.rgb), dtype=np.float64)
        except Exception as error:  # whatever perception raises must brake the arm, not end the loop
            return Observation(frame.captured_s, None, f"perception failed: {type(error).__name__}: {error}")
        if p_occupied.shape != frame.rgb.shape[:2] or not (p_occupied.min() >= 0 and p_occupied.max() <= 1):
            return Observation(frame.captured_s, None, "perception gave no probabilities")  # NaN fails as well
        self.timing_ms["perception"] = 1000 * (time.perf_counter() - began_s)
        return Observation(frame.captured_s, np.ceil(p_occupied * LEVELS - 1e-6).astype(np.uint8))

    def decide(self, now_s: float, observation: Observation | None, tool_pose: Array) -> Decision:
        """Decide from an observation; equal observations, poses and times give equal decisions."""
        passed_s, self._previous_s = now_s - self._previous_s, now_s
        if observation is not None:
            self._frame_defect = observation.defect
            if observation.p_occupied is not None:
                self._use(observation.p_occupied, observation.captured_s)
        if not passed_s > 0:
            self._stopped = self._stopped or f"the control's clock advanced by {passed_s:.3f} s in a cycle"
        self._stopped = self._stopped or self._arm_fault(now_s, tool_pose)
        late_s = passed_s - self.settings.cycle_s
        late = f"the cycle came {late_s:.3f} s late" if late_s > self.settings.clock_tolerance_s else ""
        defect = self._stopped or self._frame_defect or late or self._too_old(now_s)
        if self._set is None or defect:
            return self._halted(now_s, defect)
        began_s = time.perf_counter()
        decision = self._motion(now_s, self._set)
        self.timing_ms["motion"] = 1000 * (time.perf_counter() - began_s)
        return decision

    def _motion(self, now_s: float, moving_set: MovingSet) -> Decision:
        start_s = now_s + self.settings.cycle_s
        pose, _ = self.committed.at(start_s)
        rests = not self.committed.is_moving_at(start_s)
        if rests and self._is_goal(pose):
            return self._decision(now_s, "goal", "")
        blocked, planned, reason = False, False, ""
        if self._path is not None:
            blocked = is_blocked(self._path, self.committed, now_s, moving_set, self._least_m)
            reason = "the rest of the path is no longer clear" if blocked else ""
        patient = self._resting_cycles < self.settings.patience_cycles
        if rests and (blocked or not patient):
            self._resting_cycles, planned = 0, True
            self._path, reason = self._replanner.plan(Pose(*map(float, pose)), moving_set)
            blocked = False
        outcome = Outcome(0.0, None)
        if not blocked:
            outcome = self._supervisor.advance(now_s, moving_set, self._path)
        if outcome.refusal is not None:
            missing_mm = 1000 * outcome.refusal.missing_m
            after_s = outcome.refusal.time_s - now_s
            reason = f"{missing_mm:.1f} mm of clearance are missing {after_s:.2f} s ahead, if the hand comes nearer"
        rests &= outcome.target == 0.0
        self._resting_cycles = self._resting_cycles + 1 if rests else 0
        kind = "follow" if outcome.target else "rest" if rests else "brake"
        return self._decision(now_s, kind, reason, outcome.target, planned)

    def _use(self, p_occupied: NDArray[np.uint8], captured_s: float) -> None:
        began_s = time.perf_counter()
        task, settings, motion = self.task, self.settings, self.motion
        image = p_occupied.astype(np.float32) / np.float32(LEVELS)
        ends = task.start, task.goal
        grid = grid_from_image(image, task.camera, task.table_z_m, task.hand_height_m, self.field, ends)
        self.p_occupied = p_occupied
        self._set = MovingSet(
            grid, motion.delta, captured_s, settings.v_hand_mps, settings.margin_m, motion.body, settings.reach_m
        )
        self.timing_ms["field"] = 1000 * (time.perf_counter() - began_s)

    def _too_old(self, now_s: float) -> str:
        if self._set is None:
            return ""
        age_s, most_s = now_s - self._set.captured_s, self.settings.max_frame_age_s
        return "" if age_s <= most_s else f"the newest image is {age_s:.2f} s old, {most_s:g} s are allowed"

    def _arm_fault(self, now_s: float, tool_pose: Array) -> str:
        reference, speed_mps = self.committed.at(now_s)
        difference = np.asarray(tool_pose, dtype=np.float64) - reference
        error_m = float(np.linalg.norm(difference[:3]) + self.motion.body.rho_max_m * abs(wrap_to_pi(difference[3])))
        bound_m = float(self.motion.tracking.error_m(max(speed_mps, self.motion.v_min_mps)))
        if error_m <= bound_m + self.settings.monitor_margin_m:
            return ""
        return f"the arm is {1000 * error_m:.1f} mm off its reference, {1000 * bound_m:.1f} mm are allowed"

    def _is_goal(self, pose: Array) -> bool:
        goal = self.task.goal.as_array()
        turn = float(wrap_to_pi(pose[3] - goal[3]))
        return bool(np.abs(pose[:3] - goal[:3]).max() < AT_GOAL and abs(turn) < AT_GOAL)

    def _halted(self, now_s: float, reason: str) -> Decision:
        """Commit nothing: the arm brakes, or rests."""
        moving = self.committed.is_moving_at(now_s + self.settings.cycle_s)
        return self._decision(now_s, "brake" if moving else "stopped" if self._stopped else "rest", reason)

    def _decision(self, now_s: float, kind: str, reason: str, rate: float = 0.0, planned: bool = False) -> Decision:
        captured_s = math.nan if self._set is None else self._set.captured_s
        number = 0 if self._path is None else self._path.number
        return Decision(now_s, kind, reason, rate, number, planned, captured_s)
