"""The compared methods as tests of segments, behind the same interface as the tests of a field."""

import dataclasses
import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import erfcinv

from deltasafe.compute.numba_cache import compiled
from deltasafe.errors import SettingsError
from deltasafe.planning.collision.segment import in_order
from deltasafe.planning.collision.segment_query import answers_segments
from deltasafe.studies.baselines.obstacles import GaussianObstacle, ObstacleArrays, obstacle_arrays
from deltasafe.studies.baselines.probability import JOINT_RISKS, METHODS, collision_probability_of_ball, risk

__all__ = ["GaussianCheckSettings", "GaussianTest", "gaussian_test", "keep_out_m"]

NEGLIGIBLE = 1e-9
"""A risk below this share of delta is counted as this share by the noisy-OR of culled obstacles."""

Array = NDArray[np.float64]


@dataclasses.dataclass(frozen=True)
class GaussianCheckSettings:
    """How a segment is tested against obstacles at Gaussian positions.

    Attributes:
        method: ``chance_constraint`` (Zhu and Alonso-Mora 2019, linearised anew at every pose),
            ``max_probability`` (Park, Park and Manocha 2018), ``bounding_volume`` (Kamel 2017) or ``exact``.
        delta: largest probability of collision at a pose; without meaning for ``bounding_volume``.
        joint_risk: how n obstacles share it: ``each`` may have delta, ``boole`` gives each delta / n, ``noisy_or``
            bounds 1 - prod(1 - p_i).
        sigma_level: standard deviations by which ``bounding_volume`` grows an obstacle.
        delta_p_m: largest motion between two tested poses; half of it is part of the robot's radius (decision 18).
        cull: settle obstacles that are near or far enough without the method's formula; the answers are the same.
        numeric_search: look for the multiplier of ``max_probability`` numerically even where a closed form exists.
    """

    method: str = "chance_constraint"
    delta: float = 0.05
    joint_risk: str = "each"
    sigma_level: float = 3.0
    delta_p_m: float = 0.01
    cull: bool = True
    numeric_search: bool = False

    def __post_init__(self) -> None:
        if self.method not in METHODS:
            raise SettingsError(f"method must be one of {METHODS}, got {self.method!r}")
        if self.joint_risk not in JOINT_RISKS:
            raise SettingsError(f"joint_risk must be one of {JOINT_RISKS}, got {self.joint_risk!r}")
        if not 0 < self.delta < 0.5:
            raise SettingsError(f"delta must be in (0, 0.5), where a linearised constraint bounds it, got {self.delta}")
        if not (math.isfinite(self.sigma_level) and self.sigma_level >= 0):
            raise SettingsError(f"sigma_level must not be negative, got {self.sigma_level}")
        if not (math.isfinite(self.delta_p_m) and 1e-5 <= self.delta_p_m <= 0.1):
            raise SettingsError(f"delta_p_m must be between 1e-5 and 0.1 m, got {self.delta_p_m}")


class GaussianNumbers(NamedTuple):
    """The numbers of a test: of the method (an index of ``METHODS``) and of the joint risk (of ``JOINT_RISKS``)."""

    method: int
    joint_risk: int
    delta: float
    negligible: float
    delta_p_m: float
    cull: bool
    numeric_search: bool


class GaussianTest(NamedTuple):
    """All that a test needs, as compiled code reads it. Made by ``gaussian_test``.

    ``mean_m``, ``map`` and ``spread`` as in ``ObstacleArrays``. ``band_m`` (n, 2): nearer to the mean than the first
    an obstacle is surely refused, farther than the second surely accepted.
    """

    mean_m: Array
    map: Array
    spread: Array
    band_m: Array
    numbers: GaussianNumbers


