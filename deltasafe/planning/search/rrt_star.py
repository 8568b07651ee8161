"""Generic RRT* (Karaman and Frazzoli 2011) over poses (x, y, z, yaw), with a segment test as its only constraint."""

import dataclasses
import math
import time
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from deltasafe.errors import SettingsError
from deltasafe.geometry import MAX_COORDINATE, as_rows
from deltasafe.planning.search.kernels import (
    N_ITERATIONS,
    N_POINTS,
    SOLVED_AT,
    Search,
    SearchParams,
    begin,
    copy_points,
    grow,
    keep_valid,
)
from deltasafe.planning.search.neighbors import BUCKET_THRESHOLD, empty_neighbors
from deltasafe.planning.search.problem import SearchProblem, require_budget
from deltasafe.planning.search.tree import SearchTree, TreeArrays, empty_tree
from deltasafe.setting_ranges import check_choice, check_range

Array = NDArray[np.float64]
NEAR_SETS = ("k", "radius")
CHUNK, CHUNK_WITHOUT_DEADLINE = 64, 4096
"""Iterations between two readings of the clock, and between two checks of the capacity."""

MAX_NEAR_FACTOR = 1e6


@dataclasses.dataclass(frozen=True)
class RrtStarSettings:
    """Settings of RRT*.

    Attributes:
        steering_range_m: largest distance sqrt(|dx|^2 + r dphi^2) of one extension.
        goal_bias: fraction of the samples that are goals not yet connected.
        near_factor: size of the near sets. With ``k``, they are the k nearest nodes, k = near_factor e (1 + 1/d) ln n
            and d = 4 (decision 19): 16 is the quality mode, 1.1 * 2^5 the constant of the k-nearest theorem. With
            ``radius``, a factor of the theorem's lower bound.
        near_set: ``k``, or ``radius``: (ln n / n)^(1/d) times the constant, at most the steering range.
        informed: draw samples only where the lower bound of the cost is below the best solution.
        bucket_threshold: number of nodes beyond which neighbors are found in a tree; affects the time, not the result.

    Raises:
        SettingsError: a value is outside its domain.
    """

    steering_range_m: float = 0.1
    goal_bias: float = 0.05
    near_factor: float = 1.1
    near_set: str = "k"
    informed: bool = True
    bucket_threshold: int = BUCKET_THRESHOLD

    def __post_init__(self) -> None:
        check_choice(self, NEAR_SETS, "near_set")
        check_range(self, f"(0, {MAX_COORDINATE:g}]", "steering_range_m")
        check_range(self, "[0, 1)", "goal_bias")
        check_range(self, f"(0, {MAX_NEAR_FACTOR:g}]", "near_factor")


