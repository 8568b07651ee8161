"""SCC-RRT*: safety of returned paths, their costs, and the outcomes without a path."""

import dataclasses
import math
from collections.abc import Callable

import numpy as np
import pytest

from deltasafe.errors import SettingsError
from deltasafe.geometry import Pose
from deltasafe.planning import (
    DistanceField,
    Planner,
    PlannerSettings,
    PlanStatus,
    ToolBody,
    VelocitySettings,
    line_cost,
    path_cost,
    plan,
    schedule,
)
from deltasafe.scene import Cuboid, OccupancyGrid, Sphere, grid_from_shapes

START, GOAL = Pose(-0.14, 0.0, 0.03), Pose(0.14, 0.0, 0.03)
SETTINGS = PlannerSettings(n_iterations=800, n_refinements=200)
LOWER, UPPER = (-0.2, -0.15, 0.0), (0.2, 0.15, 0.09)


def wall(height_m: float, voxel_m: float = 0.005) -> OccupancyGrid:
    return grid_from_shapes([Cuboid((0, 0, height_m / 2), (0.02, 0.2, height_m / 2))], 0.0, LOWER, UPPER, voxel_m)


@pytest.mark.parametrize("seed", range(4))
def test_returned_paths_hold_no_unsafe_pose(
    seed: int, make_grid: Callable[..., OccupancyGrid], audit: Callable[..., float]
) -> None:
    """Audited every millimeter, at 4400 points of the enlarged body, without code of the segment tests."""
    grid = make_grid(seed, count=5)
    result = plan(START, GOAL, DistanceField.build(grid, 0.05), SETTINGS, seed)
    assert result.status is PlanStatus.SOLVED
    assert result.path is not None
    assert audit(grid, 0.05, ToolBody(), result.margin_m, result.path.poses) == 0
    assert result.path.poses[0].tolist() == list(START.as_tuple())
    assert result.path.poses[-1].tolist() == list(GOAL.as_tuple())


def test_wall_across_the_grid_is_crossed_above_it(audit: Callable[..., float]) -> None:
    grid = wall(0.088)
    result = plan(START, GOAL, DistanceField.build(grid, 0.05), SETTINGS, 0)
    assert result.status is PlanStatus.SOLVED
    assert result.path is not None
    assert result.path.poses[:, 2].max() > 0.09
    assert audit(grid, 0.05, ToolBody(), result.margin_m, result.path.poses) == 0


def test_reported_costs_equal_those_of_the_path() -> None:
    field = DistanceField.build(wall(0.06), 0.05)
    result = plan(START, GOAL, field, dataclasses.replace(SETTINGS, cost="area"), 0)
    assert result.path is not None
    steps = np.diff(result.path.poses, axis=0)
    root = np.sqrt((steps[:, :3] ** 2).sum(axis=1) + 0.01 * steps[:, 3] ** 2)
    heights = (result.path.poses[1:, 2] + result.path.poses[:-1, 2]) / 2
    area = (heights * np.linalg.norm(steps[:, :3], axis=1)).sum()
    assert result.area_m2 == pytest.approx(area)
    assert result.cost_squared_m2 == pytest.approx((root**2).sum())
    assert result.cost == pytest.approx(area + 0.02 * root.sum())


@pytest.mark.parametrize(
    ("start", "goal", "status"),
    [
        (Pose(0, 0, 0.03), GOAL, PlanStatus.START_UNSAFE),
        (START, Pose(0.02, 0, 0.03), PlanStatus.GOAL_UNSAFE),
        (START, Pose(0.19, 0, 0.03), PlanStatus.GOAL_UNSAFE),
        (START, Pose(0.14, 0, 0.004), PlanStatus.GOAL_UNSAFE),
    ],
)
def test_unsafe_end_is_reported_with_its_clearance(start: Pose, goal: Pose, status: PlanStatus) -> None:
    result = plan(start, goal, DistanceField.build(wall(0.06), 0.05), SETTINGS, 0)
    assert result.status is status
    assert result.path is None
    assert result.clearance_m < result.margin_m
    assert "mm" in result.message


