"""The bound gamma0 + gamma1 v as a tolerance bound, and what it covers elsewhere.

Three disjoint sets of independent runs, so that each step may be taken for what it says:

1. *Slope.* In bins of speed the 99 % quantile of the error, then least squares through these. No claim is attached.
2. *Constant.* For that slope each run has one number, its largest excess e - gamma1 v over all samples. gamma0 is the
   largest number of n runs. Whatever its distribution, with confidence 1 - content^n at least the share ``content``
   of all such runs stays below (Wilks 1941: n >= 299 for 99 % at 95 %). The slope was fixed before, on other runs,
   so the numbers are independent and the statement holds for the whole run and all speeds at once.
3. *Coverage.* On runs that had no part in either: share of runs, and of samples, within the bound. The
   Clopper-Pearson bound is stated for runs alone, since samples of a run depend on one another.

"Such runs" are those of ``trajectories`` on arms whose friction and sensors are drawn as everywhere in this project.
The paper's own slope may take the place of the first step: gamma0 over it is a tolerance bound as well.
"""

import dataclasses
import itertools

import numpy as np
from numpy.typing import NDArray

from deltasafe.planning.tracking_bound import TrackingBound
from deltasafe.studies.intervals import upper_bound
from deltasafe.studies.tracking.tracking_errors import PHASES_OF_SPEED, Tracks

__all__ = ["SPEED_EDGES_MPS", "Coverage", "coverage_of", "fitted_bound", "gamma0_over", "slope_of"]

SPEED_EDGES_MPS = (0.0, 0.005, 0.02, 0.05, 0.1, 0.15, 0.2 + 1e-9)
_FEWEST = 100


@dataclasses.dataclass(frozen=True)
class Coverage:
    """Of some runs, or of those of their samples that belong to a bin.

    Attributes:
        name: of the bin; `all` for all samples.
        runs: with a sample in the bin; runs_within: those of them with all of these within the bound.
        runs_lower95: one-sided 95 % lower bound of the probability that a run is within (Clopper and Pearson 1934).
        samples, samples_within: pooled; no interval is stated for them.
        largest_error_m, largest_excess_m: over the samples.
    """

    name: str
    runs: int
    runs_within: int
    runs_lower95: float
    samples: int
    samples_within: int
    largest_error_m: float
    largest_excess_m: float

    @property
    def of_runs(self) -> float:
        """Share of the runs within."""
        return self.runs_within / self.runs

    @property
    def of_samples(self) -> float:
        """Share of the samples within."""
        return self.samples_within / self.samples


def slope_of(tracks: Tracks, quantile: float) -> float:
    """gamma1 in s: least squares through the quantiles of the error in bins of speed; never negative."""
    middles, quantiles = [], []
    edges = np.quantile(tracks.speed_mps[tracks.speed_mps > 0], np.linspace(0, 1, 13))
    for low, high in itertools.pairwise(edges):
        inside = (tracks.speed_mps >= low) & (tracks.speed_mps <= high)
        if inside.sum() >= _FEWEST:
            middles.append(tracks.speed_mps[inside].mean())
            quantiles.append(np.quantile(tracks.error_m[inside], quantile))
    if len(middles) < 2:
        return 0.0
    return max(0.0, float(np.polyfit(middles, quantiles, 1)[0]))


def gamma0_over(tracks: Tracks, gamma1_s: float) -> float:
    """gamma0 in m: the largest excess over the slope in all runs; a Wilks bound if they are enough."""
    return max(0.0, float((tracks.error_m - gamma1_s * tracks.speed_mps).max()))


def fitted_bound(slope_runs: Tracks, bound_runs: Tracks, quantile: float = 0.99) -> TrackingBound:
    """The identified bound; ``bound_runs`` must be others than ``slope_runs``."""
    gamma1_s = slope_of(slope_runs, quantile)
    return TrackingBound(gamma0_over(bound_runs, gamma1_s), gamma1_s)


def coverage_of(bound: TrackingBound, tracks: Tracks, least_speed_mps: float = 0.0) -> tuple[Coverage, ...]:
    """All samples first, then by speed, by phase, and by the last deceleration (braking and just after it).

    Args:
        least_speed_mps: the bound is read at no less (the paper's line is 0 at rest).
    """
    excess = tracks.error_m - bound.error_m(np.maximum(tracks.speed_mps, least_speed_mps))
    bins = {"all": np.ones(len(excess), dtype=np.bool_)}
    for low, high in itertools.pairwise(SPEED_EDGES_MPS):
        bins[f"speed {low:g} to {high:.3g} m/s"] = (tracks.speed_mps >= low) & (tracks.speed_mps < high)
    for index, name in enumerate(PHASES_OF_SPEED):
        bins[name] = tracks.phase == index
    run_of = np.repeat(np.arange(tracks.n_runs), np.diff(tracks.starts))
    braked = tracks.phase >= PHASES_OF_SPEED.index("braking")
    for deceleration in np.unique(tracks.braking_mps2):
        bins[f"braking at {deceleration:g} m/s²"] = braked & (tracks.braking_mps2[run_of] == deceleration)
    return tuple(_coverage(name, inside, run_of, tracks, excess) for name, inside in bins.items() if inside.any())


def _coverage(
    name: str, inside: NDArray[np.bool_], run_of: NDArray[np.int64], tracks: Tracks, excess: NDArray[np.float64]
) -> Coverage:
    runs = len(np.unique(run_of[inside]))
    missed = len(np.unique(run_of[inside & (excess > 0)]))
    return Coverage(
        name,
        runs,
        runs - missed,
        1 - upper_bound(missed, runs),
        int(inside.sum()),
        int((inside & (excess <= 0)).sum()),
        float(tracks.error_m[inside].max()),
        float(excess[inside].max()),
    )
