"""RRT* (Karaman and Frazzoli 2011) over poses (x, y, z, yaw); it knows no probability, only a segment test."""

import math
import numbers
import time
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from deltasafe.errors import SettingsError
from deltasafe.geometry import FARTHEST, as_rows
from deltasafe.planning.search.cost import LineCost
from deltasafe.planning.search.kernels import Search, SearchParams, begin, copy_points, grow, keep_valid
from deltasafe.planning.search.neighbors import MANY, empty_neighbors
from deltasafe.planning.search.tree import SearchTree, TreeArrays, empty_tree

__all__ = ["RrtStar", "SearchTree", "grow_tree"]

Array = NDArray[np.float64]
NEAR_SETS = ("k", "radius")
CHUNK = 64
MOST_NEAR_FACTOR = 1e6


class RrtStar:
    """A search that can be interrupted at any time and go on, or go on among changed surroundings.

    The first goal that the straight segment reaches needs no iteration. Each sample extends the tree from its nearest
    node; the cheapest safe parent among the near nodes is found lazily, in the order of cost, and near nodes that the
    new one serves better are moved. Once solved, samples that cannot improve any goal are not drawn (``informed``).

    Args:
        constraint: a ``NamedTuple`` registered with ``answers_segments``.
        cost: line cost.
        start: pose (4,); yaw is not wrapped, so give the turn that is meant.
        goals: pose (4,) or poses (G, 4). One tree serves all of them.
        lower, upper: bounds of the poses (4,), which contain start and goals.
        seed: the same arguments give the same tree, however the iterations are divided.
        steering_range_m: largest distance sqrt(|dx|^2 + r dphi^2) of one extension.
        goal_bias: share of samples at a goal that is not reached yet.
        near_factor: near sets are the k nearest, k = near_factor e (1 + 1/d) ln n with d = 4 (decision 19); 16 is the
            quality mode, 1.1 * 2^5 the constant of the k-nearest theorem. By radius, a factor of its lower bound.
        near_set: ``k`` or ``radius``, (ln n / n)^(1/d) times the constant of the theorem, at most the steering range.
        informed: sample only where the lower bound of the cost beats a solution.
        many: number of nodes beyond which neighbors are found in a tree; decides the time, not the result.

    Raises:
        SettingsError: no goal, a pose that is not finite, start or goals outside the bounds, or a number outside its
            domain.
    """

    def __init__(
        self,
        constraint: Any,
        cost: LineCost,
        start: Array,
        goals: Array,
        lower: Array,
        upper: Array,
        seed: int,
        steering_range_m: float = 0.1,
        goal_bias: float = 0.05,
        near_factor: float = 1.1,
        near_set: str = "k",
        informed: bool = True,
        many: int = MANY,
    ) -> None:
        ends = np.vstack([as_rows(np.atleast_2d(goals), 4, "goals"), as_rows([start], 4, "start")])
        if len(ends) < 2:
            raise SettingsError("a search needs at least one goal")
        self._lower, self._upper = map(tuple, as_rows((lower, upper), 4, "the bounds of a search").tolist())
        if not ((ends >= self._lower) & (ends <= self._upper)).all():
            raise SettingsError(f"start and goals must lie within {self._lower} and {self._upper}, got {ends.tolist()}")
        if near_set not in NEAR_SETS:
            raise SettingsError(f"near_set must be one of {NEAR_SETS}, got {near_set!r}")
        if not 0 < steering_range_m <= FARTHEST:
            raise SettingsError(f"steering_range_m must be in (0, {FARTHEST:g}], got {steering_range_m}")
        if not (0 <= goal_bias < 1 and 0 < near_factor <= MOST_NEAR_FACTOR):
            raise SettingsError(
                f"goal_bias must be in [0, 1) and near_factor in (0, {MOST_NEAR_FACTOR:g}], "
                f"got {goal_bias} and {near_factor}"
            )
        self.constraint, self.cost = constraint, cost
        self._ends, self._many = ends, int(many)
        self._numbers = SearchParams(
            len(ends) - 1,
            float(steering_range_m),
            float(goal_bias),
            float(near_factor),
            near_set == "radius",
            _radius_constant_m(cost.rotation_weight_m2, self._lower, self._upper),
            bool(informed),
            int(seed),
        )
        self._room = 0
        self._search = self._empty(1024)
        begin(self._search, self.constraint, self.cost, self._numbers)

    def grow(
        self,
        n_iterations: int | None = None,
        deadline_s: float = math.inf,
        clock: Callable[[], float] = time.perf_counter,
    ) -> int:
        """Draw that many more samples, or until the clock reaches the deadline; returns how many.

        The clock is read between pieces of 64 samples.

        Raises:
            SettingsError: neither a number nor a deadline, a number that is not whole, or a deadline that is NaN.
        """
        require_budget("a search", n_iterations, deadline_s)
        first = int(self._search.counts[1])
        last = first + n_iterations if n_iterations is not None else None
        while last is None or self._search.counts[1] < last:
            if clock() >= deadline_s:
                break
            step = CHUNK if deadline_s < math.inf else 4096
            upto = int(self._search.counts[1]) + step
            upto = upto if last is None else min(upto, last)
            self._make_room(upto - int(self._search.counts[1]))
            grow(self._search, self.constraint, self.cost, self._numbers, self._lower, self._upper, upto)
        return int(self._search.counts[1]) - first

    def recheck(self, constraint: Any) -> int:
        """Go on under another constraint: edges that it refuses are dropped with all that hangs below them.

        Returns how many nodes are left. What is left keeps its costs, and the search can grow again at once.
        """
        old, n_goals = self._search, self._numbers.n_goals
        self.constraint = constraint
        self._search = self._empty(self._room)
        keep_valid(old, self._search, constraint, self._numbers)
        begin(self._search, self.constraint, self.cost, self._numbers)
        return int(self._search.counts[0]) + int((self._search.tree.parent[:n_goals] >= 0).sum())

    @property
    def tree(self) -> SearchTree:
        """What the search has found so far."""
        search, goals = self._search, self._numbers.n_goals
        used = int(search.counts[0]) + goals
        order = np.r_[goals, np.arange(goals), np.arange(goals + 1, used)]
        place = np.empty(used + 1, np.int32)
        place[order], place[-1] = np.arange(used), -1
        return SearchTree(
            search.tree.pose[order],
            place[search.tree.parent[order]],
            search.tree.cost[order],
            int(search.counts[2]),
            goals,
            int(search.counts[1]),
        )

    def _empty(self, room: int) -> Search:
        goals = self._numbers.n_goals
        self._room = room
        search = Search(
            empty_tree(room + goals),
            empty_neighbors(room, self._many),
            np.empty(room),
            np.empty(room),
            np.array([0, 0, -1]),
        )
        search.tree.pose[: goals + 1] = self._ends
        search.tree.cost[goals] = 0.0
        return search

    def _make_room(self, more: int) -> None:
        old, goals = self._search, self._numbers.n_goals
        count = int(old.counts[0])
        if count + more <= self._room:
            return
        self._search = self._empty(max(2 * self._room, count + more))
        for name in TreeArrays._fields:
            getattr(self._search.tree, name)[: count + goals] = getattr(old.tree, name)[: count + goals]
        self._search.counts[:] = old.counts
        copy_points(self._search, old.known, count)