class RrtStar:
    """A search that can be continued, also with another constraint.

    Goals that the straight segment from the start reaches need no iteration. Each sample extends the tree from its
    nearest node. The new node gets the cheapest safe parent of its near set, found lazily in order of cost, and becomes
    the parent of near nodes that it makes cheaper.

    Args:
        problem: constraint, cost and bounds.
        start: pose (4,); yaw is not wrapped.
        goals: pose (4,) or poses (G, 4), connected by one tree.
        seed: the same arguments give the same tree, however the iterations are divided.

    Raises:
        SettingsError: no goal, a pose that is not finite, or start or goals outside the bounds.
    """

    def __init__(
        self, problem: SearchProblem, start: Array, goals: Array, seed: int, settings: RrtStarSettings | None = None
    ) -> None:
        settings = settings or RrtStarSettings()
        ends = np.vstack([as_rows(np.atleast_2d(goals), 4, "goals"), as_rows([start], 4, "start")])
        if len(ends) < 2:
            raise SettingsError("a search needs at least one goal")
        if not ((ends >= problem.lower) & (ends <= problem.upper)).all():
            raise SettingsError(
                f"start and goals must lie within {problem.lower} and {problem.upper}, got {ends.tolist()}"
            )
        self.problem = problem
        self._ends, self._bucket_threshold = ends, int(settings.bucket_threshold)
        self._params = SearchParams(
            len(ends) - 1,
            float(settings.steering_range_m),
            float(settings.goal_bias),
            float(settings.near_factor),
            settings.near_set == "radius",
            _radius_constant_m(problem.cost.rotation_weight_m2, problem.lower, problem.upper),
            bool(settings.informed),
            int(seed),
        )
        self._search = self._empty(1024)
        begin(self._search, self.problem, self._params)

    def grow(
        self,
        n_iterations: int | None = None,
        deadline_s: float = math.inf,
        clock: Callable[[], float] = time.perf_counter,
    ) -> int:
        """Run ``n_iterations`` more, or until the clock reaches the deadline; return how many were run.

        The clock is read every 64 iterations.

        Raises:
            SettingsError: neither a number nor a deadline, a number that is not whole, or a deadline that is NaN.
        """
        require_budget("a search", n_iterations, deadline_s)
        first = self._n_iterations
        last = first + n_iterations if n_iterations is not None else None
        while last is None or self._n_iterations < last:
            if clock() >= deadline_s:
                break
            chunk = CHUNK if deadline_s < math.inf else CHUNK_WITHOUT_DEADLINE
            chunk = chunk if last is None else min(chunk, last - self._n_iterations)
            self._reserve(chunk)
            grow(self._search, self.problem, self._params, self._n_iterations + chunk)
        return self._n_iterations - first

    def recheck(self, constraint: Any) -> int:
        """Replace the constraint, and drop the edges that it refuses with all nodes below them.

        The remaining nodes keep their costs, and the search can be continued. Returns the number of remaining nodes.
        """
        old, n_goals = self._search, self._params.n_goals
        self.problem = self.problem._replace(constraint=constraint)
        self._search = self._empty(len(old.edge_cost))
        keep_valid(old, self._search, constraint, n_goals)
        begin(self._search, self.problem, self._params)
        return int(self._search.counters[N_POINTS]) + int((self._search.tree.parent[:n_goals] >= 0).sum())

    @property
    def tree(self) -> SearchTree:
        """A copy of the tree so far."""
        search, n_goals = self._search, self._params.n_goals
        n_nodes = int(search.counters[N_POINTS]) + n_goals
        order = np.r_[n_goals, np.arange(n_goals), np.arange(n_goals + 1, n_nodes)]
        new_index = np.empty(n_nodes + 1, np.int32)
        new_index[order], new_index[-1] = np.arange(n_nodes), -1
        return SearchTree(
            search.tree.pose[order],
            new_index[search.tree.parent[order]],
            search.tree.cost[order],
            int(search.counters[SOLVED_AT]),
            n_goals,
            self._n_iterations,
        )

    @property
    def _n_iterations(self) -> int:
        return int(self._search.counters[N_ITERATIONS])

    def _empty(self, capacity: int) -> Search:
        n_goals = self._params.n_goals
        search = Search(
            empty_tree(capacity + n_goals),
            empty_neighbors(capacity, self._bucket_threshold),
            np.empty(capacity),
            np.empty(capacity),
            np.array([0, 0, -1]),
        )
        search.tree.pose[: n_goals + 1] = self._ends
        search.tree.cost[n_goals] = 0.0
        return search

    def _reserve(self, n_points: int) -> None:
        """Double the capacity if it does not suffice for ``n_points`` more."""
        old = self._search
        count, capacity = int(old.counters[N_POINTS]), len(old.edge_cost)
        if count + n_points <= capacity:
            return
        self._search = self._empty(max(2 * capacity, count + n_points))
        n_nodes = count + self._params.n_goals
        for name in TreeArrays._fields:
            getattr(self._search.tree, name)[:n_nodes] = getattr(old.tree, name)[:n_nodes]
        self._search.counters[:] = old.counters
        copy_points(self._search.neighbors, old.neighbors, count)


def grow_tree(
    problem: SearchProblem,
    start: Array,
    goals: Array,
    n_iterations: int,
    seed: int,
    settings: RrtStarSettings | None = None,
) -> SearchTree:
    """Return the tree of ``RrtStar`` after ``n_iterations``; reaching the goals does not end the search."""
    search = RrtStar(problem, start, goals, seed, settings)
    search.grow(n_iterations)
    return search.tree


def _radius_constant_m(rotation_weight_m2: float, lower: Sequence[float], upper: Sequence[float]) -> float:
    """Lower bound of gamma in theorem 38 of the source, with the whole box of the bounds taken as free space."""
    sides = np.subtract(upper, lower) * np.array([1, 1, 1, math.sqrt(rotation_weight_m2)])
    unit_ball = math.pi**2 / 2
    return float((2 * 1.25) ** 0.25 * (sides.prod() / unit_ball) ** 0.25)
