"""Refinement of a path that is already safe: shortcuts and moved vertices, each tested like any edge."""

import itertools
from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from deltasafe.compiling import compiled
from deltasafe.planning.constraint import ask_segment, segment_is_safe
from deltasafe.planning.cost import LineCost, path_cost, pose_distance, segment_cost

__all__ = ["refine_path"]

Array = NDArray[np.float64]
MOST_VERTICES = 64
SHORTEST_LEG_M = 0.005
"""Corners closer than this are merged where that is safe: a blend needs legs to lie in."""

MERGING_MAY_COST = 0.002


def refine_path(
    constraint: Any, cost: LineCost, poses: Array, lower: Array, upper: Array, n_steps: int, seed: int
) -> Array:
    """Lower the cost of a polyline (K, 4) by random local changes; both ends stay. It is never made unsafe.

    Half of the steps cut between two random places on the path, half move a vertex by a Gaussian step whose
    width shrinks as the steps run out. More than 64 vertices are left as they are. At last needless vertices
    are dropped and corners that almost coincide merged, which may cost up to 0.2 % each.
    """
    poses = np.ascontiguousarray(poses, dtype=np.float64)
    if n_steps < 1 or not 2 <= len(poses) <= MOST_VERTICES - 2:
        return poses
    bounds = (np.ascontiguousarray(value, dtype=np.float64) for value in (lower, upper))
    refined = np.asarray(_refine(constraint, cost, poses, *bounds, int(n_steps), np.random.default_rng(seed)))
    return _tidied(constraint, cost, refined)


def _tidied(constraint: Any, cost: LineCost, poses: Array) -> Array:
    n = 0
    while n < len(poses) - 1:
        best, least = None, path_cost(cost, poses) * (1 + MERGING_MAY_COST)
        for candidate in _candidates(cost, poses, n):
            if len(candidate) == len(poses) or path_cost(cost, candidate) > least:
                continue
            first, last = max(n - 1, 0), min(n + 1, len(candidate) - 1)
            changed = candidate[first : last + 1]
            if all(ask_segment(constraint, a, b) for a, b in itertools.pairwise(changed)):
                best, least = candidate, path_cost(cost, candidate)
        if best is None:
            n += 1
        else:
            poses, n = best, max(n - 1, 0)
    return poses


def _candidates(cost: LineCost, poses: Array, n: int) -> Iterator[Array]:
    """Polylines with one vertex less: without vertex n, or with a short leg n, n + 1 shrunk to a point."""
    if n > 0 and path_cost(cost, poses[[n - 1, n + 1]]) <= path_cost(cost, poses[n - 1 : n + 2]):
        yield np.delete(poses, n, axis=0)
    leg = pose_distance(cost.rotation_weight_m2, poses[n], poses[n + 1])
    if leg >= SHORTEST_LEG_M or len(poses) == 2:
        return
    if n == 0:
        yield np.delete(poses, 1, axis=0)
    elif n + 1 == len(poses) - 1:
        yield np.delete(poses, n, axis=0)
    else:
        # outward, toward where the legs before and after would meet
        before, after = poses[n] - poses[n - 1], poses[n + 1] - poses[n + 2]
        outward = before / np.linalg.norm(before) + after / np.linalg.norm(after)
        for share in (0.0, 0.25, 0.5, 1.0, 2.0):
            merged = (poses[n] + poses[n + 1]) / 2 + share * leg * outward
            yield np.concatenate([poses[:n], merged[None], poses[n + 2 :]])


@compiled
def _refine(constraint, cost, poses, lower, upper, n_steps, rng):  # type: ignore[no-untyped-def]
    path = np.empty((MOST_VERTICES, 4))
    count = len(poses)
    path[:count] = poses
    first, second, moved = np.empty(4), np.empty(4), np.empty(4)
    width = np.array([0.02, 0.02, 0.02, 0.2])
    for step in range(n_steps):
        if rng.random() < 0.5:
            count = _cut(constraint, cost, path, count, rng, first, second)
        elif count > 2:
            i = 1 + int(rng.random() * (count - 2))
            shrink = (1.0 - step / n_steps) ** 2 + 0.02
            for axis in range(4):
                value = path[i, axis] + shrink * width[axis] * rng.standard_normal()
                moved[axis] = min(max(value, lower[axis]), upper[axis])
            if rng.random() < 0.3:  # toward its neighbours in yaw: rotation is seldom needed
                moved[:3] = path[i, :3]
                moved[3] = path[i, 3] + rng.random() * (0.5 * (path[i - 1, 3] + path[i + 1, 3]) - path[i, 3])
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
def _cut(constraint, cost, path, count, rng, first, second):  # type: ignore[no-untyped-def]
    """Replace the path between two random places on it by a straight segment, if that is cheaper and safe."""
    a, b = rng.random() * (count - 1), rng.random() * (count - 1)
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