def gaussian_test(
    obstacles: Sequence[GaussianObstacle], robot_radius_m: float, settings: GaussianCheckSettings
) -> GaussianTest:
    """Test of segments of a robot inside a ball of ``robot_radius_m`` (margin for tracking included).

    A pose in the mean shape of an obstacle is refused in any case (decision 14).
    """
    kind = METHODS.index(settings.method)
    radius_m = robot_radius_m + settings.delta_p_m / 2
    arrays = obstacle_arrays(obstacles, radius_m, settings.sigma_level if kind == 2 else 0.0)
    joint = JOINT_RISKS.index(settings.joint_risk)
    delta = settings.delta / max(len(obstacles), 1) if joint == 1 else settings.delta
    negligible = NEGLIGIBLE * delta / max(len(obstacles), 1)
    band_m = _band_m(kind, arrays, delta, negligible if joint == 2 else delta)
    numbers = GaussianNumbers(
        kind, joint, delta, negligible, settings.delta_p_m, settings.cull, settings.numeric_search
    )
    return GaussianTest(arrays.mean_m, arrays.map, arrays.spread, band_m, numbers)


def keep_out_m(obstacle: GaussianObstacle, robot_radius_m: float, settings: GaussianCheckSettings) -> float:
    """How near to the mean of a ball with isotropic noise the robot's center may come, were it the only obstacle.

    Raises:
        SettingsError: the obstacle is no ball or its noise not isotropic; it has no such single distance.
    """
    arrays = obstacle_arrays([obstacle], robot_radius_m, settings.sigma_level * (settings.method == "bounding_volume"))
    if not (obstacle.is_ball and arrays.spread[0, 0] == arrays.spread[0, 2]):
        raise SettingsError("only a ball with isotropic noise is kept out of a ball")
    return float(_band_m(METHODS.index(settings.method), arrays, settings.delta, settings.delta)[0, 1])


def _band_m(kind: int, arrays: ObstacleArrays, refuse_above: float, accept_below: float) -> Array:
    """Distances (n, 2) to the mean: surely a risk above ``refuse_above``, surely one below ``accept_below``.

    In units of the grown obstacle, noise with the largest (smallest) variance of the three in all directions
    makes every bound larger (smaller), and then it is a function of |w|.
    """
    least, largest = (np.sqrt(arrays.spread[:, column]) for column in (0, 2))
    if kind == 2:
        below, above = np.ones(len(least)), np.ones(len(least))
    elif kind == 1:
        scale = 4 / 3 * math.pi / np.sqrt((2 * math.pi) ** 3 * arrays.spread.prod(axis=1))
        below = 1 + least * np.sqrt(2 * np.maximum(np.log(scale / refuse_above), 0.0))
        above = 1 + largest * np.sqrt(2 * np.maximum(np.log(scale / accept_below), 0.0))
    else:
        below = 1 + least * math.sqrt(2) * erfcinv(2 * refuse_above)
        above = 1 + largest * math.sqrt(2) * erfcinv(2 * accept_below)
        if kind == 3:  # the half space bounds it from above; from below nothing does but the mean shape
            below = np.ones(len(least))
            for n in np.flatnonzero(arrays.spread[:, 0] == arrays.spread[:, 2]):
                below[n] = _where_ball_has_risk(refuse_above, largest[n], above[n])
                above[n] = _where_ball_has_risk(accept_below, largest[n], above[n])
    return np.column_stack([below * arrays.axis_m[:, 0], above * arrays.axis_m[:, 1]])


@compiled
def _where_ball_has_risk(delta, sigma, beyond):  # type: ignore[no-untyped-def]
    """Distance from the unit ball's center, at least 1, where the exact risk of isotropic noise has come to delta."""
    low, high = 1.0, beyond
    if collision_probability_of_ball(low, 1.0, sigma) <= delta:
        return low
    for _ in range(60):
        middle = 0.5 * (low + high)
        if collision_probability_of_ball(middle, 1.0, sigma) > delta:
            low = middle
        else:
            high = middle
    return high


