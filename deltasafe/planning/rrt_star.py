"""RRT* (Karaman and Frazzoli 2011) over poses (x, y, z, yaw); it knows no probability, only a segment test."""

import dataclasses
import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from deltasafe.compiling import compiled
from deltasafe.planning.constraint import segment_is_safe
from deltasafe.planning.cost import LineCost, least_cost, pose_distance, segment_cost

__all__ = ["SearchTree", "grow_tree"]

Array = NDArray[np.float64]
START, GOAL = 0, 1


@dataclasses.dataclass(frozen=True)
class SearchTree:
    """The tree after the search; node 0 is the start, node 1 the goal.

    Attributes:
        nodes: (n, 4) poses, yaw continuous.
        parent: (n,) index of the parent; -1 at the root, and at the goal while it is not connected.
        cost: (n,) cost from the start; inf at a goal that is not connected.
        solved_at: iteration that first connected the goal; -1 if none did.
    """

    nodes: Array
    parent: NDArray[np.int64]
    cost: Array
    solved_at: int

    def path(self) -> Array | None:
        """(K, 4) poses from start to goal, or None."""
        if self.parent[GOAL] < 0:
            return None
        chain = [GOAL]
        while chain[-1] != START:
            chain.append(int(self.parent[chain[-1]]))
        return np.asarray(self.nodes[chain[::-1]])


def grow_tree(
    constraint: Any,
    cost: LineCost,
    start: Array,
    goal: Array,
    lower: Array,
    upper: Array,
    n_iterations: int,
    seed: int,
    steering_range_m: float = 0.1,
    goal_bias: float = 0.05,
    near_factor: float = 1.1,
    informed: bool = True,
) -> SearchTree:
    """Grow a tree for ``n_iterations``, whether or not the goal is reached earlier.

    Near sets are the k nearest, k = near_factor * e (1 + 1/d) ln n with d = 4 (decision 19). Once solved, samples
    that cannot improve the solution are not drawn (``informed``). The straight segment to the goal is tried first.

    Args:
        constraint: a ``NamedTuple`` registered with ``answers_segments``.
        cost: line cost.
        start, goal: poses (4,); yaw is not wrapped, so give the turn that is meant.
        lower, upper: bounds of the poses (4,), which contain start and goal.
        n_iterations: samples drawn.
        seed: the same arguments give the same tree.
        steering_range_m: largest distance sqrt(|dx|^2 + r dphi^2) of one extension.
        goal_bias: share of samples at the goal, until solved.
        near_factor: 1.1 by default; 1.1 * 2^5 is the constant of the k-nearest theorem.
        informed: sample only where the lower bound of the cost beats the solution.
    """
    nodes, parent, costs, solved_at = _grow(
        constraint,
        cost,
        *(np.ascontiguousarray(value, dtype=np.float64) for value in (start, goal, lower, upper)),
        int(n_iterations),
        float(steering_range_m),
        float(goal_bias),
        float(near_factor),
        bool(informed),
        np.random.default_rng(seed),
    )
    return SearchTree(nodes, parent, costs, int(solved_at))


@compiled
def _grow(  # type: ignore[no-untyped-def]  # noqa: PLR0912, PLR0915 - one loop, kept in sight
    constraint,
    cost,
    start,
    goal,
    lower,
    upper,
    n_iterations,
    steering,
    goal_bias,
    near_factor,
    informed,
    rng,
):
    nodes = np.empty((n_iterations + 2, 4))
    nodes[START], nodes[GOAL] = start, goal
    scale = math.sqrt(cost.rotation_weight_m2)
    scaled, squared = np.zeros((4, n_iterations + 2)), np.empty(n_iterations + 2)
    scaled[:3, START], scaled[3, START] = start[:3], scale * start[3]
    parent = np.full(n_iterations + 2, -1)
    costs = np.full(n_iterations + 2, np.inf)
    costs[START] = 0.0
    # child lists: links[0] first child, links[1] next sibling, links[2] previous sibling
    links = np.full((3, n_iterations + 2), -1)
    k_most = int(near_factor * math.e * 1.25 * math.log(n_iterations + 2.0)) + 2
    near, gap, total = np.empty(k_most, np.int64), np.empty(k_most), np.empty(k_most)
    refused = np.empty(k_most, np.bool_)
    sample, new = np.empty(4), np.empty(4)
    count, solved_at = 2, -1
    if segment_is_safe(constraint, start, goal):
        costs[GOAL], solved_at = segment_cost(cost, start, goal), 0
        _attach(parent, links, GOAL, START)
    for iteration in range(n_iterations):
        at_goal = rng.random() < goal_bias and solved_at < 0
        if at_goal:
            sample[:] = goal
        else:
            _draw(cost, start, goal, lower, upper, costs[GOAL] if informed else np.inf, rng, sample)
        _squared_distances(scaled, count, cost.rotation_weight_m2, sample, squared)
        nearest = np.argmin(squared[:count])
        distance = math.sqrt(squared[nearest])
        joins_goal = at_goal and distance <= steering
        if distance == 0.0:
            continue
        reach = min(1.0, steering / distance)
        new[:] = nodes[nearest] + reach * (sample - nodes[nearest])
        if informed and solved_at >= 0:
            bound = least_cost(cost, lower[2], start, new) + least_cost(cost, lower[2], new, goal)
            if bound >= costs[GOAL]:
                continue
        if not segment_is_safe(constraint, new, new):
            continue
        k = max(1, int(near_factor * math.e * 1.25 * math.log(float(count))))
        _squared_distances(scaled, count, cost.rotation_weight_m2, new, squared)
        k = _near(squared, count, min(k, k_most), near, gap)
        for n in range(k):
            total[n] = costs[near[n]] + segment_cost(cost, nodes[near[n]], new)
            refused[n] = False
        best = -1
        for n in np.argsort(total[:k]):  # lazily: the cheapest parent that is safe needs the fewest tests
            if segment_is_safe(constraint, nodes[near[n]], new):
                best = n
                break
            refused[n] = True
        if best < 0:
            continue
        this = GOAL
        if not joins_goal:
            this = count
            nodes[this] = new
            scaled[:3, this], scaled[3, this] = new[:3], scale * new[3]
            count += 1
        _attach(parent, links, this, near[best])
        costs[this] = total[best]
        if joins_goal:
            solved_at = iteration
            continue
        for n in range(k):
            if n != best and not refused[n]:
                through = costs[this] + segment_cost(cost, new, nodes[near[n]])
                if through < costs[near[n]] and segment_is_safe(constraint, new, nodes[near[n]]):
                    _move(parent, links, costs, near[n], this, through)
        if pose_distance(cost.rotation_weight_m2, new, goal) <= steering:
            through = costs[this] + segment_cost(cost, new, goal)
            if through < costs[GOAL] and segment_is_safe(constraint, new, goal):
                if solved_at < 0:
                    solved_at = iteration
                    costs[GOAL] = through
                    _attach(parent, links, GOAL, this)
                else:
                    _move(parent, links, costs, GOAL, this, through)
    return nodes[:count].copy(), parent[:count].copy(), costs[:count].copy(), solved_at


