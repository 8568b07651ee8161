"""Intervals for rates: of motions, and of poses within motions.

The poses of a motion depend on each other, so that no interval counts them as trials. What is averaged is each
motion's share of poses, a number in [0, 1]; motions are the trials.
"""

import math

import numpy as np
from numpy.typing import NDArray
from scipy import optimize, stats

from deltasafe.errors import SettingsError

__all__ = ["clopper_pearson", "mean_share_upper", "scene_bootstrap", "upper_bound"]

Array = NDArray[np.float64]


def clopper_pearson(count: int, n: int, level: float = 0.95) -> tuple[float, float]:
    """The exact two-sided interval (Clopper and Pearson 1934) of a probability, ``count`` of ``n``.

    Raises:
        SettingsError: not 0 <= count <= n, or a level outside (0, 1).
    """
    _check(count, n, level)
    alpha = 1.0 - level
    low = float(stats.beta.ppf(alpha / 2, count, n - count + 1)) if count > 0 else 0.0
    high = float(stats.beta.ppf(1 - alpha / 2, count + 1, n - count)) if count < n else 1.0
    return low, high


def upper_bound(count: int, n: int, level: float = 0.95) -> float:
    """The exact one-sided upper bound; 1 - (1 - level)^(1/n) at a count of 0.

    Raises:
        SettingsError: see ``clopper_pearson``.
    """
    _check(count, n, level)
    return float(stats.beta.ppf(level, count + 1, n - count)) if count < n else 1.0


def mean_share_upper(shares: Array, level: float = 0.95) -> float:
    """One-sided upper bound of the mean of independent numbers (N,) in [0, 1], for any distribution; 1 without any.

    Hoeffding and Bentkus together, as in risk control (Bates et al. 2021, proposition 7): the largest mean r at which

        min(exp(-n h(min(m, r), r)), e P(Bin(n, r) <= ceil(n m)))  >  1 - level

    with the observed mean m and h the relative entropy. Without any violation it is the exact bound of ``upper_bound``.

    Raises:
        SettingsError: a number outside [0, 1], or a level outside (0, 1).
    """
    shares = np.asarray(shares, dtype=np.float64)
    n = len(shares)
    _check(0, n, level)
    if n == 0:
        return 1.0
    if not (shares.min() >= 0 and shares.max() <= 1):
        raise SettingsError(f"shares must lie in [0, 1], got {shares.min()} to {shares.max()}")
    mean, alpha = float(shares.mean()), 1.0 - level
    if mean >= 1.0:
        return 1.0

    def excess(r: float) -> float:
        hoeffding = math.exp(-n * _relative_entropy(min(mean, r), r))
        bentkus = math.e * float(stats.binom.cdf(math.ceil(n * mean - 1e-9), n, r))
        return min(hoeffding, bentkus) - alpha

    most = 1.0 - 1e-12
    return 1.0 if excess(most) > 0 else float(optimize.brentq(excess, mean, most, xtol=1e-12))


def scene_bootstrap(
    values: Array, scene: NDArray[np.integer], n_resamples: int, seed: int, level: float = 0.95
) -> tuple[float, float]:
    """Two-sided percentile interval of the mean of ``values`` (N,), whole scenes being drawn; (nan, nan) without any.

    It says what other scenes like these might have given. With no violation at all it says nothing (0 to 0), which is
    why an exact bound stands beside it.
    """
    values = np.asarray(values, dtype=np.float64)
    if len(values) == 0:
        return math.nan, math.nan
    _, place = np.unique(scene, return_inverse=True)
    totals, counts = np.bincount(place, values), np.bincount(place)
    drawn = np.random.default_rng(seed).integers(0, len(counts), (n_resamples, len(counts)))
    means = totals[drawn].sum(axis=1) / counts[drawn].sum(axis=1)
    low, high = np.quantile(means, [(1 - level) / 2, (1 + level) / 2])
    return float(low), float(high)


def _relative_entropy(a: float, b: float) -> float:
    """Of a Bernoulli(a) against a Bernoulli(b), 0 < b < 1."""
    first = a * math.log(a / b) if a > 0 else 0.0
    return first + ((1 - a) * math.log((1 - a) / (1 - b)) if a < 1 else 0.0)


def _check(count: int, n: int, level: float) -> None:
    if not 0 <= count <= n:
        raise SettingsError(f"a count lies between 0 and the number of trials, got {count} of {n}")
    if not 0 < level < 1:
        raise SettingsError(f"level must lie in (0, 1), got {level}")
