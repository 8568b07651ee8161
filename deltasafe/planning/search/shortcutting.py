"""Refinement of a path that is already safe: shortcuts and moved vertices, each tested like any edge."""

import itertools
import math
import time
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from deltasafe.compute.counter_rng import mixed, normal_pair, uniform
from deltasafe.compute.numba_cache import kernel
from deltasafe.geometry import as_rows
from deltasafe.planning.collision.segment_query import as_pose, ask_segment, segment_is_safe
from deltasafe.planning.search.cost import LineCost, path_cost, pose_distance, segment_cost
from deltasafe.planning.search.rrt_star import require_budget

__all__ = ["refine_path"]

Array = NDArray[np.float64]
MOST_VERTICES = 64
CHUNK = 16
SHORTEST_LEG_M = 0.005
"""Corners closer than this are merged where that is safe: a blend needs legs to lie in."""

MERGING_MAY_COST = 0.002


def refine_path(
    constraint: Any,
    cost: LineCost,
    poses: Array,
    lower: Array,
    upper: Array,
    n_steps: int | None,
    seed: int,
    deadline_s: float = math.inf,
    clock: Callable[[], float] = time.perf_counter,
) -> Array:
    """Lower the cost of a polyline (K, 4) by local changes; both ends stay. It is never made unsafe.

    Half of the steps cut between two random places on the path; the others move a vertex, toward the straight line
    between its neighbors or by a Gaussian step whose width shrinks as steps or time run out. More than 64 vertices
    are left as they are. At last needless vertices are dropped and corners that almost coincide merged, which may cost
    up to 0.2 % each.

    Args:
        constraint, cost: as of the search.
        poses: (K, 4).
        lower, upper: bounds of the poses (4,).
        n_steps: changes tried; None leaves it to the deadline.
        seed: of the changes.
        deadline_s, clock: no change is begun once the clock is there; read every 16 steps.

    Raises:
        SettingsError: neither steps nor a deadline, steps that are no whole number, or poses or bounds that are not
            finite.
    """
    require_budget("a refinement", n_steps, deadline_s)
    poses = as_rows(poses, 4, "poses")
    if not 2 <= len(poses) <= MOST_VERTICES - 2 or (n_steps is not None and n_steps < 1):
        return poses
    path, count = np.empty((MOST_VERTICES, 4)), len(poses)
    path[:count] = poses
    bounds = tuple(map(tuple, as_rows((lower, upper), 4, "the bounds of a refinement").tolist()))
    began, step = clock(), 0
    while n_steps is None or step < n_steps:
        now = clock() if deadline_s < math.inf else began
        if now >= deadline_s:
            break
        passed = (now - began) / (deadline_s - began) if deadline_s < math.inf else 0.0
        passed = max(passed, step / n_steps if n_steps is not None else 0.0)
        upto = step + CHUNK if n_steps is None else min(step + CHUNK, n_steps)
        count = _refine(constraint, cost, path, count, *bounds, step, upto, passed, np.uint64(seed))
        step = upto
    return _tidied(constraint, cost, path[:count].copy())


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


@kernel
def _refine(constraint, cost, path, count, lower, upper, step, upto, passed, seed):  # type: ignore[no-untyped-def]
    """Steps up to number ``upto`` on the first ``count`` vertices of ``path``; returns how many there are now."""
    width = (1.0 - passed) ** 2 + 0.02
    for number in range(step, upto):
        key = mixed(seed, number + 1)
        if uniform(key, 0) < 0.5:
            a, b = uniform(key, 1) * (count - 1), uniform(key, 2) * (count - 1)
            count = _cut(constraint, cost, path, count, min(a, b), max(a, b))
        elif count > 2:
            i = 1 + int(uniform(key, 1) * (count - 2))
            _move(constraint, cost, path, i, lower, upper, width, key)
    return count


