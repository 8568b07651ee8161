"""The compared methods as segment tests, with the interface of the tests of a distance field."""

import dataclasses
import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import erfcinv

from deltasafe.compute.numba_cache import compiled
from deltasafe.planning.collision.segment import in_order
from deltasafe.planning.collision.segment_query import register_segment_test, segment_is_safe
from deltasafe.planning.collision.segment_tests import SegmentTest
from deltasafe.setting_ranges import check_choice, check_range
from deltasafe.studies.baselines.obstacles import GaussianObstacle, ObstacleArrays, obstacle_arrays
from deltasafe.studies.baselines.probability import (
    BOUNDING_VOLUME,
    EXACT,
    JOINT_RISKS,
    MAX_PROBABILITY,
    METHODS,
    NOISY_OR,
    collision_probability_of_ball,
    risk,
)

NEGLIGIBLE = 1e-9
"""Fraction of delta that the noisy-OR counts for each culled obstacle."""

ROUNDING = 1e-9
"""Relative safety margin of the culling distances, so that rounding cannot flip the answer."""

Array = NDArray[np.float64]


@dataclasses.dataclass(frozen=True)
class GaussianCheckSettings:
    """Settings of a segment test against obstacles at Gaussian positions.

    Attributes:
        method: ``chance_constraint`` (Zhu and Alonso-Mora 2019, linearized at every pose),
            ``max_probability`` (Park, Park and Manocha 2018), ``bounding_volume`` (Kamel 2017) or ``exact``.
        delta: largest probability of collision at a pose; ``bounding_volume`` ignores it.
        joint_risk: how n obstacles share delta: ``each`` allows delta per obstacle, ``boole`` allows delta / n,
            ``noisy_or`` bounds 1 - prod(1 - p_i).
        sigma_level: standard deviations by which ``bounding_volume`` grows an obstacle.
        delta_p_m: largest distance between two tested poses; half of it is added to the robot's radius (decision 18).
        cull: skip the method's formula for obstacles that are near or far enough; the answers stay the same.
        numeric_search: search the multiplier of ``max_probability`` numerically even where a closed form exists.
    """

    method: str = "chance_constraint"
    delta: float = 0.05
    joint_risk: str = "each"
    sigma_level: float = 3.0
    delta_p_m: float = 0.01
    cull: bool = True
    numeric_search: bool = False

    def __post_init__(self) -> None:
        check_choice(self, METHODS, "method")
        check_choice(self, JOINT_RISKS, "joint_risk")
        check_range(self, "(0, 0.5)", "delta")  # where a linearized constraint bounds the risk
        check_range(self, "[0, inf)", "sigma_level")
        check_range(self, "[1e-5, 0.1]", "delta_p_m")


class GaussianParams(NamedTuple):
    """Scalar parameters of a test; ``method`` indexes ``METHODS``, ``joint_risk`` indexes ``JOINT_RISKS``."""

    method: int
    joint_risk: int
    delta: float
    negligible: float
    delta_p_m: float
    cull: bool
    numeric_search: bool


class GaussianTest(NamedTuple):
    """A segment test as compiled code reads it; created by ``gaussian_test``.

    ``mean_m``, ``map`` and ``spread`` are those of ``ObstacleArrays``. ``band_m`` (n, 2) holds distances to the mean:
    an obstacle nearer than the first is always refused, an obstacle farther than the second is always accepted.
    """

    mean_m: Array
    map: Array
    spread: Array
    band_m: Array
    params: GaussianParams


class GaussianTestInView(NamedTuple):
    """A conjunction of two tests: a compared method for the obstacles, our test for table and view border.

    ``outside`` tests a distance field in which only the space outside the camera's view is occupied.
    """

    obstacles: GaussianTest
    outside: SegmentTest


def gaussian_test(
    obstacles: Sequence[GaussianObstacle], robot_radius_m: float, settings: GaussianCheckSettings
) -> GaussianTest:
    """Create the segment test of a robot inside a ball of ``robot_radius_m``, tracking margin included.

    Poses inside the mean shape of an obstacle are always refused (decision 14).
    """
    method, n = METHODS.index(settings.method), max(len(obstacles), 1)
    radius_m = robot_radius_m + settings.delta_p_m / 2
    arrays = obstacle_arrays(obstacles, radius_m, settings.sigma_level if method == BOUNDING_VOLUME else 0.0)
    delta = settings.delta / n if settings.joint_risk == "boole" else settings.delta
    negligible = NEGLIGIBLE * delta / n
    band_m = _band_m(method, arrays, delta, negligible if settings.joint_risk == "noisy_or" else delta)
    params = GaussianParams(
        method,
        JOINT_RISKS.index(settings.joint_risk),
        delta,
        negligible,
        settings.delta_p_m,
        settings.cull,
        settings.numeric_search,
    )
    return GaussianTest(arrays.mean_m, arrays.map, arrays.spread, band_m, params)