def test_missing_connection_differs_from_spent_budget() -> None:
    low_ceiling = dataclasses.replace(SETTINGS, z_max_above_field_m=0.001)
    field = DistanceField.build(wall(0.088, 0.0025), 0.05)
    assert plan(START, GOAL, field, low_ceiling, 0).status is PlanStatus.NO_CONNECTION
    small_budget = dataclasses.replace(SETTINGS, n_iterations=3)
    assert plan(START, GOAL, field, small_budget, 0).status is PlanStatus.BUDGET_SPENT


def test_paths_of_the_sampled_method_are_verified_continuously() -> None:
    """Three samples miss the thin posts on the straight line; the verification does not."""
    posts = [Sphere((x, 0.0, z), 0.002) for x in (-0.06, 0.0, 0.06) for z in (0.02, 0.03, 0.04)]
    field = DistanceField.build(grid_from_shapes(posts, 0.0, LOWER, UPPER, 0.0025), 0.05)
    few_samples = dataclasses.replace(SETTINGS, method="sampled", n_samples=3)
    outcomes = [plan(START, GOAL, field, few_samples, seed).status for seed in range(4)]
    assert PlanStatus.UNVERIFIED in outcomes
    assert plan(START, GOAL, field, SETTINGS, 0).status is PlanStatus.SOLVED


def test_same_seed_gives_the_same_path(make_grid: Callable[..., OccupancyGrid]) -> None:
    field = DistanceField.build(make_grid(3), 0.05)
    one, two, other = (plan(START, GOAL, field, SETTINGS, seed) for seed in (1, 1, 2))
    assert one.path is not None
    assert two.path is not None
    assert other.path is not None
    assert (one.path.poses == two.path.poses).all()
    assert not np.array_equal(one.path.poses, other.path.poses)


def slot(width_m: float, voxel_m: float = 0.0025) -> DistanceField:
    """A slot whose voxels are ``width_m`` apart; those within 1 mm of a wall count as occupied."""
    walls = [Cuboid((0, side * (width_m / 2 + 0.101), 0.06), (0.03, 0.1, 0.06)) for side in (-1, 1)]
    return DistanceField.build(grid_from_shapes(walls, 0.0, LOWER, (0.2, 0.15, 0.12), voxel_m), 0.05)


NARROW = dataclasses.replace(SETTINGS, z_max_above_field_m=0.0001, n_iterations=600)


def test_slot_with_a_millimeter_to_spare_is_passed_by_the_exact_search() -> None:
    """The disc is 30 mm wide, the slot 35 mm, the margin 1.5 mm: 1 mm remains on each side."""
    result = plan(START, GOAL, slot(0.035), NARROW, 0)
    assert result.status is PlanStatus.SOLVED
    assert schedule(result.path, slot(0.035), VelocitySettings())[0].duration_s > 0  # type: ignore[arg-type]


def test_slot_that_lacks_margin_is_reported_with_both_margins_and_a_voxel_size() -> None:
    """Half of 35 mm less 15 mm are 2.5 mm."""
    result = plan(START, GOAL, slot(0.035), dataclasses.replace(NARROW, reserve_m=0.0025), 0)
    assert result.status is PlanStatus.TOO_NARROW
    assert "too narrow at this voxel size: needs 3.0 mm, has " in result.message
    assert result.message.endswith("voxel_m = 0.001 may pass")
    assert 0.0015 <= result.clearance_m < 0.0025


def test_start_with_the_margin_to_spare_is_accepted() -> None:
    """Beside a wall, whose voxels begin at -22.5 mm; the bounds by balls are looser."""
    field = DistanceField.build(wall(0.06, 0.0025), 0.05)
    for yaw_rad, reach_m in ((0.0, 0.03), (math.pi / 2, 0.015)):
        for spare_m, status in ((0.001, PlanStatus.SOLVED), (-0.0005, PlanStatus.START_UNSAFE)):
            start = Pose(-0.0225 - reach_m - 0.0015 - spare_m, 0.0, 0.03, yaw_rad)
            assert plan(start, Pose(-0.14, 0.0, 0.03), field, SETTINGS, 0).status is status


