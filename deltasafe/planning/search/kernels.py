"""The iterations of RRT*, compiled, on the flat arrays of a search."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from deltasafe.compute.counter_rng import mixed, uniform
from deltasafe.compute.numba_cache import compiled, inlined, kernel
from deltasafe.planning.collision.segment_query import segment_is_safe
from deltasafe.planning.search.cost import least_cost, segment_cost
from deltasafe.planning.search.neighbors import Neighbors, add_point, k_nearest, nearest, within
from deltasafe.planning.search.sampling import draw_pose
from deltasafe.planning.search.tree import TreeArrays, attach, move, pose_of, set_pose

__all__ = ["Search", "SearchParams", "begin", "copy_points", "grow", "keep_valid"]

Array = NDArray[np.float64]


class SearchParams(NamedTuple):
    """The numbers of a search, as compiled code reads them."""

    n_goals: int
    steering_range_m: float
    goal_bias: float
    near_factor: float
    by_radius: bool
    radius_m: float
    informed: bool
    seed: int


class Search(NamedTuple):
    """The state of a search. Goals are nodes 0 to G - 1, the start is node G; node n is point n - G.

    ``counts`` holds the numbers of points and of iterations, and the first iteration with a path (-1: none).
    """

    tree: TreeArrays
    known: Neighbors
    step: Array
    total: Array
    counts: NDArray[np.int64]


@inlined
def _scaled(cost, pose):  # type: ignore[no-untyped-def]
    return pose[0], pose[1], pose[2], math.sqrt(cost.rotation_weight_m2) * pose[3]


@kernel
def begin(search, constraint, cost, numbers):  # type: ignore[no-untyped-def]
    """The start is point 0; goals that a straight segment reaches hang from it."""
    tree, root = search.tree, numbers.n_goals
    if search.counts[0] == 0:
        add_point(search.known, 0, _scaled(cost, pose_of(tree, root)))
        search.known.reach[0] = numbers.steering_range_m * numbers.steering_range_m
        search.counts[0] = 1
    for goal in range(root):
        if tree.parent[goal] < 0 and segment_is_safe(constraint, pose_of(tree, root), pose_of(tree, goal)):
            attach(tree, goal, root, segment_cost(cost, pose_of(tree, root), pose_of(tree, goal)))
            if search.counts[2] < 0:
                search.counts[2] = search.counts[1]


@kernel
def grow(search, constraint, cost, numbers, lower, upper, upto):  # type: ignore[no-untyped-def]
    """Iterations up to number ``upto``."""
    tree, known, counts, goals = search.tree, search.known, search.counts, numbers.n_goals
    for iteration in range(counts[1], upto):
        counts[1] = iteration + 1
        key = mixed(np.uint64(numbers.seed), iteration + 1)
        target, sample = _sample(tree, cost, numbers, lower, upper, key)
        place, squared = nearest(known, counts[0], _scaled(cost, sample))
        origin = pose_of(tree, place + goals)
        distance = math.sqrt(squared)
        if distance == 0.0:
            continue
        new, whole = sample, distance <= numbers.steering_range_m
        if not whole:
            reach = numbers.steering_range_m / distance
            new = (
                origin[0] + reach * (sample[0] - origin[0]),
                origin[1] + reach * (sample[1] - origin[1]),
                origin[2] + reach * (sample[2] - origin[2]),
                origin[3] + reach * (sample[3] - origin[3]),
            )
        if numbers.informed and not _may_improve(tree, cost, goals, lower[2], new):
            continue
        if not segment_is_safe(constraint, new, new):
            continue
        m = _near(search, cost, numbers, new, place, whole)
        best = _cheapest_parent(search, constraint, cost, new, m)
        if best < 0:
            continue
        if target >= 0 and whole:
            if tree.parent[target] < 0:
                attach(tree, target, best, search.total[0])
                if counts[2] < 0:
                    counts[2] = iteration
            continue
        this = counts[0] + goals
        set_pose(tree, this, new)
        add_point(known, counts[0], _scaled(cost, new))
        counts[0] += 1
        attach(tree, this, best, search.total[0])
        _rewire(search, constraint, this, m)
        for goal in range(goals):
            _reach_goal(search, constraint, cost, numbers, goal, this, iteration)


@inlined
def _sample(tree, cost, numbers, lower, upper, key):  # type: ignore[no-untyped-def]
    """The goal aimed at, or -1, and a pose."""
    goals = numbers.n_goals
    goal = min(int(goals * uniform(key, 5)), goals - 1)
    if tree.parent[goal] < 0 and uniform(key, 6) < numbers.goal_bias:
        return goal, pose_of(tree, goal)
    best = tree.cost[goal] if numbers.informed else np.inf
    return -1, draw_pose(cost, pose_of(tree, goals), pose_of(tree, goal), lower, upper, best, key)


@inlined
def _may_improve(tree, cost, goals, lowest_z, pose):  # type: ignore[no-untyped-def]
    from_start = least_cost(cost, lowest_z, pose_of(tree, goals), pose)
    for goal in range(goals):
        if from_start + least_cost(cost, lowest_z, pose, pose_of(tree, goal)) < tree.cost[goal]:
            return True
    return False


@inlined
def _near(search, cost, numbers, new, place, measured):  # type: ignore[no-untyped-def]
    """The near set of a pose as nodes in ``known.found``; returns its size. ``place`` is the nearest point."""
    known, count, goals = search.known, search.counts[0], numbers.n_goals
    if numbers.by_radius:
        share = math.log(count + 1.0) / (count + 1.0)
        radius = min(numbers.near_factor * numbers.radius_m * share**0.25, numbers.steering_range_m)
        m = within(known, count, _scaled(cost, new), radius * radius * (1 + 1e-6))
        if m == 0:
            known.found[0], m = place, 1
    else:
        k = max(1, int(numbers.near_factor * math.e * 1.25 * math.log(count + 1.0)))
        scale = math.sqrt(k / count)  # the squared radius of k of n points in four dimensions
        guess = 1.1 * known.reach[place] * scale
        m, squared = k_nearest(known, count, _scaled(cost, new), k, max(guess, 1e-6), measured)
        known.reach[count] = squared / scale
    for n in range(m):
        known.found[n] += goals
    return m


@inlined
def _cheapest_parent(search, constraint, cost, new, m):  # type: ignore[no-untyped-def]
    """The cheapest node of the near set from which the segment is safe, or -1; ``total[0]`` becomes its cost.

    Lazily, in order of cost. Nodes whose segment was refused leave the near set (their entry becomes -1).
    """
    tree, found, step, total = search.tree, search.known.found, search.step, search.total
    for n in range(m):
        step[n] = segment_cost(cost, pose_of(tree, found[n]), new)
        total[n] = tree.cost[found[n]] + step[n]
    for _ in range(m):
        best = 0
        for n in range(1, m):
            if total[n] < total[best]:
                best = n
        if total[best] == np.inf:
            return -1
        node = found[best]
        if segment_is_safe(constraint, pose_of(tree, node), new):
            total[0] = total[best]
            found[best] = -1
            return node
        total[best] = np.inf
        found[best] = -1
    return -1


@inlined
def _rewire(search, constraint, this, m):  # type: ignore[no-untyped-def]
    """Near nodes that are cheaper through the new one are moved there; segments cost the same both ways."""
    tree, found, step = search.tree, search.known.found, search.step
    new, so_far = pose_of(tree, this), search.tree.cost[this]
    for n in range(m):
        node = found[n]
        if node >= 0 and so_far + step[n] < tree.cost[node] and segment_is_safe(constraint, new, pose_of(tree, node)):
            move(tree, node, this, so_far + step[n])


@inlined
def _reach_goal(search, constraint, cost, numbers, goal, this, iteration):  # type: ignore[no-untyped-def]
    tree = search.tree
    new, there = pose_of(tree, this), pose_of(tree, goal)
    dx, dy, dz, turn = new[0] - there[0], new[1] - there[1], new[2] - there[2], new[3] - there[3]
    squared = dx * dx + dy * dy + dz * dz + cost.rotation_weight_m2 * turn * turn
    if squared > numbers.steering_range_m * numbers.steering_range_m:
        return
    through = tree.cost[this] + segment_cost(cost, new, there)
    if through < tree.cost[goal] and segment_is_safe(constraint, new, there):
        if tree.parent[goal] >= 0:
            move(tree, goal, this, through)
        else:
            attach(tree, goal, this, through)
            if search.counts[2] < 0:
                search.counts[2] = iteration


@kernel
def copy_points(search, known, count):  # type: ignore[no-untyped-def]
    """Points of another search, in their order."""
    for n in range(count):
        add_point(search.known, n, (known.points[0, n], known.points[1, n], known.points[2, n], known.points[3, n]))
        search.known.reach[n] = known.reach[n]


@compiled
def keep_valid(old, new, constraint, numbers):  # type: ignore[no-untyped-def]
    """Copy what hangs from the start by edges that pass, parents before children; the counts go on."""
    goals, kept = numbers.n_goals, 0
    place, queue = np.full(old.counts[0] + goals, -1), np.empty(old.counts[0] + goals, np.int64)
    queue[0], head, tail = goals, 0, 1
    while head < tail:
        node = queue[head]
        head += 1
        to = node
        if node >= goals:
            n, to = node - goals, kept + goals
            set_pose(new.tree, to, pose_of(old.tree, node))
            x = old.known.points[0, n], old.known.points[1, n], old.known.points[2, n], old.known.points[3, n]
            add_point(new.known, kept, x)
            new.known.reach[kept] = old.known.reach[n]
            kept += 1
        place[node] = to
        if node != goals:
            attach(new.tree, to, place[old.tree.parent[node]], old.tree.cost[node])
        child = old.tree.links[node, 0]
        while child >= 0:
            if segment_is_safe(constraint, pose_of(old.tree, node), pose_of(old.tree, child)):
                queue[tail] = child
                tail += 1
            child = old.tree.links[child, 1]
    new.counts[0], new.counts[1] = kept, old.counts[1]
    for goal in range(goals):
        if new.tree.parent[goal] >= 0:
            new.counts[2] = old.counts[2]
