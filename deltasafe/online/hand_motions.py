"""Motions of a hand in the plane of the table: across the path, toward it, away from it, after the tool, and sudden."""

import bisect
import math

import numpy as np
from numpy.typing import NDArray

from deltasafe.setting_ranges import check_choice

Array = NDArray[np.float64]

KINDS = ("crossing", "approaching", "withdrawing", "following", "sudden")
REACH_M = 0.15
"""How far a hand moves from its place in the logged scene, and back."""


class HandMotion:
    """Displacement of a hand over time, at a speed of at most ``speed_mps``; speed 0 holds it where it starts.

    Hands come from the side of negative y in the logged scenes. ``crossing`` moves to and fro along x, ``approaching``
    from 15 cm behind to its place in the scene, ``withdrawing`` the other way, ``following`` toward the tool all the
    time, and ``sudden`` as ``approaching`` after a rest.

    Args:
        kind: one of ``KINDS``.
        seed: of start and delay.
    """

    def __init__(self, kind: str, speed_mps: float, seed: int) -> None:
        self.kind, self.speed_mps = kind, speed_mps
        check_choice(self, KINDS, "kind")
        rng = np.random.default_rng(seed)
        self._delay_s, self._phase_m = float(rng.uniform(0.5, 3.0)), float(rng.uniform(-REACH_M, REACH_M))
        behind = np.array([rng.uniform(-0.05, 0.05), -REACH_M])
        near = np.array([rng.uniform(-0.05, 0.05), rng.uniform(-0.03, 0.0)])
        if kind == "withdrawing":
            behind, near = near, behind
        self._from, self._to = behind, near
        self._times, self._path = [0.0], [behind]

    def __call__(self, time_s: float) -> Array:
        """Return the displacement (2,) in meters at a time."""
        if self.kind == "following":
            after = bisect.bisect_right(self._times, time_s)
            if after == len(self._times):
                return self._path[-1]
            first_s, second_s = self._times[after - 1 : after + 1]
            share = (time_s - first_s) / (second_s - first_s)
            return np.asarray(self._path[after - 1] + share * (self._path[after] - self._path[after - 1]))
        if self.kind == "crossing":
            along = (self._phase_m + REACH_M + self.speed_mps * time_s) % (4 * REACH_M)
            return np.array([REACH_M - abs(along - 2 * REACH_M), self._to[1]])
        way = self._to - self._from
        moved_m = self.speed_mps * max(0.0, time_s - (self._delay_s if self.kind == "sudden" else 0.0))
        return np.asarray(self._from + way * min(1.0, moved_m / float(np.linalg.norm(way))))

    def see(self, time_s: float, tool: Array) -> None:
        """Move toward the tool at (x, y, ...); for ``following``, once per sample, in the order of time."""
        if self.kind != "following" or time_s <= self._times[-1]:
            return
        here = self._path[-1]
        to_tool = np.clip(tool[:2], -REACH_M, REACH_M) - here
        far_m = float(np.linalg.norm(to_tool))
        step_m = min(far_m, self.speed_mps * (time_s - self._times[-1]))
        self._times.append(time_s)
        self._path.append(here + to_tool * (step_m / far_m) if far_m > 1e-9 and math.isfinite(far_m) else here)