def _band_m(method: int, arrays: ObstacleArrays, refuse_above: float, accept_below: float) -> Array:
    """Compute the culling distances (n, 2) to the mean.

    Below the first the risk exceeds ``refuse_above``; beyond the second it is less than ``accept_below``.
    In units of the grown obstacle, replacing the noise by isotropic noise of its largest (smallest) variance makes
    every bound larger (smaller), and a function of |w| alone.
    """
    smallest, largest = (np.sqrt(arrays.spread[:, column]) for column in (0, 2))
    below, above = np.ones(len(smallest)), np.ones(len(smallest))
    if method == MAX_PROBABILITY:
        scale = 4 / 3 * math.pi / np.sqrt((2 * math.pi) ** 3 * arrays.spread.prod(axis=1))
        below = 1 + smallest * np.sqrt(2 * np.maximum(np.log(scale / refuse_above), 0.0))
        above = 1 + largest * np.sqrt(2 * np.maximum(np.log(scale / accept_below), 0.0))
    elif method != BOUNDING_VOLUME:
        above = 1 + largest * math.sqrt(2) * erfcinv(2 * accept_below)
        if method == EXACT:  # the half space is an upper bound; without isotropy the only lower bound is the mean shape
            for n in np.flatnonzero(arrays.spread[:, 0] == arrays.spread[:, 2]):
                below[n] = _distance_at_risk(refuse_above, largest[n], above[n])
                above[n] = _distance_at_risk(accept_below, largest[n], above[n])
        else:
            below = 1 + smallest * math.sqrt(2) * erfcinv(2 * refuse_above)
    return np.column_stack([below * arrays.axis_m[:, 0], above * arrays.axis_m[:, 1]])


@compiled
def _distance_at_risk(delta, sigma, upper):  # type: ignore[no-untyped-def]
    """Find the distance in [1, ``upper``] from the unit ball's center where isotropic noise has the risk delta."""
    low, high = 1.0, upper
    if collision_probability_of_ball(low, 1.0, sigma) <= delta:
        return low
    for _ in range(60):
        middle = 0.5 * (low + high)
        if collision_probability_of_ball(middle, 1.0, sigma) > delta:
            low = middle
        else:
            high = middle
    return high


@register_segment_test(GaussianTestInView)
@compiled
def _segment_in_view(test, start, end):  # type: ignore[no-untyped-def]
    return segment_is_safe(test.outside, start, end) and segment_is_safe(test.obstacles, start, end)


@register_segment_test(GaussianTest)
@compiled
def _segment(test, first, second):  # type: ignore[no-untyped-def]
    """Test poses at most delta_p apart, both ends included; the order of the ends does not matter."""
    start, end = in_order(first, second)
    length = math.sqrt((end[0] - start[0]) ** 2 + (end[1] - start[1]) ** 2 + (end[2] - start[2]) ** 2)
    steps = math.ceil(length / test.params.delta_p_m - 1e-9)
    if test.params.joint_risk == NOISY_OR:
        return _noisy_or(test, start, end, steps)
    for n in range(len(test.mean_m)):
        if test.params.cull and _distance(test.mean_m[n], start, end) > test.band_m[n, 1] * (1.0 + ROUNDING):
            continue
        for step in range(steps + 1):
            if not _is_clear(test, n, start, end, step / max(steps, 1)):
                return False
    return True


@compiled
def _is_clear(test, n, start, end, fraction):  # type: ignore[no-untyped-def]
    """Test whether the risk of obstacle n is at most delta at ``fraction`` of a segment."""
    x, y, z = _offset(test, n, start, end, fraction)
    if test.params.cull:
        squared = x * x + y * y + z * z
        if squared > (test.band_m[n, 1] * (1.0 + ROUNDING)) ** 2:
            return True
        if squared < (test.band_m[n, 0] * (1.0 - ROUNDING)) ** 2:
            return False
    return _risk_at(test, n, x, y, z) <= test.params.delta


@compiled
def _noisy_or(test, start, end, steps):  # type: ignore[no-untyped-def]
    """Test the noisy-OR of all obstacles at each pose; culled obstacles count with an upper bound of their risk."""
    params = test.params
    for step in range(steps + 1):
        p_free = 1.0
        for n in range(len(test.mean_m)):
            x, y, z = _offset(test, n, start, end, step / max(steps, 1))
            p = params.negligible
            if not params.cull or x * x + y * y + z * z <= (test.band_m[n, 1] * (1.0 + ROUNDING)) ** 2:
                p = max(_risk_at(test, n, x, y, z), p)
            p_free *= 1.0 - p
            if not 1.0 - p_free <= params.delta:  # NaN is refused
                return False
    return True


@compiled
def _offset(test, n, start, end, fraction):  # type: ignore[no-untyped-def]
    """Return the position at ``fraction`` of a segment relative to the mean of obstacle n."""
    x = start[0] + fraction * (end[0] - start[0]) - test.mean_m[n, 0]
    y = start[1] + fraction * (end[1] - start[1]) - test.mean_m[n, 1]
    z = start[2] + fraction * (end[2] - start[2]) - test.mean_m[n, 2]
    return x, y, z


@compiled
def _risk_at(test, n, x, y, z):  # type: ignore[no-untyped-def]
    """Compute the method's P(collision) at a position relative to the mean of obstacle n; 1 inside its mean shape."""
    to = test.map[n]
    w = (
        to[0, 0] * x + to[0, 1] * y + to[0, 2] * z,
        to[1, 0] * x + to[1, 1] * y + to[1, 2] * z,
        to[2, 0] * x + to[2, 1] * y + to[2, 2] * z,
    )
    if w[0] * w[0] + w[1] * w[1] + w[2] * w[2] <= 1.0:
        return 1.0
    s = test.spread[n]
    return risk(test.params.method, test.params.numeric_search, w, (s[0], s[1], s[2]))


@compiled
def _distance(point, start, end):  # type: ignore[no-untyped-def]
    """Compute the distance of a point to a straight segment."""
    ux, uy, uz = end[0] - start[0], end[1] - start[1], end[2] - start[2]
    vx, vy, vz = point[0] - start[0], point[1] - start[1], point[2] - start[2]
    squared = ux * ux + uy * uy + uz * uz
    fraction = 0.0
    if squared > 0.0:
        fraction = min(max((ux * vx + uy * vy + uz * vz) / squared, 0.0), 1.0)
    dx, dy, dz = vx - fraction * ux, vy - fraction * uy, vz - fraction * uz
    return math.sqrt(dx * dx + dy * dy + dz * dz)
