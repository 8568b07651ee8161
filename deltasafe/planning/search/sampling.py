"""Where the search looks: uniformly, or only where a path through the place could beat the best one known."""

import math

from deltasafe.compute.counter_rng import mixed, normal_pair, uniform
from deltasafe.compute.numba_cache import inlined, kernel
from deltasafe.planning.search.cost import least_cost, pose_distance

__all__ = ["draw_pose", "uniform_pose"]

ATTEMPTS = 50


@inlined
def draw_pose(cost, start, goal, lower, upper, best, key):  # type: ignore[no-untyped-def]
    """A pose in bounds, of those through which a path may cost less than ``best``; a function of ``key`` alone.

    Uniform in the ellipsoid of the root cost (Gammell et al. 2014), by rejection for the others; after 50 vain
    attempts uniform in the bounds.
    """
    for attempt in range(ATTEMPTS if best < math.inf else 0):
        here = mixed(key, attempt + 1)
        if cost.kind == 0:
            pose = _in_ellipsoid(cost.rotation_weight_m2, start, goal, best, here)
            inside = True
            for axis in range(4):
                inside &= lower[axis] <= pose[axis] <= upper[axis]
            if inside:
                return pose
        else:
            pose = uniform_pose(lower, upper, here)
            if least_cost(cost, lower[2], start, pose) + least_cost(cost, lower[2], pose, goal) < best:
                return pose
    return uniform_pose(lower, upper, key)


@inlined
def uniform_pose(lower, upper, key):  # type: ignore[no-untyped-def]
    """A pose between two, uniformly."""
    return (
        lower[0] + (upper[0] - lower[0]) * uniform(key, 0),
        lower[1] + (upper[1] - lower[1]) * uniform(key, 1),
        lower[2] + (upper[2] - lower[2]) * uniform(key, 2),
        lower[3] + (upper[3] - lower[3]) * uniform(key, 3),
    )


@kernel
def _in_ellipsoid(rotation_weight_m2, start, goal, best, key):  # type: ignore[no-untyped-def]
    """Uniform among the poses whose distances to start and goal sum up to ``best`` at most."""
    scale = math.sqrt(rotation_weight_m2)
    direct = pose_distance(rotation_weight_m2, start, goal)
    a, b = normal_pair(key, 0)
    c, d = normal_pair(key, 2)
    radius = 0.5 * math.sqrt(math.sqrt(uniform(key, 4))) / max(math.sqrt(a * a + b * b + c * c + d * d), 1e-300)
    across = radius * math.sqrt(max(best * best - direct * direct, 0.0))
    a, b, c, d = radius * best * a, across * b, across * c, across * d
    if direct > 0.0:  # the reflection that takes the first axis to the line from start to goal
        m0, m1 = (goal[0] - start[0]) / direct - 1.0, (goal[1] - start[1]) / direct
        m2, m3 = (goal[2] - start[2]) / direct, (goal[3] - start[3]) * scale / direct
        size = m0 * m0 + m1 * m1 + m2 * m2 + m3 * m3
        if size > 1e-12:
            share = 2.0 * (m0 * a + m1 * b + m2 * c + m3 * d) / size
            a, b, c, d = a - share * m0, b - share * m1, c - share * m2, d - share * m3
    return (
        0.5 * (start[0] + goal[0]) + a,
        0.5 * (start[1] + goal[1]) + b,
        0.5 * (start[2] + goal[2]) + c,
        0.5 * (start[3] + goal[3]) + d / scale,
    )
