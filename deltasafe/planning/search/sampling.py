"""Samples of the search: uniform, or restricted to poses through which a path could beat the best known cost."""

import math

from deltasafe.compute.counter_rng import normal_pair, splitmix64, uniform
from deltasafe.compute.numba_cache import inlined, kernel
from deltasafe.planning.search.cost import ROOT, least_cost, pose_distance

MAX_ATTEMPTS = 50


@inlined
def draw_pose(problem, start, goal, best_cost, key):  # type: ignore[no-untyped-def]
    """Draw a pose in bounds through which a path may cost less than ``best_cost``; a function of ``key`` alone.

    For the root cost, uniform in an ellipsoid (Gammell et al. 2014); for the others, by rejection. After 50 failed
    attempts, uniform in the bounds.
    """
    cost, lower, upper = problem.cost, problem.lower, problem.upper
    for attempt in range(MAX_ATTEMPTS if best_cost < math.inf else 0):
        attempt_key = splitmix64(key, attempt + 1)
        if cost.kind == ROOT:
            pose = _pose_in_ellipsoid(cost.rotation_weight_m2, start, goal, best_cost, attempt_key)
            in_bounds = True
            for axis in range(4):
                in_bounds &= lower[axis] <= pose[axis] <= upper[axis]
            if in_bounds:
                return pose
        else:
            pose = uniform_pose(lower, upper, attempt_key)
            if least_cost(cost, lower[2], start, pose) + least_cost(cost, lower[2], pose, goal) < best_cost:
                return pose
    return uniform_pose(lower, upper, key)


@inlined
def uniform_pose(lower, upper, key):  # type: ignore[no-untyped-def]
    """Draw uniformly between two poses."""
    return (
        lower[0] + (upper[0] - lower[0]) * uniform(key, 0),
        lower[1] + (upper[1] - lower[1]) * uniform(key, 1),
        lower[2] + (upper[2] - lower[2]) * uniform(key, 2),
        lower[3] + (upper[3] - lower[3]) * uniform(key, 3),
    )


@kernel
def _pose_in_ellipsoid(rotation_weight_m2, start, goal, length, key):  # type: ignore[no-untyped-def]
    """Draw uniformly from the poses whose distances to start and goal sum to at most ``length``."""
    scale = math.sqrt(rotation_weight_m2)
    direct = pose_distance(rotation_weight_m2, start, goal)
    a, b = normal_pair(key, 0)
    c, d = normal_pair(key, 2)
    # a point of the ball of radius 1/2, stretched along the first axis to the ellipsoid
    radius = 0.5 * math.sqrt(math.sqrt(uniform(key, 4))) / max(math.sqrt(a * a + b * b + c * c + d * d), 1e-300)
    across = radius * math.sqrt(max(length * length - direct * direct, 0.0))
    a, b, c, d = radius * length * a, across * b, across * c, across * d
    if direct > 0.0:  # Householder reflection that maps the first axis to the line from start to goal
        m0, m1 = (goal[0] - start[0]) / direct - 1.0, (goal[1] - start[1]) / direct
        m2, m3 = (goal[2] - start[2]) / direct, (goal[3] - start[3]) * scale / direct
        squared = m0 * m0 + m1 * m1 + m2 * m2 + m3 * m3
        if squared > 1e-12:
            factor = 2.0 * (m0 * a + m1 * b + m2 * c + m3 * d) / squared
            a, b, c, d = a - factor * m0, b - factor * m1, c - factor * m2, d - factor * m3
    return (
        0.5 * (start[0] + goal[0]) + a,
        0.5 * (start[1] + goal[1]) + b,
        0.5 * (start[2] + goal[2]) + c,
        0.5 * (start[3] + goal[3]) + d / scale,
    )
