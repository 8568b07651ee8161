"""SCC-RRT* (section IV-B): RRT* with the chance-constraint test of segments, and the verification of its result."""

import dataclasses
import itertools
import math
import time
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from deltasafe.errors import SettingsError
from deltasafe.geometry import Pose, PosePath, wrap_to_pi
from deltasafe.planning.body import ToolBody
from deltasafe.planning.collision.distance_field import DistanceField
from deltasafe.planning.collision.segment_tests import (
    FINEST_M,
    MAX_MARGIN_M,
    CheckSettings,
    SegmentTest,
    body_clearance_m,
    is_segment_safe,
    segment_test,
    verification_test,
)
from deltasafe.planning.results import PlanResult, PlanStatus
from deltasafe.planning.search.connectivity import is_connected
from deltasafe.planning.search.cost import COSTS, area_m2, line_cost, path_cost
from deltasafe.planning.search.problem import search_problem
from deltasafe.planning.search.rrt_star import RrtStar, RrtStarSettings
from deltasafe.planning.search.shortcutting import refine_path
from deltasafe.planning.search.tree import SearchTree
from deltasafe.planning.tracking_bound import TrackingBound, tracking_of
from deltasafe.setting_ranges import check_choice, check_range

Array = NDArray[np.float64]
Counts = tuple[int, int, int]
"""Number of iterations, number of nodes, first iteration with a path."""

CLEARANCE_SPACING_M = 0.001
MARGIN_SEARCHES = 4
"""Searches with smaller margins, by bisection, after a search without a path."""

SEARCH_FRACTION = 0.8
"""Of a time limit; the rest is for refinement."""


@dataclasses.dataclass(frozen=True)
class PlannerSettings(CheckSettings):
    """Settings of SCC-RRT*, including those of the segment test.

    Attributes:
        delta: each point of the tool may lie in space that is occupied with at most this probability.
        n_iterations: N_iter, largest number of samples of the search.
        time_limit_s: of search and refinement together; 0 for no limit. With a limit, the result depends on the speed
            of the machine; without one, the same seed gives the same path.
        v_min_mps: smallest speed; its tracking error is part of the margin (section IV-A).
        reserve_m: added to the margin, as room for blending corners.
        cost: line cost: ``root``, ``squared`` or ``area``.
        rotation_weight_m2: r of the line cost, in m^2/rad^2.
        length_weight_m: weight w of the root cost within the cost ``area``.
        steering_range_m: largest distance sqrt(|dx|^2 + r dphi^2) of one extension of the tree.
        goal_bias: fraction of the samples that are goals not yet connected.
        near_factor: size of the near sets in which the tree is optimized; 16 is the quality mode (decision 19).
        near_set: near sets are the ``k`` nearest nodes, or all within a ``radius``.
        informed: draw samples only where a path could be cheaper than the best one found.
        n_refinements: local changes that are tried on the path; 0 keeps the path of the tree.
        z_min_above_table_m: lowest height of the disc's center above the table.
        z_max_above_field_m: greatest height of the disc's center above the upper face of the field.
        yaw_range_rad: largest deviation of the yaw from that of the start; extended to the yaw of the goals.
    """

    delta: float = 0.05
    n_iterations: int = 2000
    time_limit_s: float = 0.0
    v_min_mps: float = 0.01
    reserve_m: float = 0.001
    cost: str = "root"
    rotation_weight_m2: float = 0.01
    length_weight_m: float = 0.02
    steering_range_m: float = 0.1
    goal_bias: float = 0.05
    near_factor: float = 1.1
    near_set: str = "k"
    informed: bool = True
    n_refinements: int = 400
    z_min_above_table_m: float = 0.02
    z_max_above_field_m: float = 0.07
    yaw_range_rad: float = math.pi / 2

    def __post_init__(self) -> None:
        super().__post_init__()
        check_range(self, "(0, 1)", "delta")
        check_range(self, "[1, 1e6]", "n_iterations")
        check_choice(self, COSTS, "cost")
        check_range(self, "(0, inf)", "v_min_mps", "rotation_weight_m2", "length_weight_m", "z_max_above_field_m")
        check_range(self, "[0, inf)", "n_refinements", "time_limit_s", "reserve_m", "z_min_above_table_m")
        if not 0 <= self.yaw_range_rad <= math.pi:
            raise SettingsError(f"yaw_range_rad must be in [0, pi], got {self.yaw_range_rad}")
        _ = self.rrt_star

    @property
    def rrt_star(self) -> RrtStarSettings:
        """Settings of the generic search."""
        return RrtStarSettings(self.steering_range_m, self.goal_bias, self.near_factor, self.near_set, self.informed)


