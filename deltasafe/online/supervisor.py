"""The safety argument: a motion is committed only if it and its braking are verified; else the last braking runs."""

import dataclasses
from typing import Any

import numpy as np

from deltasafe.online.committed import Committed, TimedPath, piece_and_brake, standstill
from deltasafe.online.moving_set import MovingSet, Refusal
from deltasafe.online.settings import OnlineSettings
from deltasafe.planning import TrackingBound

RATES = (1.0, 0.7, 0.45, 0.25, 0.1)
"""Rates that are tried, fastest first: near the hand the arm slows down, because stopping takes time."""

SAME_POSE = 1e-9


@dataclasses.dataclass(frozen=True)
class Outcome:
    """Result of a cycle.

    Attributes:
        target: rate of the accepted piece; 0: none was accepted, the braking of the last one runs or the arm rests.
        refusal: why the fastest piece was not accepted; None if it was, or if there was nothing to verify.
    """

    target: float
    refusal: Refusal | None


class Supervisor:
    """Holds the committed reference of the arm. At every time there is one, and it ends at rest.

    A cycle that begins at ``now_s`` verifies the piece of the next one. If nothing is accepted before then, the arm
    follows the braking trajectory that was accepted with the piece that runs, without any further decision.

    Args:
        pose: (4,) of the tool, at rest.
        now_s: control's clock.
        tracking: gamma.
        v_min_mps: gamma is evaluated at no smaller speed.
    """

    def __init__(
        self, pose: np.ndarray, now_s: float, tracking: TrackingBound, v_min_mps: float, settings: OnlineSettings
    ) -> None:
        self.committed: Committed = standstill(pose, now_s)
        self._tracking, self._v_min_mps, self._settings = tracking, v_min_mps, settings

    def advance(self, now_s: float, moving_set: MovingSet, path: TimedPath | None) -> Outcome:
        """Commit the fastest verified piece of the next cycle, if there is one.

        Args:
            now_s: begin of this cycle.
            moving_set: of the newest image.
            path: the path to follow. Another one than that of the committed reference is taken only where it begins,
                at rest; None: brake.
        """
        start_s = now_s + self._settings.cycle_s
        state = self._state_on(path, start_s)
        if path is None or state is None:
            return Outcome(0.0, None)
        first: Refusal | None = None
        for target in RATES:
            motion = piece_and_brake(path, start_s, *state, target, moving_set.captured_s, self._settings)
            refusal = moving_set.refusal(motion.time_s, motion.poses, motion.speed_mps, self._tracking, self._v_min_mps)
            if refusal is None:
                self._commit(motion, start_s)
                return Outcome(target, first)
            first = first or refusal
        return Outcome(0.0, first)

    def _state_on(self, path: TimedPath | None, start_s: float) -> tuple[float, float] | None:
        """Path time and rate at which a path can be entered at a time; None: it cannot."""
        if path is None:
            return None
        if path is self.committed.path:
            return self.committed.state_at(start_s)
        pose, _ = self.committed.at(start_s)
        if self.committed.is_moving_at(start_s) or np.abs(pose - path.trajectory.poses[0]).max() > SAME_POSE:
            return None
        return 0.0, 1.0  # the schedule itself begins at rest

    def _commit(self, motion: Committed, start_s: float) -> None:
        """Keep the reference of the cycle that runs, and replace what follows it."""
        running = self.committed
        last = int(np.searchsorted(running.time_s, start_s - 1e-9))
        first = int(np.searchsorted(running.time_s, start_s - 2 * self._settings.cycle_s, "right")) - 1
        past = slice(max(first, 0), max(last, 1))
        joined: dict[str, Any] = {
            name: np.concatenate([getattr(running, name)[past], getattr(motion, name)])
            for name in ("time_s", "poses", "speed_mps", "progress_s", "rate")
        }
        self.committed = dataclasses.replace(motion, **joined)