def grow_tree(
    constraint: Any,
    cost: LineCost,
    start: Array,
    goal: Array,
    lower: Array,
    upper: Array,
    n_iterations: int,
    seed: int,
    **options: Any,
) -> SearchTree:
    """The tree of ``RrtStar`` after ``n_iterations``, whether or not the goal is reached earlier."""
    search = RrtStar(constraint, cost, start, goal, lower, upper, seed, **options)
    search.grow(n_iterations)
    return search.tree


def require_budget(what: str, count: int | None, deadline_s: float) -> None:
    """Refuse a budget that never ends: no count and no deadline, 10.5 steps, or a deadline that is NaN.

    Raises:
        SettingsError: such a budget.
    """
    if count is not None and not isinstance(count, numbers.Integral):
        raise SettingsError(f"{what} needs a whole number of steps, got {count!r}")
    if math.isnan(deadline_s) or (count is None and deadline_s == math.inf):
        raise SettingsError(f"{what} needs a number of steps or a deadline, got {count} and {deadline_s}")


def _radius_constant_m(rotation_weight_m2: float, lower: Sequence[float], upper: Sequence[float]) -> float:
    """The lower bound of gamma of theorem 38 of the source, with all of the bounds taken as free."""
    sides = np.subtract(upper, lower) * np.array([1, 1, 1, math.sqrt(rotation_weight_m2)])
    unit_ball = math.pi**2 / 2
    return float((2 * 1.25) ** 0.25 * (sides.prod() / unit_ball) ** 0.25)