@answers_segments(GaussianTest)
@compiled
def _segment(test, first, second):  # type: ignore[no-untyped-def]
    """Poses at most delta_p apart, both ends included, counted from the same end in both directions."""
    start, end = in_order(first, second)
    way = math.sqrt((end[0] - start[0]) ** 2 + (end[1] - start[1]) ** 2 + (end[2] - start[2]) ** 2)
    pieces = math.ceil(way / test.numbers.delta_p_m - 1e-9)
    if test.numbers.joint_risk == 2:
        return _joint(test, start, end, pieces)
    for n in range(len(test.mean_m)):
        if test.numbers.cull and _distance(test.mean_m[n], start, end) > test.band_m[n, 1] * (1.0 + 1e-9):
            continue
        for piece in range(pieces + 1):
            share = piece / max(pieces, 1)
            if not _is_clear(test, n, start, end, share):
                return False
    return True


@compiled
def _is_clear(test, n, start, end, share):  # type: ignore[no-untyped-def]
    """Whether obstacle n leaves the pose at ``share`` of a segment its part of delta."""
    x = start[0] + share * (end[0] - start[0]) - test.mean_m[n, 0]
    y = start[1] + share * (end[1] - start[1]) - test.mean_m[n, 1]
    z = start[2] + share * (end[2] - start[2]) - test.mean_m[n, 2]
    if test.numbers.cull:
        squared = x * x + y * y + z * z
        if squared > (test.band_m[n, 1] * (1.0 + 1e-9)) ** 2:
            return True
        if squared < (test.band_m[n, 0] * (1.0 - 1e-9)) ** 2:
            return False
    return _risk_at(test, n, x, y, z) <= test.numbers.delta


@compiled
def _risk_at(test, n, x, y, z):  # type: ignore[no-untyped-def]
    """The method's P(collision) at a place relative to the mean of obstacle n; 1 in its mean shape."""
    to = test.map[n]
    w = (
        to[0, 0] * x + to[0, 1] * y + to[0, 2] * z,
        to[1, 0] * x + to[1, 1] * y + to[1, 2] * z,
        to[2, 0] * x + to[2, 1] * y + to[2, 2] * z,
    )
    if w[0] * w[0] + w[1] * w[1] + w[2] * w[2] <= 1.0:
        return 1.0
    s = test.spread[n]
    return risk(test.numbers.method, test.numbers.numeric_search, w, (s[0], s[1], s[2]))


@compiled
def _joint(test, start, end, pieces):  # type: ignore[no-untyped-def]
    """Noisy-OR of all obstacles at each pose; those that are far count with a risk that is no less than theirs."""
    numbers = test.numbers
    for piece in range(pieces + 1):
        share = piece / max(pieces, 1)
        p_free = 1.0
        for n in range(len(test.mean_m)):
            x = start[0] + share * (end[0] - start[0]) - test.mean_m[n, 0]
            y = start[1] + share * (end[1] - start[1]) - test.mean_m[n, 1]
            z = start[2] + share * (end[2] - start[2]) - test.mean_m[n, 2]
            p = numbers.negligible
            if not numbers.cull or x * x + y * y + z * z <= (test.band_m[n, 1] * (1.0 + 1e-9)) ** 2:
                p = max(_risk_at(test, n, x, y, z), p)
            p_free *= 1.0 - p
            if not 1.0 - p_free <= numbers.delta:  # NaN is refused
                return False
    return True


@compiled
def _distance(point, start, end):  # type: ignore[no-untyped-def]
    """Distance of a point to a straight segment."""
    ux, uy, uz = end[0] - start[0], end[1] - start[1], end[2] - start[2]
    vx, vy, vz = point[0] - start[0], point[1] - start[1], point[2] - start[2]
    length = ux * ux + uy * uy + uz * uz
    share = 0.0
    if length > 0.0:
        share = min(max((ux * vx + uy * vy + uz * vz) / length, 0.0), 1.0)
    dx, dy, dz = vx - share * ux, vy - share * uy, vz - share * uz
    return math.sqrt(dx * dx + dy * dy + dz * dz)