class Planner:
    """A search in a field that can be continued, for one goal or several, also after the field has changed.

    Args:
        start: pose of the tool.
        goals: one or more poses, connected by one tree.
        field: distances to the unsafe set, for the delta of the settings.
        settings: of search, test and refinement; each call of ``plan`` spends their budget.
        seed: of all random draws.
        body: of the tool.
        tracking: gamma; if None, that of the settings (``MotionSettings``), else the line of the paper.

    Raises:
        SettingsError: no goal, a field for another delta, or a margin beyond the reach of the field.
    """

    def __init__(
        self,
        start: Pose,
        goals: Sequence[Pose],
        field: DistanceField,
        settings: PlannerSettings,
        seed: int,
        body: ToolBody | None = None,
        tracking: TrackingBound | None = None,
    ) -> None:
        if not goals:
            raise SettingsError("a planner needs at least one goal")
        self.settings, self.seed = settings, seed
        self._body = body or ToolBody()
        self._margin_m = float(tracking_of(settings, tracking).error_m(settings.v_min_mps)) + settings.reserve_m
        self._start, self._goals = start.as_array(), np.array([goal.as_array() for goal in goals])
        self._goals[:, 3] = self._start[3] + wrap_to_pi(self._goals[:, 3] - self._start[3])
        self._search: RrtStar | None = None
        self._best: dict[int, PlanResult] = {}
        self._set_field(field)

    def plan(self) -> tuple[PlanResult, ...]:
        """Search for another budget, then refine and verify the path to each goal.

        delta-safety is pointwise (decision 10): it bounds neither the collision probability of the whole body nor that
        of the whole motion. Each path is verified continuously, whatever test the search used. If there is no path, the
        result states the reason. In an unchanged field, a further call never returns a costlier path.
        """
        start_unsafe = self._unsafe_end("start", self._start, PlanStatus.START_UNSAFE)
        if start_unsafe is not None:
            return tuple(start_unsafe for _ in self._goals)
        began_s, limit_s = time.perf_counter(), self.settings.time_limit_s or math.inf
        search = self._grown_search(began_s + SEARCH_FRACTION * limit_s)
        tree = search.tree
        results = []
        for number, goal in enumerate(self._goals):
            goal_unsafe = self._unsafe_end("goal", goal, PlanStatus.GOAL_UNSAFE)
            if goal_unsafe is not None:
                results.append(goal_unsafe)
            elif tree.path(number) is None:
                results.append(self._cheapest(number, self._without_path(search, tree, number, began_s + limit_s)))
            else:
                fraction = (number + 1) / len(self._goals)
                deadline_s = began_s + (SEARCH_FRACTION + (1 - SEARCH_FRACTION) * fraction) * limit_s
                results.append(self._cheapest(number, self._refined(search, tree, number, deadline_s)))
        return tuple(results)

    def replan(self, field: DistanceField) -> tuple[PlanResult, ...]:
        """Plan again in a changed field; the edges of the tree that are still safe keep their costs.

        Raises:
            SettingsError: the field was built for another delta.
        """
        self._set_field(field)
        if self._search is not None:
            self._search.recheck(self._test)
            earlier, self._best = self._best, {}
            for number, best in earlier.items():
                assert best.path is not None
                counts = best.n_iterations, best.n_nodes, best.solved_at
                self._cheapest(number, self._verified(self._search, best.path.poses, counts))
        return self.plan()

    def _set_field(self, field: DistanceField) -> None:
        settings = self.settings
        if field.delta != settings.delta:
            raise SettingsError(f"the field was built for delta {field.delta}, the settings require {settings.delta}")
        checks = CheckSettings(**{f.name: getattr(settings, f.name) for f in dataclasses.fields(CheckSettings)})
        self._field = field
        self._verifier = verification_test(field, self._body, self._margin_m)
        self._test = segment_test(field, self._body, self._margin_m, checks, self.seed)
        self._narrow_search: RrtStar | None = None

    def _grown_search(self, deadline_s: float) -> RrtStar:
        settings, table_z_m = self.settings, self._field.arrays.table_z_m
        if self._search is None:
            cost = line_cost(settings.cost, settings.rotation_weight_m2, table_z_m, settings.length_weight_m)
            bounds = search_bounds(self._field, settings, self._start, self._goals)
            problem = search_problem(self._test, cost, *bounds)
            self._search = RrtStar(problem, self._start, self._goals, self.seed, settings.rrt_star)
        self._search.grow(settings.n_iterations, deadline_s)
        return self._search

    def _unsafe_end(self, name: str, pose: Array, status: PlanStatus) -> PlanResult | None:
        if is_segment_safe(self._verifier, pose, pose):
            return None
        clearance_m = float(body_clearance_m(self._verifier, pose[None], MAX_MARGIN_M)[0])
        return self._failed(
            status,
            f"the {name} {np.round(pose, 4).tolist()} has a clearance of {1000 * clearance_m:.1f} mm, but needs "
            f"{1000 * self._margin_m:.1f} mm: move it away from places that may be occupied"
            f"{self._voxel_remedy(clearance_m)}",
            clearance_m,
        )

    def _voxel_remedy(self, clearance_m: float) -> str:
        """Voxels enlarge obstacles by up to one edge on each side, so that smaller ones may show enough clearance."""
        voxel_m = self._field.grid.voxel_m
        largest_m = voxel_m + clearance_m - self._margin_m
        if not 0 < largest_m < voxel_m:
            return ""
        step_m = 10.0 ** math.floor(math.log10(largest_m))
        return f"; voxel_m = {math.floor(largest_m / step_m * (1 + 1e-9)) * step_m:g} may pass"

    def _cheapest(self, number: int, result: PlanResult) -> PlanResult:
        """Return the cheapest verified path to a goal in this field, of this call or an earlier one."""
        best = self._best.get(number)
        if best is not None and _solved_cost(result) > _solved_cost(best):
            return dataclasses.replace(best, n_iterations=result.n_iterations, n_nodes=result.n_nodes)
        if result.status is PlanStatus.SOLVED:
            self._best[number] = result
        return result

    def _without_path(self, search: RrtStar, tree: SearchTree, number: int, deadline_s: float) -> PlanResult:
        """Search again with the exact test, then with smaller margins, to find a path or the true reason."""
        counts, goal = (tree.n_iterations, len(tree.nodes), tree.solved_at), self._goals[number]
        bounds = np.array(search.problem.lower), np.array(search.problem.upper)
        if not is_connected(self._field, self._body, self._margin_m, *bounds, self._start, goal):
            message = "start and goal lie in parts of the free space that no passage as wide as the tool connects"
            return self._failed(PlanStatus.NO_CONNECTION, message, counts=counts)
        if self._narrow_search is None:
            self._narrow_search = self._search_with(self._margin_m, search)
        self._narrow_search.grow(self.settings.n_iterations, deadline_s)
        narrow = self._narrow_search.tree
        if narrow.path(number) is not None:
            return self._refined(self._narrow_search, narrow, number, deadline_s)
        widest_m = self._widest_margin_m(search, number, deadline_s)
        if widest_m is not None:
            message = (
                f"too narrow at this voxel size: needs {1000 * self._margin_m:.1f} mm, has {1000 * widest_m:.1f} mm"
                f"{self._voxel_remedy(widest_m)}"
            )
            return self._failed(PlanStatus.TOO_NARROW, message, widest_m, counts)
        limit_s = self.settings.time_limit_s
        budget, remedy = (f" or {limit_s} s", " and time_limit_s") if limit_s else ("", "")
        message = f"no path in {counts[0]} iterations{budget} ({counts[1]} nodes): raise n_iterations{remedy}"
        return self._failed(PlanStatus.BUDGET_SPENT, message, counts=counts)

    def _search_with(self, margin_m: float, like: RrtStar) -> RrtStar:
        test = segment_test(self._field, self._body, margin_m, CheckSettings(resolution_m=FINEST_M), is_exact=True)
        problem = like.problem._replace(constraint=test)
        return RrtStar(problem, self._start, self._goals, self.seed, self.settings.rrt_star)

    def _widest_margin_m(self, search: RrtStar, number: int, deadline_s: float) -> float | None:
        """Largest of a few smaller margins with which the same budget finds a path; None if there is none."""
        margin_m, low_m, high_m = 0.0, -1.0, self._margin_m
        for _ in range(MARGIN_SEARCHES):
            trial = self._search_with(margin_m, search)
            trial.grow(self.settings.n_iterations, deadline_s)
            if trial.tree.path(number) is not None:
                low_m = margin_m
            elif low_m < 0:
                return None
            else:
                high_m = margin_m
            margin_m = (low_m + high_m) / 2
        return low_m

    def _refined(self, search: RrtStar, tree: SearchTree, number: int, deadline_s: float) -> PlanResult:
        poses = tree.path(number)
        assert poses is not None
        poses = refine_path(search.problem, poses, self.settings.n_refinements, self.seed, deadline_s)
        return self._verified(search, poses, (tree.n_iterations, len(tree.nodes), tree.solved_at))

    def _failed(
        self, status: PlanStatus, message: str, clearance_m: float = math.nan, counts: Counts = (0, 0, -1)
    ) -> PlanResult:
        return PlanResult(status, None, self._margin_m, clearance_m, None, None, None, *counts, message)

    def _verified(self, search: RrtStar, poses: Array, counts: Counts) -> PlanResult:
        refused = sum(not is_segment_safe(self._verifier, a, b) for a, b in itertools.pairwise(poses))
        clearance_m = _least_clearance_m(self._verifier, poses, self._body)
        return PlanResult(
            PlanStatus.UNVERIFIED if refused else PlanStatus.SOLVED,
            PosePath(poses),
            self._margin_m,
            # the verified margin may exceed the bounds at single poses, which are looser
            clearance_m if refused else max(clearance_m, self._margin_m),
            path_cost(search.problem.cost, poses),
            path_cost(line_cost("squared", self.settings.rotation_weight_m2), poses),
            area_m2(poses, self._field.arrays.table_z_m),
            *counts,
            f"{refused} of {len(poses) - 1} segments fail the continuous check: use method continuous"
            if refused
            else f"{len(poses)} poses, first found in iteration {counts[2] + 1}",
        )


