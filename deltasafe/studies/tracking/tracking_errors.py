"""What the runs left behind: the workspace error of every sample, with speed and phase."""

import dataclasses
import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from deltasafe.errors import PlanningError, SettingsError
from deltasafe.execution.settings import ExecutionSettings
from deltasafe.execution.simulate import execute
from deltasafe.execution.workcell import Workcell
from deltasafe.planning.body import ToolBody
from deltasafe.planning.tracking_bound import TrackingBound
from deltasafe.studies.tracking.settings import TrackingStudySettings
from deltasafe.studies.tracking.test_motions import draw_motion

__all__ = ["PHASES_OF_SPEED", "Tracks", "record_runs"]

PHASES_OF_SPEED = ("steady", "speeding up", "braking", "just after braking")
AFTER_BRAKING_S = 0.2
_CHANGES_MPS2 = 0.02
_NEVER_STOPS_M = 1.0
_REDRAWS = 20


@dataclasses.dataclass(frozen=True)
class Tracks:
    """All samples of R runs, S in all.

    Attributes:
        starts: (R + 1,) run r holds the samples from ``starts[r]`` up to ``starts[r + 1]``.
        error_m: (S,) workspace error e_pos + rho_max e_rotation.
        speed_mps: (S,) of the reference, |dx| alone: a turn on the spot has none.
        phase: (S,) index into ``PHASES_OF_SPEED``.
        kind: (R,) of the motion; braking_mps2: (R,) its last deceleration; simulated_s: (R,) its duration.
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
            raise SettingsError(f"tracks of {runs} runs and {samples} samples do not fit together")
        if {len(self.kind), len(self.braking_mps2), len(self.simulated_s)} != {runs}:
            raise SettingsError(f"tracks of {runs} runs need one kind, deceleration and duration each")

    @property
    def n_runs(self) -> int:
        return len(self.starts) - 1

    def part(self, first: int, last: int) -> "Tracks":
        """Runs ``first`` up to, not including, ``last``."""
        begin, end = self.starts[first], self.starts[last]
        return Tracks(
            self.starts[first : last + 1] - begin,
            *(self.error_m[begin:end], self.speed_mps[begin:end], self.phase[begin:end]),
            *(self.kind[first:last], self.braking_mps2[first:last], self.simulated_s[first:last]),
        )

    def worst_of_runs(self, values: NDArray[np.float64]) -> NDArray[np.float64]:
        """(R,) the largest of each run's (S,) values."""
        return np.asarray(np.maximum.reduceat(values, self.starts[:-1]))

    def excess_m(self, bound: TrackingBound) -> NDArray[np.float64]:
        """(S,) error above gamma(v): negative inside."""
        return self.error_m - bound.error_m(self.speed_mps)

    @classmethod
    def joined(cls, parts: Sequence["Tracks"]) -> "Tracks":
        """All runs of all parts, in order."""
        counts = np.concatenate([np.diff(part.starts) for part in parts])
        names = [field.name for field in dataclasses.fields(cls)][1:]
        arrays = {name: np.concatenate([getattr(part, name) for part in parts]) for name in names}
        return cls(np.concatenate([[0], np.cumsum(counts)]), **arrays)


def record_runs(settings: TrackingStudySettings, first: int, last: int) -> dict[str, NDArray[np.generic]]:
    """Arrays of ``Tracks`` of the runs ``first`` up to, not including, ``last``."""
    return dataclasses.asdict(Tracks.joined([_record(settings, settings.first_seed + k) for k in range(first, last)]))


def _record(settings: TrackingStudySettings, seed: int) -> Tracks:
    """One motion on one arm, both drawn by the seed, without a hand and without a monitor that would end it early."""
    rng = np.random.default_rng([seed, 0])
    how = ExecutionSettings(approach_m=0.0, record_rate_hz=settings.record_rate_hz, monitor_margin_m=_NEVER_STOPS_M)
    for _ in range(_REDRAWS):
        motion = draw_motion(settings, rng)
        try:
            run = execute(motion.trajectory, Workcell(ToolBody()), how, seed)
        except PlanningError:  # the arm cannot follow: no planner's motion would be executed either
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
    raise PlanningError(f"seed {seed}: of {_REDRAWS} motions the arm could follow none; move the box of the study")


def phases_of_speed(time_s: NDArray[np.float64], speed_mps: NDArray[np.float64]) -> NDArray[np.int8]:
    """(S,) index into ``PHASES_OF_SPEED``: by the reference's acceleration, and by how long ago it braked."""
    change = np.gradient(speed_mps, time_s)
    phase = np.where(change > _CHANGES_MPS2, 1, np.where(change < -_CHANGES_MPS2, 2, 0)).astype(np.int8)
    braked_s = np.maximum.accumulate(np.where(phase == 2, time_s, -math.inf))
    phase[(phase == 0) & (time_s - braked_s <= AFTER_BRAKING_S)] = 3
    return phase
