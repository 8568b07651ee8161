"""Continued searches: in several calls, for several goals, and with another constraint."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from deltasafe.errors import SettingsError
from deltasafe.planning import (
    CheckSettings,
    DistanceField,
    RrtStar,
    RrtStarSettings,
    SearchTree,
    ToolBody,
    line_cost,
    path_cost,
    refine_path,
    search_problem,
    segment_test,
)
from deltasafe.planning.search.cost import segment_cost
from deltasafe.scene import OccupancyGrid
from tests.unit.planning.walls import Wall, passes

START, GOAL = np.array([-0.15, 0.0, 0.03, 0.0]), np.array([0.15, 0.02, 0.03, 0.3])
LOWER, UPPER = np.array([-0.2, -0.15, 0.02, -1.6]), np.array([0.2, 0.15, 0.15, 1.6])
ROOT = line_cost("root")
WALL = Wall(0.06, 0.12, 0.02)


def search(wall: Wall = WALL, cost: Any = ROOT, seed: int = 0, goals: Any = GOAL, **options: Any) -> RrtStar:
    return RrtStar(search_problem(wall, cost, LOWER, UPPER), START, goals, seed, RrtStarSettings(**options))


def same(one: SearchTree, two: SearchTree) -> bool:
    return bool(
        np.array_equal(one.nodes, two.nodes)
        and np.array_equal(one.parent, two.parent)
        and np.array_equal(one.cost, two.cost)
    )


def check(tree: SearchTree, cost: Any, wall: Wall) -> None:
    """Assert that the tree is connected, that its costs add up, and that its edges pass."""
    assert np.isfinite(tree.nodes).all()
    assert not np.isnan(tree.cost).any()
    assert tree.parent[0] == -1
    assert tree.cost[0] == 0
    for node in range(1, len(tree.nodes)):
        parent = int(tree.parent[node])
        if parent < 0:
            assert node <= tree.n_goals
            assert tree.cost[node] == np.inf
            continue
        assert parent == 0 or parent > tree.n_goals  # goals have no children
        step = segment_cost(cost, tree.nodes[parent], tree.nodes[node])
        assert tree.cost[node] == pytest.approx(tree.cost[parent] + step, rel=1e-9)
        assert passes(wall, tree.nodes[parent], tree.nodes[node])
        for _ in range(len(tree.nodes)):
            if parent <= 0:
                break
            parent = int(tree.parent[parent])
        assert parent == 0


@settings(max_examples=12, deadline=None)
@given(st.integers(0, 2**31), st.sampled_from(["root", "squared", "area"]), st.booleans(), st.lists(st.integers(1, 60)))
def test_tree_is_valid_after_each_call_and_never_gets_worse(seed: int, kind: str, informed: bool, pieces: list) -> None:
    cost = line_cost(kind)
    growing = search(cost=cost, seed=seed, informed=informed, near_factor=2.0)
    best = np.inf
    for piece in pieces[:6]:
        assert growing.grow(piece) == piece
        check(growing.tree, cost, WALL)
        assert growing.tree.cost[1] <= best + 1e-12
        best = growing.tree.cost[1]


@pytest.mark.parametrize("near_set", ["k", "radius"])
def test_tree_does_not_depend_on_calls_or_on_the_bucket_threshold(near_set: str) -> None:
    trees = []
    for pieces, threshold in (([1500], 10**6), ([1, 63, 500, 936], 10**6), ([1500], 40), ([700, 800], 300)):
        growing = search(near_set=near_set, near_factor=1.5, bucket_threshold=threshold)
        for piece in pieces:
            growing.grow(piece)
        trees.append(growing.tree)
    assert all(same(trees[0], tree) for tree in trees[1:])
    assert trees[0].n_iterations == 1500


def test_deadline_ends_a_search_after_a_chunk() -> None:
    ticks = iter(range(1000))
    growing = search()
    assert growing.grow(deadline_s=5, clock=lambda: float(next(ticks))) == 5 * 64
    assert growing.grow(1000, deadline_s=0.0) == 0
    with pytest.raises(SettingsError, match="deadline"):
        growing.grow()


def test_one_tree_reaches_several_goals() -> None:
    goals = np.array([GOAL, [0.15, -0.1, 0.03, 0.0], [0.0, 0.0, 0.05, 0.0], [0.1, 0.1, 0.1, -1.0]])
    growing = search(goals=goals)
    growing.grow(2500)
    tree = growing.tree
    check(tree, ROOT, WALL)
    assert [bool(np.isfinite(cost)) for cost in tree.cost[1:5]] == [True, True, False, True]  # one is in the wall
    for number in (0, 1, 3):
        path = tree.path(number)
        assert path is not None
        assert path[-1].tolist() == goals[number].tolist()
        alone = search(goals=goals[number])
        alone.grow(2500)
        assert tree.cost[1 + number] < 1.25 * alone.tree.cost[1]
    assert tree.path(2) is None
    assert tree.best_goal == int(tree.cost[1:5].argmin())


def test_recheck_keeps_the_valid_part_of_the_tree() -> None:
    growing = search(informed=False)
    growing.grow(1500)
    before = growing.tree
    moved = Wall(0.06, 0.12, 0.07)
    left = growing.recheck(moved)
    after = growing.tree
    check(after, ROOT, moved)
    assert 300 < left < len(before.nodes)
    old = {tuple(pose): cost for pose, cost in zip(before.nodes, before.cost, strict=True)}
    kept = [node for node in range(2, len(after.nodes)) if tuple(after.nodes[node]) in old]
    assert len(kept) == len(after.nodes) - 2
    assert all(after.cost[node] == old[tuple(after.nodes[node])] for node in kept)
    growing.grow(500)
    check(growing.tree, ROOT, moved)
    fresh = search(moved, informed=False)
    fresh.grow(500)
    assert growing.tree.cost[1] < 1.05 * fresh.tree.cost[1]


def test_recheck_with_the_same_constraint_keeps_all_nodes() -> None:
    growing = search()
    growing.grow(400)
    before = growing.tree
    growing.recheck(WALL)
    after = growing.tree
    assert sorted(map(tuple, before.nodes)) == sorted(map(tuple, after.nodes))
    assert sorted(before.cost) == sorted(after.cost)


@pytest.mark.parametrize(
    "options",
    [
        {"goals": np.zeros((0, 4))},
        {"goals": np.zeros(3)},
        {"goals": np.array([0.1, np.nan, 0.03, 0.0])},
        {"steering_range_m": np.nan},
        {"steering_range_m": 0.0},
        {"steering_range_m": 1e300},
        {"goal_bias": np.nan},
        {"near_factor": np.nan},
        {"near_factor": 1e300},
    ],
)
def test_goals_and_settings_out_of_domain_are_refused(options: dict) -> None:
    with pytest.raises(SettingsError):
        search(**options)


@pytest.mark.parametrize("bound", [-np.inf, -1e300, np.nan])
def test_non_finite_bounds_are_refused(bound: float) -> None:
    with pytest.raises(SettingsError, match="bounds"):
        search_problem(WALL, ROOT, np.array([bound, *LOWER[1:]]), UPPER)


def test_endless_budgets_are_refused() -> None:
    growing = search()
    for budget in ({"n_iterations": 10.5}, {"n_iterations": float("nan")}, {"deadline_s": float("nan")}):
        with pytest.raises(SettingsError, match="a search needs"):
            growing.grow(**budget)
        steps = {"n_steps": budget.get("n_iterations"), "deadline_s": budget.get("deadline_s", np.inf)}
        with pytest.raises(SettingsError, match="a refinement needs"):
            refine_path(growing.problem, np.array([START, GOAL]), seed=0, **steps)
    assert growing.grow(np.int64(10)) == 10


def test_refinement_refuses_invalid_paths() -> None:
    path = np.array([START, GOAL])
    for poses in (path * np.nan, path[:, :3]):
        with pytest.raises(SettingsError, match="poses"):
            refine_path(search().problem, poses, 10, 0)


def test_cost_refuses_weights_that_overflow_single_precision() -> None:
    for weights in ((np.inf, 0.0, 0.1), (1e300, 0.0, 0.1), (np.nan, 0.0, 0.1), (0.1, np.nan, 0.1), (0.1, 0.0, np.inf)):
        with pytest.raises(SettingsError):
            line_cost("area", *weights)
    with pytest.raises(SettingsError, match="shape"):
        path_cost(ROOT, np.zeros((5, 3)))


def test_ends_outside_the_bounds_and_unknown_near_sets_are_refused() -> None:
    with pytest.raises(SettingsError, match="within"):
        search(goals=np.array([0.3, 0.0, 0.03, 0.0]))
    with pytest.raises(SettingsError, match="near_set"):
        search(near_set="ball")


@pytest.mark.parametrize("method", ["sampled", "exact", "continuous"])
def test_clearance_tables_do_not_change_the_tree(method: str, make_grid: Callable[..., OccupancyGrid]) -> None:
    field, trees = DistanceField.build(make_grid(2), 0.05), []
    for flag in (True, False):
        options = CheckSettings(method=method, use_clearance_tables=flag)
        test = segment_test(field, ToolBody(), 0.001, options, seed=3)
        problem = search_problem(test, ROOT, LOWER, UPPER)
        growing = RrtStar(problem, START * [1, 1, 1, 0], GOAL * [0.9, 1, 1, 0], 4)
        growing.grow(500)
        trees.append(growing.tree)
    assert same(*trees)
    assert len(trees[0].nodes) > 100
