"""What the trials say: rates with intervals for each contender and level, and contenders against each other."""

import dataclasses
import math

import numpy as np
from numpy.typing import NDArray

from deltasafe.studies.intervals import clopper_pearson, mean_share_upper, scene_bootstrap, upper_bound
from deltasafe.studies.safety.motions import OUTCOMES
from deltasafe.studies.safety.runs import SPEED_EDGES_MPS
from deltasafe.studies.safety.settings import CONTENDERS, PARAMETRIC
from deltasafe.studies.safety.study import SafetyStudy

__all__ = ["KINDS", "Cell", "Pairing", "Rate", "SpeedBin", "by_speed", "cell", "failures", "pairing", "step_of_pose_m"]

KINDS = ("model", "reality")
"""What a violation is.

model: a point of the tool has p_occupied > delta in the field that was used. reality: the tool touches or crosses the
true hand. Honest probabilities make the second at most delta for each point of the tool; a pose counts here as soon as
one of its points does, which is more.
"""


@dataclasses.dataclass(frozen=True)
class Rate:
    """Violations of one kind in n executed motions.

    Attributes:
        n, violated: motions, and those with at least one violating pose.
        interval, upper95: of P(a motion has a violation): exact, two-sided and one-sided.
        pose_rate: mean over motions of the share of violating poses.
        pose_upper95: its one-sided bound; motions are the trials, poses within one depend on each other.
        pose_interval_scenes: two-sided, whole scenes drawn.
        scenes, scenes_violated, scenes_upper95: the same of scenes, for whoever asks about a new scene.
    """

    n: int
    violated: int
    interval: tuple[float, float]
    upper95: float
    pose_rate: float
    pose_upper95: float
    pose_interval_scenes: tuple[float, float]
    scenes: int
    scenes_violated: int
    scenes_upper95: float


@dataclasses.dataclass(frozen=True)
class Cell:
    """A contender at a level; lengths in meters, NaN where nothing was executed.

    Attributes:
        trials, executed, refusals: and why, by outcome.
        model, reality: rates of violation, see ``KINDS``.
        contacts: motions in which tool or arm touched the hand or the physics counted a contact (with hand or table),
            approach and retreat included.
        stopped: by the monitor.
        min_tool_m, quantiles_tool_m: smallest distances of the tool to the true hand: the least, and the 5, 50 and 95 %
            quantiles over motions. ``min_arm_m``: the least of the links.
        duration_s, length_m: medians.
        max_missed_share: largest share of a true hand with p_occupied <= delta.
    """

    contender: str
    delta: float
    trials: int
    executed: int
    refusals: dict[str, int]
    model: Rate
    reality: Rate
    contacts: int
    stopped: int
    min_tool_m: float
    quantiles_tool_m: tuple[float, ...]
    min_arm_m: float
    duration_s: float
    length_m: float
    max_missed_share: float


def cell(study: SafetyStudy, contender: str, delta: float) -> Cell:
    """All about one contender at one level."""
    trials, chosen = study.trials, study.of(contender, delta)
    done = chosen & study.executed
    outcomes = np.bincount(trials["outcome"][chosen & ~study.executed], minlength=len(OUTCOMES))
    tool_m, arm_m = trials["min_tool_m"][done], trials["min_arm_m"][done]
    quantiles = np.quantile(tool_m, [0.05, 0.5, 0.95]) if done.any() else np.full(3, math.nan)
    return Cell(
        contender,
        delta,
        int(chosen.sum()),
        int(done.sum()),
        {name: int(count) for name, count in zip(OUTCOMES, outcomes, strict=True) if count},
        _rate(study, done, "unsafe_poses"),
        _rate(study, done, "touching_poses"),
        int(touched(study)[done].sum()),
        int(trials["stopped"][done].sum()),
        float(tool_m.min(initial=math.inf)) if done.any() else math.nan,
        tuple(float(value) for value in quantiles),
        float(arm_m.min(initial=math.inf)) if done.any() else math.nan,
        float(np.median(trials["duration_s"][done])) if done.any() else math.nan,
        float(np.median(trials["length_m"][done])) if done.any() else math.nan,
        float(trials["missed_share"][chosen].max(initial=0.0)),
    )


def touched(study: SafetyStudy) -> NDArray[np.bool_]:
    """(T,) trials in which tool or arm touched the hand, or the physics counted a contact, at any time."""
    trials = study.trials
    near = (trials["min_tool_m"] <= 0) | (trials["min_arm_m"] <= 0)
    return np.asarray(study.executed & (near | (trials["contacts"] > 0)))


