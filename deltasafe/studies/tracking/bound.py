"""The tracking bound gamma0 + gamma1 v as a tolerance bound, and its coverage on held-out runs.

Each step uses a separate set of independent runs:

1. *Slope.* The 99 % quantile of the error in bins of speed, then least squares. No statistical claim is attached.
2. *Constant.* For this slope each run has a largest excess e - gamma1 v over its samples. gamma0 is the maximum over n
   runs. For any distribution, with confidence 1 - content^n at least the fraction ``content`` of all such runs stays
   below (Wilks 1941: n >= 299 for 99 % at 95 %). The slope comes from other runs, so the excesses are independent and
   the statement holds for whole runs and all speeds.
3. *Coverage.* The fraction of held-out runs, and of their samples, within the bound. Only runs get a Clopper-Pearson
   bound, because samples of a run are not independent.

"Such runs" are ``test_motions`` on simulated arms with randomly drawn friction and sensors. The paper's slope can
replace step 1: its gamma0 is a tolerance bound as well.
"""

import dataclasses
import itertools

import numpy as np
from numpy.typing import NDArray

from deltasafe.planning.tracking_bound import TrackingBound
from deltasafe.studies.intervals import upper_bound
from deltasafe.studies.tracking.tracking_errors import PHASES_OF_SPEED, Tracks

SPEED_EDGES_MPS = (0.0, 0.005, 0.02, 0.05, 0.1, 0.15, 0.2 + 1e-9)
MIN_SAMPLES = 100
"""Samples that a bin of speed needs for a quantile."""


@dataclasses.dataclass(frozen=True)
class Coverage:
    """Coverage of the samples in a bin.

    Attributes:
        name: name of the bin; `all` for all samples.
        runs, runs_within: runs with a sample in the bin, and runs whose samples in the bin are all within the bound.
        runs_lower95: one-sided 95 % lower bound of the probability that a run is within (Clopper and Pearson 1934).
        samples, samples_within: samples of all runs; they get no interval.
        largest_error_m, largest_excess_m: maxima over the samples.
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
    def run_fraction(self) -> float:
        """Fraction of runs within the bound."""
        return self.runs_within / self.runs

    @property
    def sample_fraction(self) -> float:
        """Fraction of samples within the bound."""
        return self.samples_within / self.samples


def fit_slope(tracks: Tracks, quantile: float) -> float:
    """Fit gamma1 in s by least squares to the quantiles of the error in bins of speed; never negative."""
    middles, quantiles = [], []
    edges = np.quantile(tracks.speed_mps[tracks.speed_mps > 0], np.linspace(0, 1, 13))
    for low, high in itertools.pairwise(edges):
        inside = (tracks.speed_mps >= low) & (tracks.speed_mps <= high)
        if inside.sum() >= MIN_SAMPLES:
            middles.append(tracks.speed_mps[inside].mean())
            quantiles.append(np.quantile(tracks.error_m[inside], quantile))
    if len(middles) < 2:
        return 0.0
    return max(0.0, float(np.polyfit(middles, quantiles, 1)[0]))


def fit_constant(tracks: Tracks, gamma1_s: float) -> float:
    """Fit gamma0 in m: the largest excess over the slope, a Wilks bound if the runs are enough."""
    return max(0.0, float((tracks.error_m - gamma1_s * tracks.speed_mps).max()))


def fit_bound(slope_runs: Tracks, bound_runs: Tracks, quantile: float = 0.99) -> TrackingBound:
    """Identify the bound; ``bound_runs`` and ``slope_runs`` must be disjoint."""
    gamma1_s = fit_slope(slope_runs, quantile)
    return TrackingBound(fit_constant(bound_runs, gamma1_s), gamma1_s)


def coverage_of(bound: TrackingBound, tracks: Tracks, min_speed_mps: float = 0.0) -> tuple[Coverage, ...]:
    """Compute the coverage of all samples, then by speed, phase, and deceleration (braking and just after it).

    Args:
        min_speed_mps: lower limit of the speed at which the bound is evaluated (the paper's line is 0 at rest).
    """
    excess = tracks.error_m - bound.error_m(np.maximum(tracks.speed_mps, min_speed_mps))
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
