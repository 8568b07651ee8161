"""Workspace errors of the test runs, with speed and phase of every sample."""

import dataclasses
import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from deltasafe.errors import PlanningError, SettingsError
from deltasafe.execution.settings import ExecutionSettings
from deltasafe.execution.simulate import execute
from deltasafe.execution.workcell import Workcell
from deltasafe.planning.tracking_bound import TrackingBound
from deltasafe.studies.tracking.settings import TrackingStudySettings
from deltasafe.studies.tracking.test_motions import draw_motion

PHASES_OF_SPEED = ("steady", "speeding up", "braking", "just after braking")
AFTER_BRAKING_S = 0.2
MIN_ACCELERATION_MPS2 = 0.02
"""Below this acceleration the speed counts as steady."""
NO_MONITOR_M = 1.0
"""A margin that is never exceeded, so that the monitor does not stop a run."""
REDRAWS = 20


@dataclasses.dataclass(frozen=True)
class Tracks:
    """All S samples of R runs.

    Attributes:
        starts: (R + 1,) run r has the samples from ``starts[r]`` up to ``starts[r + 1]``.
        error_m: (S,) workspace error e_pos + rho_max e_rotation.
        speed_mps: (S,) translational speed |dx| of the reference; 0 during a rotation in place.
        phase: (S,) index into ``PHASES_OF_SPEED``.
        kind, braking_mps2, simulated_s: (R,) kind of the motion, its last deceleration, its duration.
    """

    starts: NDArray[np.int64]
    error_m: NDArray[np.float64]
    speed_mps: NDArray[np.float64]
    phase: NDArray[np.int8]
    kind: NDArray[np.int8]
    braking_mps2: NDArray[np.float64]
    simulated_s: NDArray[np.float64]

    def __post_init__(self) -> None:
        samples, runs = len(self.error_m), len(self.starts) - 1
        if {len(self.speed_mps), len(self.phase)} != {samples} or runs < 1 or self.starts[-1] != samples:
            raise SettingsError(f"the arrays of {runs} runs and {samples} samples have different lengths")
        if {len(self.kind), len(self.braking_mps2), len(self.simulated_s)} != {runs}:
            raise SettingsError(f"each of the {runs} runs needs a kind, a deceleration and a duration")

    @property
    def n_runs(self) -> int:
        """Number of runs."""
        return len(self.starts) - 1

    def part(self, first: int, last: int) -> "Tracks":
        """Select the runs ``first`` up to, not including, ``last``."""
        begin, end = self.starts[first], self.starts[last]
        return Tracks(
            self.starts[first : last + 1] - begin,
            *(self.error_m[begin:end], self.speed_mps[begin:end], self.phase[begin:end]),
            *(self.kind[first:last], self.braking_mps2[first:last], self.simulated_s[first:last]),
        )

    def worst_of_runs(self, values: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the maximum (R,) of values (S,) over each run."""
        return np.asarray(np.maximum.reduceat(values, self.starts[:-1]))

    def excess_m(self, bound: TrackingBound) -> NDArray[np.float64]:
        """Return error minus gamma(v) (S,); negative within the bound."""
        return self.error_m - bound.error_m(self.speed_mps)

    @classmethod
    def joined(cls, parts: Sequence["Tracks"]) -> "Tracks":
        """Join the runs of all parts, in order."""
        counts = np.concatenate([np.diff(part.starts) for part in parts])
        names = [field.name for field in dataclasses.fields(cls)][1:]
        arrays = {name: np.concatenate([getattr(part, name) for part in parts]) for name in names}
        return cls(np.concatenate([[0], np.cumsum(counts)]), **arrays)


def record_runs(settings: TrackingStudySettings, first: int, last: int) -> dict[str, NDArray[np.generic]]:
    """Record the runs ``first`` up to, not including, ``last``; return the arrays of their ``Tracks``."""
    return dataclasses.asdict(Tracks.joined([_record(settings, settings.first_seed + k) for k in range(first, last)]))


def _record(settings: TrackingStudySettings, seed: int) -> Tracks:
    """Record one motion on one arm, both drawn with the seed, without a hand and without stops of the monitor."""
    rng = np.random.default_rng([seed, 0])
    rate_hz = settings.record_rate_hz
    options = ExecutionSettings(approach_m=0.0, record_rate_hz=rate_hz, monitor_margin_m=NO_MONITOR_M, arm=settings.arm)
    for _ in range(REDRAWS):
        motion = draw_motion(settings, rng)
        try:
            run = execute(motion.trajectory, Workcell(settings.body), options, seed)
        except PlanningError:  # out of reach; a planned motion would be refused as well
            continue
        return Tracks(
            np.array([0, len(run.time_s)]),
            run.workspace_error_m,
            run.reference_speed_mps,
            phases_of_speed(run.time_s, run.reference_speed_mps),
            np.array([motion.kind], dtype=np.int8),
            np.array([motion.braking_mps2]),
            run.time_s[-1:],
        )
    raise PlanningError(f"seed {seed}: the arm can follow none of {REDRAWS} motions; move the box (lower_m, upper_m)")


def phases_of_speed(time_s: NDArray[np.float64], speed_mps: NDArray[np.float64]) -> NDArray[np.int8]:
    """Classify samples (S,) by acceleration and time since braking, as indices into ``PHASES_OF_SPEED``."""
    change = np.gradient(speed_mps, time_s)
    phase = np.where(change > MIN_ACCELERATION_MPS2, 1, np.where(change < -MIN_ACCELERATION_MPS2, 2, 0)).astype(np.int8)
    last_braking_s = np.maximum.accumulate(np.where(phase == 2, time_s, -math.inf))
    phase[(phase == 0) & (time_s - last_braking_s <= AFTER_BRAKING_S)] = 3
    return phase