@compiled
def _draw(cost, start, goal, lower, upper, best, rng, sample):  # type: ignore[no-untyped-def]
    """A uniform pose in bounds that could improve on ``best``: of the ellipsoid of the root cost, else by rejection."""
    scale = math.sqrt(cost.rotation_weight_m2)
    direct = pose_distance(cost.rotation_weight_m2, start, goal)
    ellipsoid = cost.kind == 0 and best < np.inf and direct > 0
    for _ in range(50):
        if ellipsoid:
            ball = rng.standard_normal(4)
            ball *= rng.random() ** 0.25 / math.sqrt((ball**2).sum())
            ball *= 0.5 * math.sqrt(max(best * best - direct * direct, 0.0))
            ball[0] *= best / math.sqrt(max(best * best - direct * direct, 1e-12))
            axis = (goal - start) / direct
            axis[3] *= scale
            mirror = axis.copy()
            mirror[0] -= 1.0  # the reflection that takes the first axis to the line from start to goal
            size = (mirror**2).sum()
            if size > 1e-12:
                ball -= mirror * (2.0 * (mirror * ball).sum() / size)
            ball[3] /= scale
            sample[:] = 0.5 * (start + goal) + ball
            if np.all(sample >= lower) and np.all(sample <= upper):
                return
        else:
            for axis_index in range(4):
                sample[axis_index] = rng.uniform(lower[axis_index], upper[axis_index])
            bound = least_cost(cost, lower[2], start, sample) + least_cost(cost, lower[2], sample, goal)
            if bound < best:
                return
    for axis_index in range(4):
        sample[axis_index] = rng.uniform(lower[axis_index], upper[axis_index])


@compiled
def _squared_distances(scaled, count, rotation_weight_m2, pose, squared):  # type: ignore[no-untyped-def]
    """Squared distances of a pose to all nodes; ``scaled`` (4, n) holds a coordinate a row, yaw times sqrt(r)."""
    x, y, z = pose[0], pose[1], pose[2]
    turn = math.sqrt(rotation_weight_m2) * pose[3]
    for n in range(count):
        d0, d1, d2, d3 = scaled[0, n] - x, scaled[1, n] - y, scaled[2, n] - z, scaled[3, n] - turn
        squared[n] = d0 * d0 + d1 * d1 + d2 * d2 + d3 * d3
    squared[GOAL] = np.inf  # never a parent


@compiled
def _near(squared, count, k, near, gap):  # type: ignore[no-untyped-def]
    """Fill ``near`` with the k nearest nodes, nearest first; returns how many there are."""
    found = 0
    for n in range(count):
        if squared[n] == np.inf or (found == k and squared[n] >= gap[k - 1]):
            continue
        place = found if found < k else k - 1
        while place > 0 and gap[place - 1] > squared[n]:
            gap[place], near[place] = gap[place - 1], near[place - 1]
            place -= 1
        gap[place], near[place] = squared[n], n
        found = min(found + 1, k)
    return found


@compiled
def _attach(parent, links, node, new_parent):  # type: ignore[no-untyped-def]
    parent[node] = new_parent
    links[1, node], links[2, node] = links[0, new_parent], -1
    if links[0, new_parent] >= 0:
        links[2, links[0, new_parent]] = node
    links[0, new_parent] = node


@compiled
def _move(parent, links, costs, node, new_parent, new_cost):  # type: ignore[no-untyped-def]
    """Give a node a cheaper parent, and all its descendants what they gain by it."""
    following, previous = links[1, node], links[2, node]
    if previous >= 0:
        links[1, previous] = following
    else:
        links[0, parent[node]] = following
    if following >= 0:
        links[2, following] = previous
    _attach(parent, links, node, new_parent)
    gain = costs[node] - new_cost
    costs[node] = new_cost
    below = links[0, node]
    while below >= 0:  # depth first, without a stack: down, else right, else up until right is possible
        costs[below] -= gain
        if links[0, below] >= 0:
            below = links[0, below]
            continue
        while below != node and links[1, below] < 0:
            below = parent[below]
        below = -1 if below == node else links[1, below]
