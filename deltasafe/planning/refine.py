"""Refinement of a path that is already safe: shortcuts and moved vertices, each tested like any edge."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from deltasafe.compiling import compiled
from deltasafe.planning.constraint import segment_is_safe
from deltasafe.planning.cost import LineCost, segment_cost

__all__ = ["refine_path"]

Array = NDArray[np.float64]
MOST_VERTICES = 64


def refine_path(
    constraint: Any, cost: LineCost, poses: Array, lower: Array, upper: Array, n_steps: int, seed: int
) -> Array:
    """Lower the cost of a polyline (K, 4) by random local changes; both ends stay. Never returns a dearer path.

    Half of the steps cut between two random places on the path, half move a vertex by a Gaussian step whose
    width shrinks as the steps run out. More than 64 vertices are left as they are.
    """
    poses = np.ascontiguousarray(poses, dtype=np.float64)
    if n_steps < 1 or not 2 <= len(poses) <= MOST_VERTICES - 2:
        return poses
    bounds = (np.ascontiguousarray(value, dtype=np.float64) for value in (lower, upper))
    return np.asarray(_refine(constraint, cost, poses, *bounds, int(n_steps), int(seed) % 2**32))


@compiled
def _refine(constraint, cost, poses, lower, upper, n_steps, seed):  # type: ignore[no-untyped-def]
    np.random.seed(seed)
    path = np.empty((MOST_VERTICES, 4))
    count = len(poses)
    path[:count] = poses
    first, second, moved = np.empty(4), np.empty(4), np.empty(4)
    width = np.array([0.02, 0.02, 0.02, 0.2])
    for step in range(n_steps):
        if np.random.random() < 0.5:
            count = _cut(constraint, cost, path, count, first, second)
        elif count > 2:
            i = 1 + int(np.random.random() * (count - 2))
            shrink = (1.0 - step / n_steps) ** 2 + 0.02
            for axis in range(4):
                value = path[i, axis] + shrink * width[axis] * np.random.standard_normal()
                moved[axis] = min(max(value, lower[axis]), upper[axis])
            if np.random.random() < 0.3:  # toward its neighbours in yaw: rotation is seldom needed
                moved[:3] = path[i, :3]
                moved[3] = path[i, 3] + np.random.random() * (
                    0.5 * (path[i - 1, 3] + path[i + 1, 3]) - path[i, 3]
                )
            old = segment_cost(cost, path[i - 1], path[i]) + segment_cost(cost, path[i], path[i + 1])
            new = segment_cost(cost, path[i - 1], moved) + segment_cost(cost, moved, path[i + 1])
            if (
                new < old - 1e-12
                and segment_is_safe(constraint, path[i - 1], moved)
                and segment_is_safe(constraint, moved, path[i + 1])
            ):
                path[i] = moved
    return path[:count].copy()


@compiled
def _cut(constraint, cost, path, count, first, second):  # type: ignore[no-untyped-def]
    """Replace the path between two random places on it by a straight segment, if that is cheaper and safe."""
    a, b = np.random.random() * (count - 1), np.random.random() * (count - 1)
    i, s = _place(min(a, b))
    j, t = _place(max(a, b))
    after = j + 1 if t > 0.0 else j  # the first vertex beyond the cut
    if after - i < 2 or (i + 1 == j and t == 0.0):
        return count
    first[:] = path[i] + s * (path[min(i + 1, count - 1)] - path[i])
    second[:] = path[j] + t * (path[min(j + 1, count - 1)] - path[j])
    new = segment_cost(cost, first, second)
    old = 0.0
    for n in range(i, after):
        old += segment_cost(cost, path[n], path[n + 1])
    if s > 0.0:
        new += segment_cost(cost, path[i], first)
    if t > 0.0:
        new += segment_cost(cost, second, path[after])
    ends = (1 if s > 0.0 else 0) + (1 if t > 0.0 else 0)
    if i + 1 + ends + count - after > len(path) or new >= old - 1e-12:
        return count
    if not segment_is_safe(constraint, first, second):
        return count
    # a conservative test may pass a segment and refuse a piece of it, so the pieces that stay are asked as well
    if s > 0.0 and not segment_is_safe(constraint, path[i], first):
        return count
    if t > 0.0 and not segment_is_safe(constraint, second, path[after]):
        return count
    kept = path[after:count].copy()
    place = i + 1
    if s > 0.0:
        path[place] = first
        place += 1
    if t > 0.0:
        path[place] = second
        place += 1
    path[place : place + len(kept)] = kept
    return place + len(kept)


@compiled
def _place(parameter):  # type: ignore[no-untyped-def]
    """Segment and share of it; near a vertex the vertex itself, so that vertices can vanish."""
    segment = int(parameter)
    share = parameter - segment
    if share > 0.9:
        return segment + 1, 0.0
    return segment, 0.0 if share < 0.1 else share
