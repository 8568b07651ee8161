"""Confidence intervals for rates of motions, and of poses within motions.

The poses of a motion are not independent, so no interval counts them as trials. Each motion contributes its fraction
of poses, a number in [0, 1], and motions are the trials.
"""

import math

import numpy as np
from numpy.typing import NDArray
from scipy import optimize, special, stats

from deltasafe.errors import SettingsError

Array = NDArray[np.float64]


def clopper_pearson(count: int, n: int, level: float = 0.95) -> tuple[float, float]:
    """Compute the exact two-sided interval (Clopper and Pearson 1934) of a probability, observed ``count`` of ``n``.

    Raises:
        SettingsError: not 0 <= count <= n, or ``level`` outside (0, 1).
    """
    _check(count, n, level)
    alpha = 1.0 - level
    low = float(stats.beta.ppf(alpha / 2, count, n - count + 1)) if count > 0 else 0.0
    high = float(stats.beta.ppf(1 - alpha / 2, count + 1, n - count)) if count < n else 1.0
    return low, high


def upper_bound(count: int, n: int, level: float = 0.95) -> float:
    """Compute the exact one-sided upper bound; at a count of 0 it is 1 - (1 - level)^(1/n).

    Raises:
        SettingsError: see ``clopper_pearson``.
    """
    _check(count, n, level)
    return float(stats.beta.ppf(level, count + 1, n - count)) if count < n else 1.0


def mean_upper_bound(values: Array, level: float = 0.95) -> float:
    """Compute a one-sided upper bound of the mean of independent values (N,) in [0, 1] of any distribution.

    The bound combines Hoeffding and Bentkus as in risk control (Bates et al. 2021, proposition 7). It is the largest
    mean r at which

        min(exp(-n h(min(m, r), r)), e P(Bin(n, r) <= ceil(n m)))  >  1 - level

    with the observed mean m and the relative entropy h. If all values are 0, it equals ``upper_bound(0, n)``. Without
    values it is 1.

    Raises:
        SettingsError: a value outside [0, 1], or ``level`` outside (0, 1).
    """
    values = np.asarray(values, dtype=np.float64)
    n = len(values)
    _check(0, n, level)
    if n == 0:
        return 1.0
    if not (values.min() >= 0 and values.max() <= 1):
        raise SettingsError(f"values must lie in [0, 1], got {values.min()} to {values.max()}")
    mean, alpha = float(values.mean()), 1.0 - level
    if mean >= 1.0:
        return 1.0

    def excess(r: float) -> float:
        a = min(mean, r)
        hoeffding = math.exp(-n * float(special.rel_entr(a, r) + special.rel_entr(1 - a, 1 - r)))
        bentkus = math.e * float(stats.binom.cdf(math.ceil(n * mean - 1e-9), n, r))
        return min(hoeffding, bentkus) - alpha

    most = 1.0 - 1e-12
    return 1.0 if excess(most) > 0 else float(optimize.brentq(excess, mean, most, xtol=1e-12))


def _check(count: int, n: int, level: float) -> None:
    if not 0 <= count <= n:
        raise SettingsError(f"count must lie between 0 and the number of trials, got {count} of {n}")
    if not 0 < level < 1:
        raise SettingsError(f"level must lie in (0, 1), got {level}")
