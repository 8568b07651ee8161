"""SCC-RRT* (section IV-B): RRT* whose segments are tested for delta-safety, and the verdict on what it found."""

import dataclasses
import itertools
import math
import numbers
import time
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from deltasafe.errors import SettingsError
from deltasafe.geometry import Pose, PosePath, wrap_to_pi
from deltasafe.planning.body import ToolBody
from deltasafe.planning.collision.distance_field import DistanceField
from deltasafe.planning.collision.segment_tests import (
    CheckSettings,
    SegmentTest,
    body_clearance_m,
    is_segment_safe,
    segment_test,
)
from deltasafe.planning.results import PlanResult, PlanStatus
from deltasafe.planning.search.connectivity import is_connected
from deltasafe.planning.search.cost import COSTS, area_m2, line_cost, path_cost
from deltasafe.planning.search.rrt_star import NEAR_SETS, RrtStar
from deltasafe.planning.search.shortcutting import refine_path
from deltasafe.planning.tracking_bound import TrackingBound, tracking_of

__all__ = ["Planner", "PlannerSettings", "plan"]

Array = NDArray[np.float64]
FINEST_M = 0.00025
"""Resolution of the verification; the search's own may be coarser, and then refuses more."""

SEARCH_SHARE = 0.8
"""Of a time limit; the rest is for refinement."""


