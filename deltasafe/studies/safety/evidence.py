"""Evaluation of the trials: rates with intervals for each method and delta, and methods against each other."""

import dataclasses
import math
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from deltasafe.studies.intervals import clopper_pearson, mean_upper_bound, upper_bound
from deltasafe.studies.safety.motions import OUTCOMES
from deltasafe.studies.safety.runs import BY_SPEED, N_BINS, SPEED_EDGES_MPS
from deltasafe.studies.safety.settings import METHODS, PARAMETRIC
from deltasafe.studies.safety.study import SafetyStudy


@dataclasses.dataclass(frozen=True)
class Rate:
    """Violations of one kind in the executed motions of a method.

    Attributes:
        n, violated: motions, and motions with at least one violating pose.
        interval, upper95: exact 95 % interval and one-sided upper bound of P(a motion has a violation).
        pose_rate: mean over motions of the fraction of violating poses.
        pose_upper95: its one-sided upper bound; motions are the trials, because poses of a motion are not independent.
        scenes, scenes_violated, scenes_upper95: scenes, scenes with a violation, and the bound for a new scene.
    """

    n: int
    violated: int
    interval: tuple[float, float]
    upper95: float
    pose_rate: float
    pose_upper95: float
    scenes: int
    scenes_violated: int
    scenes_upper95: float


@dataclasses.dataclass(frozen=True)
class MethodResult:
    """Results of a method at a delta; lengths in meters, NaN if nothing was executed.

    Attributes:
        trials, executed, refusals: numbers of trials, of executed motions, and of refusals by outcome.
        violation: rate of poses at which a point of the tool has p_occupied > delta in the field used.
        touch: rate of poses at which the tool touches or crosses the true hand. If p_occupied is calibrated, each
            point of the tool does so with a probability of at most delta; a pose counts as soon as one point does.
        contacts: motions in which tool or arm touched the hand, or the simulation counted a contact with hand or
            table; approach and retreat included.
        stopped: motions that the monitor stopped.
        min_tool_m, quantiles_tool_m: smallest distance of the tool to the true hand: minimum and the 5, 50 and 95 %
            quantiles over motions.
        min_arm_m: smallest distance of the arm's links to the true hand.
        duration_s, length_m: medians over motions.
    """

    method: str
    delta: float
    trials: int
    executed: int
    refusals: dict[str, int]
    violation: Rate
    touch: Rate
    contacts: int
    stopped: int
    min_tool_m: float
    quantiles_tool_m: tuple[float, ...]
    min_arm_m: float
    duration_s: float
    length_m: float


def evaluate(study: SafetyStudy, method: str, delta: float) -> MethodResult:
    """Evaluate a method at a delta."""
    trials, chosen = study.trials, study.of(method, delta)
    done = chosen & study.executed
    outcomes = np.bincount(trials["outcome"][chosen & ~study.executed], minlength=len(OUTCOMES))
    tool_m, arm_m = trials["min_tool_m"][done], trials["min_arm_m"][done]
    executed = bool(done.any())
    quantiles = np.quantile(tool_m, [0.05, 0.5, 0.95]) if executed else np.full(3, math.nan)
    return MethodResult(
        method,
        delta,
        int(chosen.sum()),
        int(done.sum()),
        {name: int(count) for name, count in zip(OUTCOMES, outcomes, strict=True) if count},
        _rate(study, done, "unsafe_poses"),
        _rate(study, done, "touching_poses"),
        int(touched(study)[done].sum()),
        int(trials["stopped"][done].sum()),
        float(tool_m.min()) if executed else math.nan,
        tuple(map(float, quantiles)),
        float(arm_m.min()) if executed else math.nan,
        float(np.median(trials["duration_s"][done])) if executed else math.nan,
        float(np.median(trials["length_m"][done])) if executed else math.nan,
    )


def evaluate_all(study: SafetyStudy) -> Iterator[MethodResult]:
    """Evaluate every method at each of its values of delta."""
    for name in study.settings.methods:
        for delta in study.settings.deltas_of(name):
            yield evaluate(study, name, delta)