@pytest.mark.parametrize("seed", range(6))
def test_solved_paths_keep_margin_and_bounds_and_can_be_timed(
    seed: int, make_grid: Callable[..., OccupancyGrid]
) -> None:
    field = DistanceField.build(make_grid(seed, count=5), 0.05)
    settings = dataclasses.replace(SETTINGS, cost="area", z_min_above_table_m=0.025, resolution_m=0.0005)
    result = plan(START, GOAL, field, settings, seed)
    assert result.path is not None
    assert result.clearance_m >= result.margin_m
    assert result.path.poses[:, 2].min() >= 0.025 - 1e-12
    trajectory, profile = schedule(result.path, field, VelocitySettings())
    assert trajectory.poses[:, 2].min() >= 0.025 - 1e-9
    assert profile.clearance_m.min() >= 0.0005


@pytest.mark.parametrize("cost", ["root", "squared", "area"])
def test_further_calls_never_return_a_costlier_path(cost: str, make_grid: Callable[..., OccupancyGrid]) -> None:
    settings = PlannerSettings(n_iterations=150, n_refinements=60, cost=cost)
    for seed in range(4):
        field = DistanceField.build(make_grid(seed, count=5), 0.05)
        planner = Planner(START, [GOAL, Pose(0.1, 0.1, 0.08, 0.4)], field, settings, seed)
        costs = []
        for changed in (False, False, True, False):
            results = planner.replan(field) if changed else planner.plan()
            costs.append([math.inf if result.cost is None else result.cost for result in results])
            for result in results:
                if result.path is not None:
                    assert result.cost == path_cost(line_cost(cost), result.path.poses)
        assert (np.diff(costs, axis=0)[np.isfinite(costs[:-1])] <= 0).all()
        assert np.isfinite(costs[-1]).all()


def test_changed_field_drops_paths_that_it_blocks() -> None:
    planner = Planner(START, [GOAL], DistanceField.build(wall(0.03), 0.05), SETTINGS, 0)
    low = planner.plan()[0]
    field = DistanceField.build(wall(0.06), 0.05)
    high = planner.replan(field)[0]
    assert low.path is not None
    assert high.path is not None
    assert high.path.poses[:, 2].max() > 0.065 > low.path.poses[:, 2].max()
    assert planner.replan(DistanceField.build(wall(0.03), 0.05))[0].cost <= high.cost  # type: ignore[operator]


@pytest.mark.parametrize("shift", [(0, 0, 0, 0), (1e-11, 0, 0, 0), (0, 0, 0, 2 * math.pi), (0, 0, 0, -4 * math.pi)])
def test_goal_equal_to_the_start_is_a_standstill(shift: tuple[float, ...]) -> None:
    field = DistanceField.build(wall(0.06), 0.05)
    result = plan(START, Pose(*np.add(START.as_tuple(), shift)), field, SETTINGS, 0)
    assert result.status is PlanStatus.SOLVED
    assert result.path is not None
    assert result.cost == pytest.approx(0, abs=1e-9)
    assert schedule(result.path, field, VelocitySettings())[0].duration_s == 0


def test_yaw_turns_the_shorter_way() -> None:
    free = DistanceField.build(OccupancyGrid(np.zeros((80, 60, 10), np.float32), np.array(LOWER), 0.005), 0.05)
    result = plan(Pose(-0.1, 0, 0.03, 3.0), Pose(0.1, 0, 0.03, -3.0), free, SETTINGS, 0)
    assert result.path is not None
    np.testing.assert_allclose(result.path.poses[-1, 3], 2 * math.pi - 3.0)
    assert result.cost == pytest.approx(math.sqrt(0.04 + 0.01 * (2 * math.pi - 6) ** 2))


@pytest.mark.parametrize(
    "changes",
    [
        {"delta": 0.0},
        {"cost": "length"},
        {"n_iterations": 0},
        {"n_iterations": 10.5},
        {"n_iterations": math.nan},
        {"n_refinements": 10.5},
        {"goal_bias": 1.0},
        {"steering_range_m": 0.0},
        {"near_factor": math.nan},
        {"near_set": "ball"},
        {"time_limit_s": -1.0},
        {"v_min_mps": -1.0},
        {"reserve_m": -0.1},
        {"yaw_range_rad": 4.0},
    ],
)
def test_settings_out_of_domain_are_refused(changes: dict) -> None:
    with pytest.raises(SettingsError, match=next(iter(changes))):
        dataclasses.replace(SETTINGS, **changes)


def test_field_for_another_delta_is_refused() -> None:
    with pytest.raises(SettingsError, match="delta"):
        plan(START, GOAL, DistanceField.build(wall(0.05), 0.1), SETTINGS, 0)