def failures(study: SafetyStudy) -> NDArray[np.intp]:
    """Numbers of the trials that were executed and were not delta-safe as a whole, touched something or were stopped.

    Of the contenders with our planner a pose beyond delta counts as failure; the compared methods do not know the field
    that they would be judged by, so that of them only contacts and stops do.
    """
    trials = study.trials
    knows_field = [name not in PARAMETRIC for name in CONTENDERS]
    beyond = (trials["unsafe_poses"] > 0) & np.array(knows_field)[trials["contender"]]
    return np.flatnonzero(study.executed & (beyond | touched(study) | trials["stopped"]))


@dataclasses.dataclass(frozen=True)
class Pairing:
    """Two contenders at a level in the situations in which both moved.

    Attributes:
        n: situations.
        only_first, only_second, both: in how many of them the tool or arm of either touched something.
        p_value: two-sided, of the exact sign test on those in which one did (McNemar).
        shorter_m: median of the second's smallest distance of the tool to the hand less the first's.
        faster: median ratio of the second's duration to the first's.
    """

    first: str
    second: str
    delta: float
    n: int
    only_first: int
    only_second: int
    both: int
    p_value: float
    shorter_m: float
    faster: float


def pairing(study: SafetyStudy, first: str, second: str, delta: float) -> Pairing:
    """Compare two contenders in the same situations."""
    from scipy.stats import binomtest

    rows = [np.flatnonzero(study.of(name, delta) & study.executed) for name in (first, second)]
    situations = [study.trials["situation"][row] for row in rows]
    _, at_first, at_second = np.intersect1d(situations[0], situations[1], assume_unique=True, return_indices=True)
    a, b = rows[0][at_first], rows[1][at_second]
    hit = touched(study)
    only_first, only_second = int((hit[a] & ~hit[b]).sum()), int((hit[b] & ~hit[a]).sum())
    p_value = binomtest(only_first, only_first + only_second).pvalue if only_first + only_second else 1.0
    nearer, longer = math.nan, math.nan
    if len(a):
        nearer = float(np.median(study.trials["min_tool_m"][b] - study.trials["min_tool_m"][a]))
        longer = float(np.median(study.trials["duration_s"][b] / study.trials["duration_s"][a]))
    both = int((hit[a] & hit[b]).sum())
    return Pairing(first, second, delta, len(a), only_first, only_second, both, float(p_value), nearer, longer)


@dataclasses.dataclass(frozen=True)
class SpeedBin:
    """Poses at reference speeds from ``from_mps`` up to ``to_mps``, of all executed motions of a cell."""

    from_mps: float
    to_mps: float
    poses: int
    unsafe: int
    touching: int
    min_tool_m: float


def by_speed(study: SafetyStudy, contender: str, delta: float) -> tuple[SpeedBin, ...]:
    """Violations and smallest clearance by reference speed."""
    done = study.of(contender, delta) & study.executed
    bins = []
    for n in range(len(SPEED_EDGES_MPS) - 1):
        poses, unsafe, touching = (
            int(study.trials[name][done, n].sum())
            for name in ("poses_by_speed", "unsafe_by_speed", "touching_by_speed")
        )
        nearest = float(study.trials["min_tool_by_speed_m"][done, n].min(initial=math.inf))
        bins.append(SpeedBin(SPEED_EDGES_MPS[n], SPEED_EDGES_MPS[n + 1], poses, unsafe, touching, nearest))
    return tuple(bins)


def step_of_pose_m(study: SafetyStudy) -> float:
    """Largest way of the tool between two recorded poses: what happens in between is not seen."""
    return study.settings.motion.v_max_mps / study.settings.execution.record_rate_hz


def _rate(study: SafetyStudy, done: NDArray[np.bool_], column: str) -> Rate:
    trials = study.trials
    bad, poses, scene = trials[column][done], trials["poses"][done], trials["scene"][done]
    n, violated = len(bad), int((bad > 0).sum())
    shares = bad / np.maximum(poses, 1)
    scenes, scenes_violated = len(np.unique(scene)), len(np.unique(scene[bad > 0]))
    return Rate(
        n,
        violated,
        clopper_pearson(violated, n),
        upper_bound(violated, n),
        float(shares.mean()) if n else math.nan,
        mean_share_upper(shares),
        scene_bootstrap(shares, scene, study.settings.n_bootstrap, study.settings.seed),
        scenes,
        scenes_violated,
        upper_bound(scenes_violated, scenes),
    )
