"""The iterations of RRT*, compiled, on flat arrays."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from deltasafe.compute.counter_rng import splitmix64, uniform
from deltasafe.compute.numba_cache import compiled, inlined, kernel
from deltasafe.planning.collision.segment import pose_at
from deltasafe.planning.collision.segment_query import segment_is_safe
from deltasafe.planning.search.cost import least_cost, segment_cost, squared_pose_distance
from deltasafe.planning.search.neighbors import Neighbors, add_point, k_nearest, nearest, point_of, within
from deltasafe.planning.search.sampling import draw_pose
from deltasafe.planning.search.tree import FIRST_CHILD, NEXT_SIBLING, TreeArrays, attach, pose_of, reparent, set_pose

Array = NDArray[np.float64]

N_POINTS, N_ITERATIONS, SOLVED_AT = range(3)
"""Indices of ``Search.counters``; ``SOLVED_AT`` is the first iteration with a path, -1 if there is none."""


class SearchParams(NamedTuple):
    """Parameters of a search, as compiled code reads them."""

    n_goals: int
    steering_range_m: float
    goal_bias: float
    near_factor: float
    by_radius: bool
    radius_m: float
    informed: bool
    seed: int


class Search(NamedTuple):
    """State of a search. Goals are nodes 0 to G - 1, the start is node G; node n is point n - G of ``neighbors``.

    ``edge_cost`` and ``total_cost`` are scratch arrays: of the edges from the near set to a new pose, and of the pose.
    """

    tree: TreeArrays
    neighbors: Neighbors
    edge_cost: Array
    total_cost: Array
    counters: NDArray[np.int64]


@inlined
def _scaled(cost, pose):  # type: ignore[no-untyped-def]
    return pose[0], pose[1], pose[2], math.sqrt(cost.rotation_weight_m2) * pose[3]


@kernel
def begin(search, problem, params):  # type: ignore[no-untyped-def]
    """Add the start as point 0, and connect the goals that a straight segment reaches."""
    tree, counters, root = search.tree, search.counters, params.n_goals
    if counters[N_POINTS] == 0:
        add_point(search.neighbors, 0, _scaled(problem.cost, pose_of(tree, root)))
        search.neighbors.squared_near_radius[0] = params.steering_range_m * params.steering_range_m
        counters[N_POINTS] = 1
    for goal in range(root):
        start_pose, goal_pose = pose_of(tree, root), pose_of(tree, goal)
        if tree.parent[goal] < 0 and segment_is_safe(problem.constraint, start_pose, goal_pose):
            attach(tree, goal, root, segment_cost(problem.cost, start_pose, goal_pose))
            if counters[SOLVED_AT] < 0:
                counters[SOLVED_AT] = counters[N_ITERATIONS]


@kernel
def grow(search, problem, params, n_iterations):  # type: ignore[no-untyped-def]
    """Run iterations until their total number is ``n_iterations``."""
    tree, neighbors, counters = search.tree, search.neighbors, search.counters
    constraint, cost, n_goals = problem.constraint, problem.cost, params.n_goals
    for iteration in range(counters[N_ITERATIONS], n_iterations):
        counters[N_ITERATIONS] = iteration + 1
        key = splitmix64(np.uint64(params.seed), iteration + 1)
        target, pose = _draw_target(tree, problem, params, key)
        nearest_point, squared = nearest(neighbors, counters[N_POINTS], _scaled(cost, pose))
        distance = math.sqrt(squared)
        if distance == 0.0:
            continue
        is_reached = distance <= params.steering_range_m
        if not is_reached:
            pose = pose_at(pose_of(tree, nearest_point + n_goals), pose, params.steering_range_m / distance)
        if params.informed and not _may_improve(tree, problem, n_goals, pose):
            continue
        if not segment_is_safe(constraint, pose, pose):
            continue
        n_near = _find_near_set(search, cost, params, pose, nearest_point, is_reached)
        parent = _cheapest_parent(search, problem, pose, n_near)
        if parent < 0:
            continue
        if target >= 0 and is_reached:
            if tree.parent[target] < 0:
                attach(tree, target, parent, search.total_cost[0])
                if counters[SOLVED_AT] < 0:
                    counters[SOLVED_AT] = iteration
            continue
        node = counters[N_POINTS] + n_goals
        set_pose(tree, node, pose)
        add_point(neighbors, counters[N_POINTS], _scaled(cost, pose))
        counters[N_POINTS] += 1
        attach(tree, node, parent, search.total_cost[0])
        _rewire(search, constraint, node, n_near)
        for goal in range(n_goals):
            _connect_goal(search, problem, params, goal, node, iteration)


@inlined
def _draw_target(tree, problem, params, key):  # type: ignore[no-untyped-def]
    """Draw a sample: a goal that is not connected and its pose, or -1 and a random pose."""
    n_goals = params.n_goals
    goal = min(int(n_goals * uniform(key, 5)), n_goals - 1)
    if tree.parent[goal] < 0 and uniform(key, 6) < params.goal_bias:
        return goal, pose_of(tree, goal)
    best_cost = tree.cost[goal] if params.informed else np.inf
    return -1, draw_pose(problem, pose_of(tree, n_goals), pose_of(tree, goal), best_cost, key)


@inlined
def _may_improve(tree, problem, n_goals, pose):  # type: ignore[no-untyped-def]
    """Return whether a path through a pose could cost less than the best known path to some goal."""
    cost, lowest_z = problem.cost, problem.lower[2]
    from_start = least_cost(cost, lowest_z, pose_of(tree, n_goals), pose)
    for goal in range(n_goals):
        if from_start + least_cost(cost, lowest_z, pose, pose_of(tree, goal)) < tree.cost[goal]:
            return True
    return False


@inlined
def _find_near_set(search, cost, params, pose, nearest_point, is_scanned):  # type: ignore[no-untyped-def]
    """Write the near set of a pose to ``neighbors.found``, as nodes; return its size."""
    neighbors, count = search.neighbors, search.counters[N_POINTS]
    if params.by_radius:
        ratio = math.log(count + 1.0) / (count + 1.0)
        radius = min(params.near_factor * params.radius_m * ratio**0.25, params.steering_range_m)
        size = within(neighbors, count, _scaled(cost, pose), radius * radius * (1 + 1e-6))
        if size == 0:
            neighbors.found[0], size = nearest_point, 1
    else:
        k = max(1, int(params.near_factor * math.e * 1.25 * math.log(count + 1.0)))
        scale = math.sqrt(k / count)  # the squared radius of k of n points in four dimensions
        guess = max(1.1 * neighbors.squared_near_radius[nearest_point] * scale, 1e-6)
        size, squared = k_nearest(neighbors, count, _scaled(cost, pose), k, guess, is_scanned)
        neighbors.squared_near_radius[count] = squared / scale
    for n in range(size):
        neighbors.found[n] += params.n_goals
    return size


@inlined
def _cheapest_parent(search, problem, pose, n_near):  # type: ignore[no-untyped-def]
    """Return the cheapest near node from which the segment is safe, or -1; ``total_cost[0]`` becomes its cost.

    Segments are tested lazily, in order of cost. Nodes whose segment was refused leave the near set (entry -1).
    """
    tree, found, edge_cost, total_cost = search.tree, search.neighbors.found, search.edge_cost, search.total_cost
    for n in range(n_near):
        edge_cost[n] = segment_cost(problem.cost, pose_of(tree, found[n]), pose)
        total_cost[n] = tree.cost[found[n]] + edge_cost[n]
    for _ in range(n_near):
        best = 0
        for n in range(1, n_near):
            if total_cost[n] < total_cost[best]:
                best = n
        if total_cost[best] == np.inf:
            return -1
        node = found[best]
        found[best] = -1
        if segment_is_safe(problem.constraint, pose_of(tree, node), pose):
            total_cost[0] = total_cost[best]
            return node
        total_cost[best] = np.inf
    return -1


@inlined
def _rewire(search, constraint, new, n_near):  # type: ignore[no-untyped-def]
    """Make the new node the parent of near nodes that become cheaper; segments cost the same both ways."""
    tree, found, edge_cost = search.tree, search.neighbors.found, search.edge_cost
    pose, new_cost = pose_of(tree, new), tree.cost[new]
    for n in range(n_near):
        node, total = found[n], new_cost + edge_cost[n]
        if node >= 0 and total < tree.cost[node] and segment_is_safe(constraint, pose, pose_of(tree, node)):
            reparent(tree, node, new, total)


@inlined
def _connect_goal(search, problem, params, goal, node, iteration):  # type: ignore[no-untyped-def]
    """Make the new node the parent of a goal in steering range that becomes cheaper."""
    tree = search.tree
    pose, goal_pose = pose_of(tree, node), pose_of(tree, goal)
    squared = squared_pose_distance(problem.cost.rotation_weight_m2, pose, goal_pose)
    if squared > params.steering_range_m * params.steering_range_m:
        return
    total = tree.cost[node] + segment_cost(problem.cost, pose, goal_pose)
    if total < tree.cost[goal] and segment_is_safe(problem.constraint, pose, goal_pose):
        if tree.parent[goal] >= 0:
            reparent(tree, goal, node, total)
        else:
            attach(tree, goal, node, total)
            if search.counters[SOLVED_AT] < 0:
                search.counters[SOLVED_AT] = iteration


@kernel
def copy_points(target, source, count):  # type: ignore[no-untyped-def]
    """Copy the first ``count`` points of ``Neighbors`` to empty ones."""
    for n in range(count):
        add_point(target, n, point_of(source, n))
        target.squared_near_radius[n] = source.squared_near_radius[n]


@compiled
def keep_valid(old, new, constraint, n_goals):  # type: ignore[no-untyped-def]
    """Copy the part of a tree that hangs from the start by safe edges, parents before children, and the counters."""
    kept, n_nodes = 0, old.counters[N_POINTS] + n_goals
    new_index, queue = np.full(n_nodes, -1), np.empty(n_nodes, np.int64)
    queue[0], head, tail = n_goals, 0, 1
    while head < tail:
        node = queue[head]
        head += 1
        copy = node
        if node >= n_goals:
            point, copy = node - n_goals, kept + n_goals
            set_pose(new.tree, copy, pose_of(old.tree, node))
            add_point(new.neighbors, kept, point_of(old.neighbors, point))
            new.neighbors.squared_near_radius[kept] = old.neighbors.squared_near_radius[point]
            kept += 1
        new_index[node] = copy
        if node != n_goals:
            attach(new.tree, copy, new_index[old.tree.parent[node]], old.tree.cost[node])
        child = old.tree.links[node, FIRST_CHILD]
        while child >= 0:
            if segment_is_safe(constraint, pose_of(old.tree, node), pose_of(old.tree, child)):
                queue[tail] = child
                tail += 1
            child = old.tree.links[child, NEXT_SIBLING]
    new.counters[N_POINTS], new.counters[N_ITERATIONS] = kept, old.counters[N_ITERATIONS]
    for goal in range(n_goals):
        if new.tree.parent[goal] >= 0:
            new.counters[SOLVED_AT] = old.counters[SOLVED_AT]
