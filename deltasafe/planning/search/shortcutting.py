"""Refinement of a safe path by shortcuts and moved vertices, each tested like an edge of the search."""

import itertools
import math
import time
from collections.abc import Callable, Iterator

import numpy as np
from numpy.typing import NDArray

from deltasafe.compute.counter_rng import normal_pair, splitmix64, uniform
from deltasafe.compute.numba_cache import inlined, kernel
from deltasafe.geometry import as_rows
from deltasafe.planning.collision.segment import pose_at
from deltasafe.planning.collision.segment_query import as_pose, segment_is_safe, segment_passes
from deltasafe.planning.search.cost import path_cost, pose_distance, segment_cost
from deltasafe.planning.search.problem import SearchProblem, require_budget

Array = NDArray[np.float64]
MAX_VERTICES = 64
CHUNK = 16
"""Steps between two readings of the clock."""

MIN_LEG_M = 0.005
"""Vertices closer than this are merged where that is safe: blending a corner needs some length on both legs."""

MERGE_COST_FRACTION = 0.002
MIN_GAIN = 1e-12


def refine_path(
    problem: SearchProblem,
    poses: Array,
    n_steps: int | None,
    seed: int,
    deadline_s: float = math.inf,
    clock: Callable[[], float] = time.perf_counter,
) -> Array:
    """Lower the cost of a safe polyline (K, 4) by local changes; both ends stay, and the path stays safe.

    Half of the steps cut between two random places on the path. The others move a vertex: toward the line between its
    neighbors, or by a Gaussian step whose width shrinks as steps or time run out. Finally, needless vertices are
    removed and corners that almost coincide are merged, which may cost up to 0.2 % each. The path stays within the
    bounds if it lies there. A path of more than 62
    vertices is returned unchanged.

    Args:
        problem: constraint, cost and bounds, as of the search.
        poses: (K, 4).
        n_steps: changes to try; None for no limit but the deadline.
        seed: of the changes.
        deadline_s, clock: stop when the clock reaches the deadline; it is read every 16 steps.

    Raises:
        SettingsError: neither steps nor a deadline, a number of steps that is not whole, or poses that are not finite.
    """
    require_budget("a refinement", n_steps, deadline_s)
    poses = as_rows(poses, 4, "poses")
    if not 2 <= len(poses) <= MAX_VERTICES - 2 or (n_steps is not None and n_steps < 1):
        return poses
    path, count = np.empty((MAX_VERTICES, 4)), len(poses)
    path[:count] = poses
    began_s, step = clock(), 0
    while n_steps is None or step < n_steps:
        now_s = clock() if deadline_s < math.inf else began_s
        if now_s >= deadline_s:
            break
        progress = (now_s - began_s) / (deadline_s - began_s) if deadline_s < math.inf else 0.0
        progress = max(progress, step / n_steps if n_steps is not None else 0.0)
        end = step + CHUNK if n_steps is None else min(step + CHUNK, n_steps)
        count = _refine(problem, path, count, (step, end), progress, np.uint64(seed))
        step = end
    return _merge_vertices(problem, path[:count].copy())


def _merge_vertices(problem: SearchProblem, poses: Array) -> Array:
    """Remove vertices one by one while that is safe and costs at most ``MERGE_COST_FRACTION``."""
    n = 0
    while n < len(poses) - 1:
        best, best_cost = None, path_cost(problem.cost, poses) * (1 + MERGE_COST_FRACTION)
        for candidate in _with_vertex_removed(problem, poses, n):
            if len(candidate) == len(poses) or path_cost(problem.cost, candidate) > best_cost:
                continue
            if not ((candidate >= problem.lower) & (candidate <= problem.upper)).all():
                continue
            changed = candidate[max(n - 1, 0) : min(n + 1, len(candidate) - 1) + 1]
            if all(segment_passes(problem.constraint, a, b) for a, b in itertools.pairwise(changed)):
                best, best_cost = candidate, path_cost(problem.cost, candidate)
        if best is None:
            n += 1
        else:
            poses, n = best, max(n - 1, 0)
    return poses


def _with_vertex_removed(problem: SearchProblem, poses: Array, n: int) -> Iterator[Array]:
    """Polylines without vertex n, or with the leg from n to n + 1 shrunk to a point if it is short."""
    if n > 0 and path_cost(problem.cost, poses[[n - 1, n + 1]]) <= path_cost(problem.cost, poses[n - 1 : n + 2]):
        yield np.delete(poses, n, axis=0)
    leg = pose_distance(problem.cost.rotation_weight_m2, poses[n], poses[n + 1])
    if leg >= MIN_LEG_M or len(poses) == 2:
        return
    if n == 0:
        yield np.delete(poses, 1, axis=0)
    elif n + 1 == len(poses) - 1:
        yield np.delete(poses, n, axis=0)
    else:
        # outward: toward the point where the legs before and after would meet
        before, after = poses[n] - poses[n - 1], poses[n + 1] - poses[n + 2]
        outward = before / np.linalg.norm(before) + after / np.linalg.norm(after)
        for factor in (0.0, 0.25, 0.5, 1.0, 2.0):
            merged = (poses[n] + poses[n + 1]) / 2 + factor * leg * outward
            yield np.concatenate([poses[:n], merged[None], poses[n + 2 :]])


