"""Live runs in simulated time: the loop, a frame source, and an arm that follows its reference within the bound."""

import dataclasses
import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from deltasafe.online.committed import STILL_MPS
from deltasafe.online.frames import FrameSource
from deltasafe.online.loop import Decision, OnlineLoop

Array = NDArray[np.float64]

STEP_S = 0.005
"""Time between two recorded samples."""


@dataclasses.dataclass(frozen=True)
class LiveRun:
    """What the arm did.

    Attributes:
        time_s: (N,) on the control's clock.
        reference: (N, 4); tool: (N, 4) executed poses.
        speed_mps: (N,) reference speed of the tool's fastest point.
        captured_s: (N,) capture time of the image that the running piece was verified with; NaN at rest.
        decisions: one per cycle.
    """

    time_s: Array
    reference: Array
    tool: Array
    speed_mps: Array
    captured_s: Array
    decisions: tuple[Decision, ...]

    @property
    def is_moving(self) -> NDArray[np.bool_]:
        """(N,) whether the reference moves."""
        return self.speed_mps > STILL_MPS

    @property
    def reached_goal(self) -> bool:
        """Whether the arm rests at the goal."""
        return self.decisions[-1].kind == "goal"


class KinematicArm:
    """Follows its reference with an error of the bound's size, in a direction that changes smoothly and randomly.

    Args:
        bound_m: gamma at a speed.
        seed: of the directions.
    """

    def __init__(self, bound_m: Callable[[float], float], seed: int) -> None:
        rng = np.random.default_rng(seed)
        self._bound_m, self._frequency, self._phase = bound_m, rng.uniform(0.5, 5.0, (3, 3)), rng.uniform(0, 7, (3, 3))

    def pose(self, reference: Array, speed_mps: float, time_s: float) -> Array:
        """Pose (4,) of the tool at a reference pose, speed and time."""
        direction = np.sin(self._frequency * time_s + self._phase).sum(axis=0)
        size = float(np.linalg.norm(direction))
        error = direction / max(size, 1e-9) * self._bound_m(speed_mps) * min(1.0, size)
        return np.append(reference[:3] + error, reference[3])


def run_simulated(
    loop: OnlineLoop,
    source: FrameSource,
    arm: KinematicArm,
    duration_s: float,
    clock: Callable[[float], float] = lambda time_s: time_s,
    on_sample: Callable[[float, Array], None] = lambda time_s, pose: None,
    note: Callable[..., None] = lambda *cycle: None,
) -> LiveRun:
    """Run the loop for a time, or until the arm rests at its goal.

    Args:
        clock: what the loop reads as the control's clock at a true time; faults of a clock can be injected. The arm
            follows the committed reference by the true time.
        on_sample: is called with each time and pose (4,) of the tool, for hands that follow it.
        note: is called with each cycle, as `deltasafe.online.decision_log.record_run` takes it.
    """
    period_s = loop.settings.cycle_s
    per_cycle = max(1, round(period_s / STEP_S))
    rows: list[tuple[float, Array, Array, float, float]] = []
    decisions: list[Decision] = []
    pose = loop.committed.poses[-1]
    for cycle in range(math.ceil(duration_s / period_s)):
        now_s = cycle * period_s
        before = loop.committed  # governs this cycle: a decision takes effect at the next one
        observation = loop.observe(clock(now_s), source.newest(now_s))
        decisions.append(loop.decide(clock(now_s), observation, pose))
        note(clock(now_s), observation, pose, decisions[-1], loop.timing_ms)
        for n in range(per_cycle):
            time_s = now_s + n * period_s / per_cycle
            target, speed = before.at(time_s)
            pose = arm.pose(target, speed, time_s)
            on_sample(time_s, pose)
            rows.append((time_s, target, pose, speed, before.captured_s))
        pose = arm.pose(*loop.committed.at(now_s + period_s), now_s + period_s)
        if decisions[-1].kind == "goal":
            break
    times, references, poses, speeds, captured = (np.array(column) for column in zip(*rows, strict=True))
    return LiveRun(times, references, poses, speeds, captured, tuple(decisions))