def touched(study: SafetyStudy) -> NDArray[np.bool_]:
    """Select trials (T,) in which tool or arm touched the hand, or the simulation counted a contact."""
    trials = study.trials
    near = (trials["min_tool_m"] <= 0) | (trials["min_arm_m"] <= 0)
    return np.asarray(study.executed & (near | (trials["contacts"] > 0)))


def failures(study: SafetyStudy) -> NDArray[np.intp]:
    """Return the numbers of executed trials with a violation, a contact or a stop.

    For the methods with our planner a pose beyond delta is a failure. The published methods do not use the field that
    defines delta, so that only their contacts and stops are failures.
    """
    trials = study.trials
    uses_field = np.array([name not in PARAMETRIC for name in METHODS])
    beyond = (trials["unsafe_poses"] > 0) & uses_field[trials["method"]]
    return np.flatnonzero(study.executed & (beyond | touched(study) | trials["stopped"]))


@dataclasses.dataclass(frozen=True)
class Pairing:
    """Comparison of ours with another method at a delta, in the scenarios in which both moved.

    Attributes:
        n: scenarios.
        only_ours, only_other, both: scenarios in which tool or arm of the methods touched something.
        p_value: two-sided p-value of the exact sign test on the discordant scenarios (McNemar).
        clearance_difference_m: median of the other's smallest distance of the tool to the hand minus ours.
        duration_ratio: median ratio of the other's duration to ours.
    """

    n: int
    only_ours: int
    only_other: int
    both: int
    p_value: float
    clearance_difference_m: float
    duration_ratio: float


def pair(study: SafetyStudy, other: str, delta: float) -> Pairing:
    """Compare our method with another one in the same scenarios."""
    from scipy.stats import binomtest

    trials, hit = study.trials, touched(study)
    rows = [np.flatnonzero(study.of(name, delta) & study.executed) for name in ("ours", other)]
    scenario = trials["scenario"]
    _, first, second = np.intersect1d(scenario[rows[0]], scenario[rows[1]], assume_unique=True, return_indices=True)
    a, b = rows[0][first], rows[1][second]
    only_ours, only_other = int((hit[a] & ~hit[b]).sum()), int((hit[b] & ~hit[a]).sum())
    p_value = binomtest(only_ours, only_ours + only_other).pvalue if only_ours + only_other else 1.0
    difference_m, ratio = math.nan, math.nan
    if len(a):
        difference_m = float(np.median(trials["min_tool_m"][b] - trials["min_tool_m"][a]))
        ratio = float(np.median(trials["duration_s"][b] / trials["duration_s"][a]))
    both = int((hit[a] & hit[b]).sum())
    return Pairing(len(a), only_ours, only_other, both, float(p_value), difference_m, ratio)


@dataclasses.dataclass(frozen=True)
class SpeedBin:
    """Poses at reference speeds from ``from_mps`` up to ``to_mps`` in the executed motions of a method at a delta."""

    from_mps: float
    to_mps: float
    poses: int
    unsafe: int
    touching: int
    min_tool_m: float


def by_speed(study: SafetyStudy, method: str, delta: float) -> tuple[SpeedBin, ...]:
    """Count violations and find the smallest clearance by reference speed."""
    done = study.of(method, delta) & study.executed
    bins = []
    for n in range(N_BINS):
        poses, unsafe, touching = (int(study.trials[name][done, n].sum()) for name in BY_SPEED[:-1])
        min_tool_m = float(study.trials[BY_SPEED[-1]][done, n].min(initial=math.inf))
        bins.append(SpeedBin(SPEED_EDGES_MPS[n], SPEED_EDGES_MPS[n + 1], poses, unsafe, touching, min_tool_m))
    return tuple(bins)


def _rate(study: SafetyStudy, done: NDArray[np.bool_], column: str) -> Rate:
    trials = study.trials
    bad, poses, scene = trials[column][done], trials["poses"][done], trials["scene"][done]
    n, violated = len(bad), int((bad > 0).sum())
    fractions = bad / np.maximum(poses, 1)
    scenes, scenes_violated = len(np.unique(scene)), len(np.unique(scene[bad > 0]))
    return Rate(
        n,
        violated,
        clopper_pearson(violated, n),
        upper_bound(violated, n),
        float(fractions.mean()) if n else math.nan,
        mean_upper_bound(fractions),
        scenes,
        scenes_violated,
        upper_bound(scenes_violated, scenes),
    )