@kernel
def _refine(problem, path, count, steps, progress, seed):  # type: ignore[no-untyped-def]
    """Run a range of steps on the first ``count`` vertices of ``path``; return the new number of vertices."""
    width = (1.0 - progress) ** 2 + 0.02
    for step in range(steps[0], steps[1]):
        key = splitmix64(seed, step + 1)
        if uniform(key, 0) < 0.5:
            a, b = uniform(key, 1) * (count - 1), uniform(key, 2) * (count - 1)
            count = _cut(problem, path, count, _place(min(a, b)), _place(max(a, b)))
        elif count > 2:
            _move(problem, path, 1 + int(uniform(key, 1) * (count - 2)), width, key)
    return count


@kernel
def _move(problem, path, i, width, key):  # type: ignore[no-untyped-def]
    """Move vertex i, if that is cheaper and safe."""
    cost, constraint = problem.cost, problem.constraint
    before, here, after = as_pose(path[i - 1]), as_pose(path[i]), as_pose(path[i + 1])
    kind, fraction = uniform(key, 2), uniform(key, 3)
    if kind < 0.3:  # toward the straight line between its neighbors
        back = pose_distance(cost.rotation_weight_m2, before, here)
        ahead = pose_distance(cost.rotation_weight_m2, here, after)
        moved = pose_at(here, pose_at(before, after, back / max(back + ahead, 1e-12)), fraction)
    elif kind < 0.5:  # toward its neighbors in yaw alone: rotation is seldom needed
        moved = here[0], here[1], here[2], here[3] + fraction * (0.5 * (before[3] + after[3]) - here[3])
    else:
        moved = _gaussian_step(problem, here, 0.02 * width, key)
    old = segment_cost(cost, before, here) + segment_cost(cost, here, after)
    new = segment_cost(cost, before, moved) + segment_cost(cost, moved, after)
    if (
        new < old - MIN_GAIN
        and segment_is_safe(constraint, before, moved)
        and segment_is_safe(constraint, moved, after)
    ):
        _set_vertex(path, i, moved)


@inlined
def _gaussian_step(problem, pose, sigma, key):  # type: ignore[no-untyped-def]
    """Add a Gaussian step, ten times wider in yaw, and clip to the bounds."""
    lower, upper = problem.lower, problem.upper
    a, b = normal_pair(key, 4)
    c, d = normal_pair(key, 6)
    return (
        min(max(pose[0] + sigma * a, lower[0]), upper[0]),
        min(max(pose[1] + sigma * b, lower[1]), upper[1]),
        min(max(pose[2] + sigma * c, lower[2]), upper[2]),
        min(max(pose[3] + 10.0 * sigma * d, lower[3]), upper[3]),
    )


@kernel
def _cut(problem, path, count, begin, end):  # type: ignore[no-untyped-def]
    """Replace the path between two places by a straight segment, if that is cheaper and safe; return the new count."""
    cost, constraint = problem.cost, problem.constraint
    i, s = begin
    j, t = end
    after = j + 1 if t > 0.0 else j  # first vertex beyond the cut
    if after - i < 2 or (i + 1 == j and t == 0.0):
        return count
    first, second = _pose_on(path, i, s, count), _pose_on(path, j, t, count)
    new, old = segment_cost(cost, first, second), 0.0
    for n in range(i, after):
        old += segment_cost(cost, as_pose(path[n]), as_pose(path[n + 1]))
    if s > 0.0:
        new += segment_cost(cost, as_pose(path[i]), first)
    if t > 0.0:
        new += segment_cost(cost, second, as_pose(path[after]))
    n_inserted = (1 if s > 0.0 else 0) + (1 if t > 0.0 else 0)
    if i + 1 + n_inserted + count - after > len(path) or new >= old - MIN_GAIN:
        return count
    if not segment_is_safe(constraint, first, second):
        return count
    # a conservative test may accept a segment and refuse a piece of it, so the remaining pieces are tested as well
    if s > 0.0 and not segment_is_safe(constraint, as_pose(path[i]), first):
        return count
    if t > 0.0 and not segment_is_safe(constraint, second, as_pose(path[after])):
        return count
    shift = i + 1 + n_inserted - after
    rows = range(after, count) if shift <= 0 else range(count - 1, after - 1, -1)
    for n in rows:
        _set_vertex(path, n + shift, as_pose(path[n]))
    if s > 0.0:
        _set_vertex(path, i + 1, first)
    if t > 0.0:
        _set_vertex(path, i + n_inserted, second)
    return count + shift


@inlined
def _set_vertex(path, i, pose):  # type: ignore[no-untyped-def]
    path[i, 0], path[i, 1], path[i, 2], path[i, 3] = pose


@kernel
def _pose_on(path, i, fraction, count):  # type: ignore[no-untyped-def]
    return pose_at(as_pose(path[i]), as_pose(path[min(i + 1, count - 1)]), fraction)


@kernel
def _place(parameter):  # type: ignore[no-untyped-def]
    """Split a path parameter into segment and fraction, which is 0 near a vertex, so that cuts remove vertices."""
    segment = int(parameter)
    fraction = parameter - segment
    if fraction > 0.9:
        return segment + 1, 0.0
    return segment, 0.0 if fraction < 0.1 else fraction