@dataclasses.dataclass(frozen=True)
class PlannerSettings(CheckSettings):
    """Settings of SCC-RRT*; those of the segment test included.

    Attributes:
        delta: a point may be occupied with at most this probability.
        n_iterations: N_iter, samples drawn by the search at most.
        time_limit_s: of search and refinement together, whichever ends first; 0 is no limit. What was found within a
            limit depends on the machine: without one, the same seed gives the same path.
        v_min_mps: smallest speed; its tracking error is part of the margin (section IV-A).
        reserve_m: kept beyond that margin, room for blending the corners.
        cost: ``root``, ``squared`` or ``area``.
        rotation_weight_m2: r of the line cost, in m^2/rad^2.
        length_weight_m: share of the root cost in the ``area`` cost.
        steering_range_m, goal_bias, near_factor, near_set, informed: see ``RrtStar``; a ``near_factor`` of 16 is its
            quality mode.
        n_refinements: local changes tried on the result; 0 leaves the tree's own path.
        z_min_above_table_m: lowest center of the disc.
        z_max_above_field_m: highest center of the disc, above the upper face of the field.
        yaw_range_rad: yaw stays within this of the start's (or of the goal's, if that is farther).
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
        if not 0 < self.delta < 1:
            raise SettingsError(f"delta must be in (0, 1), got {self.delta}")
        if not all(isinstance(count, numbers.Integral) for count in (self.n_iterations, self.n_refinements)):
            raise SettingsError(
                f"n_iterations and n_refinements must be whole numbers, "
                f"got {self.n_iterations!r} and {self.n_refinements!r}"
            )
        if not (1 <= self.n_iterations <= 1_000_000 and self.n_refinements >= 0):
            raise SettingsError(
                f"n_iterations must be in [1, 1e6] and n_refinements not negative, "
                f"got {self.n_iterations} and {self.n_refinements}"
            )
        if not (math.isfinite(self.time_limit_s) and self.time_limit_s >= 0):
            raise SettingsError(f"time_limit_s must not be negative, got {self.time_limit_s}")
        if self.near_set not in NEAR_SETS:
            raise SettingsError(f"near_set must be one of {NEAR_SETS}, got {self.near_set!r}")
        if self.cost not in COSTS:
            raise SettingsError(f"cost must be one of {COSTS}, got {self.cost!r}")
        for name in (
            "v_min_mps",
            "rotation_weight_m2",
            "length_weight_m",
            "steering_range_m",
            "near_factor",
            "z_max_above_field_m",
        ):
            if not (math.isfinite(getattr(self, name)) and getattr(self, name) > 0):
                raise SettingsError(f"{name} must be positive, got {getattr(self, name)}")
        for name in ("reserve_m", "z_min_above_table_m"):
            if not (math.isfinite(getattr(self, name)) and getattr(self, name) >= 0):
                raise SettingsError(f"{name} must not be negative, got {getattr(self, name)}")
        if not 0 <= self.goal_bias < 1:
            raise SettingsError(f"goal_bias must be in [0, 1), got {self.goal_bias}")
        if not 0 <= self.yaw_range_rad <= math.pi:
            raise SettingsError(f"yaw_range_rad must be in [0, pi], got {self.yaw_range_rad}")


class Planner:
    """A search in a field that can go on, toward one goal or many, and again when the field has changed.

    Args:
        start: pose of the tool; goals: one or more. One tree serves all goals.
        field: where to plan, built for the settings' delta.
        settings: of search, test and refinement; their budget is that of each ``plan``.
        seed: of all that is random.
        body: of the robot.
        tracking: gamma; that of the settings if None and they have one (``MotionSettings``), else the paper's line.

    Raises:
        SettingsError: there is no goal, the field was built for another delta, or the margin is beyond its reach.
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
        self._look(field)
        self._search: RrtStar | None = None

    def plan(self) -> tuple[PlanResult, ...]:
        """Search for another budget, and refine and verify the path to each goal.

        delta-safety is pointwise (decision 10): it bounds neither the collision probability of the whole body nor of
        the whole motion. Whatever the search's own test, a path is verified continuously. Failure to find one is an
        outcome with its reason, not an exception.
        """
        ends = [self._unsafe_end("start", self._start, PlanStatus.START_UNSAFE)]
        if ends[0] is not None:
            return tuple(ends[0] for _ in self._goals)
        began_s, limit_s = time.perf_counter(), self.settings.time_limit_s or math.inf
        search = self._searched(began_s + SEARCH_SHARE * limit_s)
        tree = search.tree
        counts = tree.n_iterations, len(tree.nodes), tree.solved_at
        results = []
        for number, goal in enumerate(self._goals):
            unsafe = self._unsafe_end("goal", goal, PlanStatus.GOAL_UNSAFE)
            if unsafe is not None:
                results.append(unsafe)
                continue
            poses = tree.path(number)
            if poses is None:
                results.append(self._without_path(goal, *counts))
                continue
            share = (number + 1) / len(self._goals)
            deadline_s = began_s + (SEARCH_SHARE + (1 - SEARCH_SHARE) * share) * limit_s
            poses = refine_path(
                self._test, search.cost, poses, *self._bounds, self.settings.n_refinements, self.seed, deadline_s
            )
            results.append(self._verdict(poses, *counts))
        return tuple(results)

    def replan(self, field: DistanceField) -> tuple[PlanResult, ...]:
        """Plan again in a changed field. Edges that are still safe stay in the tree, with their costs.

        Raises:
            SettingsError: the field was built for another delta.
        """
        self._look(field)
        if self._search is not None:
            self._search.recheck(self._test)
        return self.plan()

    def _look(self, field: DistanceField) -> None:
        settings = self.settings
        if field.delta != settings.delta:
            raise SettingsError(f"the field was built for delta {field.delta}, the settings ask {settings.delta}")
        checks = CheckSettings(**{f.name: getattr(settings, f.name) for f in dataclasses.fields(CheckSettings)})
        continuous = dataclasses.replace(checks, method="continuous", resolution_m=FINEST_M)
        self._field = field
        self._verifier = segment_test(field, self._body, self._margin_m, continuous, self.seed)
        self._test = segment_test(field, self._body, self._margin_m, checks, self.seed)

    def _searched(self, deadline_s: float) -> RrtStar:
        settings = self.settings
        if self._search is None:
            self._bounds = search_bounds(self._field, settings, self._start, self._goals)
            self._search = RrtStar(
                self._test,
                line_cost(
                    settings.cost,
                    settings.rotation_weight_m2,
                    self._field.arrays.floor_z_m,
                    settings.length_weight_m,
                ),
                self._start,
                self._goals,
                *self._bounds,
                self.seed,
                settings.steering_range_m,
                settings.goal_bias,
                settings.near_factor,
                settings.near_set,
                settings.informed,
            )
        self._search.grow(settings.n_iterations, deadline_s)
        return self._search

    def _unsafe_end(self, name: str, pose: Array, status: PlanStatus) -> PlanResult | None:
        clearance_m = float(body_clearance_m(self._verifier, pose[None])[0])
        needed_m = self._margin_m + self.settings.resolution_m
        if clearance_m >= needed_m:
            return None
        return self._failure(
            status,
            f"the {name} {np.round(pose, 4).tolist()} has a clearance of {1000 * clearance_m:.1f} mm, "
            f"{1000 * needed_m:.1f} mm are needed: move it away from what may be occupied",
            clearance_m,
        )

    def _without_path(self, goal: Array, n_iterations: int, n_nodes: int, solved_at: int) -> PlanResult:
        if not is_connected(self._field, self._body, self._margin_m, *self._bounds, self._start, goal):
            return self._failure(
                PlanStatus.NO_CONNECTION,
                "start and goal lie in parts of the free space that nothing as thick as the tool connects",
                math.nan,
                n_iterations,
                n_nodes,
                solved_at,
            )
        limit_s = self.settings.time_limit_s
        ended = f" or {limit_s} s" if limit_s else ""
        return self._failure(
            PlanStatus.BUDGET_SPENT,
            f"no path in {n_iterations} iterations{ended} ({n_nodes} nodes): raise n_iterations"
            + (" and time_limit_s" if limit_s else ""),
            math.nan,
            n_iterations,
            n_nodes,
            solved_at,
        )

    def _failure(
        self,
        status: PlanStatus,
        message: str,
        clearance_m: float,
        n_iterations: int = 0,
        n_nodes: int = 0,
        solved_at: int = -1,
    ) -> PlanResult:
        return PlanResult(
            status, None, self._margin_m, clearance_m, None, None, None, n_iterations, n_nodes, solved_at, message
        )

    def _verdict(self, poses: Array, n_iterations: int, n_nodes: int, solved_at: int) -> PlanResult:
        search, settings = self._search, self.settings
        assert search is not None
        refused = sum(not is_segment_safe(self._verifier, a, b) for a, b in itertools.pairwise(poses))
        return PlanResult(
            PlanStatus.UNVERIFIED if refused else PlanStatus.SOLVED,
            PosePath(poses),
            self._margin_m,
            _least_clearance_m(self._verifier, poses, self._body.rho_max_m),
            path_cost(search.cost, poses),
            path_cost(line_cost("squared", settings.rotation_weight_m2), poses),
            area_m2(poses, self._field.arrays.floor_z_m),
            n_iterations,
            n_nodes,
            solved_at,
            f"{refused} of {len(poses) - 1} segments fail the continuous check: use method continuous"
            if refused
            else f"{len(poses)} poses, first found in iteration {solved_at + 1}",
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
    """The one result of a ``Planner`` with one goal; ``tracking`` as there.

    Raises:
        SettingsError: the field was built for another delta, or the margin is beyond the field's reach.
    """
    return Planner(start, [goal], field, settings, seed, body, tracking).plan()[0]


def search_bounds(field: DistanceField, settings: PlannerSettings, start: Array, goals: Array) -> tuple[Array, Array]:
    """Lower and upper poses (4,) of a search: the view, the heights and turns of the settings, all ends."""
    turn = settings.yaw_range_rad
    low_z, high_z = field.arrays.floor_z_m + settings.z_min_above_table_m, field.top_z_m
    lower = np.array([*field.grid.origin_m[:2], low_z, start[3] - turn])
    upper = np.array([*field.grid.upper_m[:2], high_z + settings.z_max_above_field_m, start[3] + turn])
    ends = np.vstack([start[None], goals])
    return np.minimum(lower, ends.min(axis=0)), np.maximum(upper, ends.max(axis=0))


def _least_clearance_m(test: SegmentTest, poses: Array, rho_max_m: float, spacing_m: float = 0.001) -> float:
    """Smallest clearance of the polyline's poses at most ``spacing_m`` apart."""
    pieces = [poses[:1]]
    for a, b in itertools.pairwise(poses):
        count = max(1, math.ceil(float(np.linalg.norm((b - a)[:3]) + rho_max_m * abs(b[3] - a[3])) / spacing_m))
        pieces.append(a + np.arange(1, count + 1)[:, None] / count * (b - a))
    return float(body_clearance_m(test, np.concatenate(pieces)).min())