@kernel
def _move(constraint, cost, path, i, lower, upper, width, key):  # type: ignore[no-untyped-def]
    """Put vertex i somewhere else, if that is cheaper and safe."""
    before, here, after = as_pose(path[i - 1]), as_pose(path[i]), as_pose(path[i + 1])
    kind, share = uniform(key, 2), uniform(key, 3)
    if kind < 0.3:  # toward the straight line between its neighbors
        to, on = (
            pose_distance(cost.rotation_weight_m2, before, here),
            pose_distance(cost.rotation_weight_m2, here, after),
        )
        along = to / max(to + on, 1e-12)
        moved = (
            here[0] + share * (before[0] + along * (after[0] - before[0]) - here[0]),
            here[1] + share * (before[1] + along * (after[1] - before[1]) - here[1]),
            here[2] + share * (before[2] + along * (after[2] - before[2]) - here[2]),
            here[3] + share * (before[3] + along * (after[3] - before[3]) - here[3]),
        )
    elif kind < 0.5:  # toward its neighbors in yaw alone: rotation is seldom needed
        moved = here[0], here[1], here[2], here[3] + share * (0.5 * (before[3] + after[3]) - here[3])
    else:
        a, b = normal_pair(key, 4)
        c, d = normal_pair(key, 6)
        reach = 0.02 * width
        moved = (
            min(max(here[0] + reach * a, lower[0]), upper[0]),
            min(max(here[1] + reach * b, lower[1]), upper[1]),
            min(max(here[2] + reach * c, lower[2]), upper[2]),
            min(max(here[3] + 10.0 * reach * d, lower[3]), upper[3]),
        )
    old = segment_cost(cost, before, here) + segment_cost(cost, here, after)
    new = segment_cost(cost, before, moved) + segment_cost(cost, moved, after)
    if new < old - 1e-12 and segment_is_safe(constraint, before, moved) and segment_is_safe(constraint, moved, after):
        path[i, 0], path[i, 1], path[i, 2], path[i, 3] = moved


@kernel
def _between(path, i, share, count):  # type: ignore[no-untyped-def]
    a, b = as_pose(path[i]), as_pose(path[min(i + 1, count - 1)])
    return (
        a[0] + share * (b[0] - a[0]),
        a[1] + share * (b[1] - a[1]),
        a[2] + share * (b[2] - a[2]),
        a[3] + share * (b[3] - a[3]),
    )


@kernel
def _cut(constraint, cost, path, count, begin, end):  # type: ignore[no-untyped-def]
    """Replace the path between two places on it by a straight segment, if that is cheaper and safe."""
    i, s = _place(begin)
    j, t = _place(end)
    after = j + 1 if t > 0.0 else j  # the first vertex beyond the cut
    if after - i < 2 or (i + 1 == j and t == 0.0):
        return count
    first, second = _between(path, i, s, count), _between(path, j, t, count)
    new, old = segment_cost(cost, first, second), 0.0
    for n in range(i, after):
        old += segment_cost(cost, as_pose(path[n]), as_pose(path[n + 1]))
    if s > 0.0:
        new += segment_cost(cost, as_pose(path[i]), first)
    if t > 0.0:
        new += segment_cost(cost, second, as_pose(path[after]))
    ends = (1 if s > 0.0 else 0) + (1 if t > 0.0 else 0)
    if i + 1 + ends + count - after > len(path) or new >= old - 1e-12:
        return count
    if not segment_is_safe(constraint, first, second):
        return count
    # a conservative test may pass a segment and refuse a piece of it, so the pieces that stay are asked as well
    if s > 0.0 and not segment_is_safe(constraint, as_pose(path[i]), first):
        return count
    if t > 0.0 and not segment_is_safe(constraint, second, as_pose(path[after])):
        return count
    shift = i + 1 + ends - after
    rows = range(after, count) if shift <= 0 else range(count - 1, after - 1, -1)
    for n in rows:
        for axis in range(4):
            path[n + shift, axis] = path[n, axis]
    place = i + 1
    if s > 0.0:
        path[place, 0], path[place, 1], path[place, 2], path[place, 3] = first
        place += 1
    if t > 0.0:
        path[place, 0], path[place, 1], path[place, 2], path[place, 3] = second
    return count + shift


@kernel
def _place(parameter):  # type: ignore[no-untyped-def]
    """Segment and share of it; near a vertex the vertex itself, so that vertices can vanish."""
    segment = int(parameter)
    share = parameter - segment
    if share > 0.9:
        return segment + 1, 0.0
    return segment, 0.0 if share < 0.1 else share