def plan(
    start: Pose,
    goal: Pose,
    field: DistanceField,
    settings: PlannerSettings,
    seed: int,
    body: ToolBody | None = None,
    tracking: TrackingBound | None = None,
) -> PlanResult:
    """Return the result of a ``Planner`` with one goal; arguments as there.

    Raises:
        SettingsError: the field was built for another delta, or the margin is beyond the reach of the field.
    """
    return Planner(start, [goal], field, settings, seed, body, tracking).plan()[0]


def _solved_cost(result: PlanResult) -> float:
    return math.inf if result.cost is None or result.status is not PlanStatus.SOLVED else result.cost


def search_bounds(field: DistanceField, settings: PlannerSettings, start: Array, goals: Array) -> tuple[Array, Array]:
    """Lower and upper bounds (4,) of the poses: the field's extent and the settings, extended to start and goals."""
    z_min, z_max = field.arrays.table_z_m + settings.z_min_above_table_m, field.top_z_m + settings.z_max_above_field_m
    lower = np.array([*field.grid.origin_m[:2], z_min, start[3] - settings.yaw_range_rad])
    upper = np.array([*field.grid.upper_m[:2], z_max, start[3] + settings.yaw_range_rad])
    ends = np.vstack([start[None], goals])
    return np.minimum(lower, ends.min(axis=0)), np.maximum(upper, ends.max(axis=0))


def _least_clearance_m(test: SegmentTest, poses: Array, body: ToolBody) -> float:
    """Smallest clearance along a polyline, at poses at most ``CLEARANCE_SPACING_M`` apart."""
    pieces = [poses[:1]]
    for a, b in itertools.pairwise(poses):
        motion_m = float(np.linalg.norm((b - a)[:3]) + body.rho_max_m * abs(b[3] - a[3]))
        count = max(1, math.ceil(motion_m / CLEARANCE_SPACING_M))
        pieces.append(a + np.arange(1, count + 1)[:, None] / count * (b - a))
    return float(body_clearance_m(test, np.concatenate(pieces), MAX_MARGIN_M if body.parts else 0.0).min())
