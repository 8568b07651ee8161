"""RRT* among walls: structure of the tree, optimality, bounds and seeds."""

import itertools
from typing import Any

import numpy as np
import pytest

from deltasafe.planning import (
    RrtStarSettings,
    grow_tree,
    line_cost,
    path_cost,
    refine_path,
    search_problem,
    segment_is_safe,
)
from deltasafe.planning.search.cost import segment_cost
from tests.unit.planning.walls import Wall, passes

START, GOAL = np.array([-0.15, 0.0, 0.03, 0.0]), np.array([0.15, 0.02, 0.03, 0.3])
LOWER, UPPER = np.array([-0.2, -0.15, 0.02, -1.6]), np.array([0.2, 0.15, 0.15, 1.6])

OPEN, OVER, CLOSED = Wall(0.0, 0.0, 0.0), Wall(0.02, 0.09, 1.0), Wall(0.02, 9.0, 9.0)
COSTS: list[Any] = [line_cost(kind) for kind in ("root", "squared", "area")]


def grown(wall: Wall = OVER, cost: Any = COSTS[0], iterations: int = 1500, seed: int = 0, **options: Any) -> Any:
    problem = search_problem(wall, cost, LOWER, UPPER)
    return grow_tree(problem, START, GOAL, iterations, seed, RrtStarSettings(**options))


@pytest.mark.parametrize("cost", COSTS)
@pytest.mark.parametrize("informed", [True, False])
def test_tree_is_connected_and_its_costs_add_up(cost: Any, informed: bool) -> None:
    tree = grown(cost=cost, informed=informed, near_factor=2.0)
    assert tree.parent[0] == -1
    assert tree.cost[0] == 0
    for node in range(1, len(tree.nodes)):
        parent = tree.parent[node]
        assert parent not in (-1, 1)  # the goal has no children
        step = segment_cost(cost, tree.nodes[parent], tree.nodes[node])
        assert tree.cost[node] == pytest.approx(tree.cost[parent] + step, rel=1e-9)
        assert passes(OVER, tree.nodes[parent], tree.nodes[node])
        seen = set()
        while node > 0:
            assert node not in seen
            seen.add(node)
            node = tree.parent[node]  # noqa: PLW2901
    assert tree.cost[1] == pytest.approx(path_cost(cost, tree.path()))


def test_rewiring_with_all_nodes_as_neighbors_gives_optimal_costs() -> None:
    tree = grown(OPEN, iterations=300, near_factor=1000.0, informed=False, steering_range_m=10.0)
    cost = COSTS[0]
    for node in range(2, len(tree.nodes)):
        assert tree.cost[node] == pytest.approx(segment_cost(cost, START, tree.nodes[node]), rel=1e-9)


def test_nodes_stay_in_bounds() -> None:
    tree = grown(steering_range_m=0.05)
    assert (tree.nodes >= LOWER - 1e-12).all()
    assert (tree.nodes <= UPPER + 1e-12).all()


def test_costs_converge_to_the_known_optimum() -> None:
    """The optimum leads up to the near edge of the wall, across it, and down; the yaw turns in proportion."""
    corners = np.array([START, [-0.02, 0.0, 0.09, 0.1], [0.02, 0.01, 0.09, 0.2], GOAL])
    best = path_cost(COSTS[0], corners)
    costs = [np.mean([grown(iterations=n, seed=seed).cost[1] for seed in range(4)]) for n in (300, 1000, 4000)]
    assert costs[0] > costs[1] > costs[2] > 0.99 * best
    assert costs[2] < 1.08 * best
    tree = grown(seed=1)
    refined = refine_path(search_problem(OVER, COSTS[0], LOWER, UPPER), tree.path(), 800, 0)
    assert path_cost(COSTS[0], refined) < 1.03 * best
    assert all(passes(OVER, a, b) for a, b in itertools.pairwise(refined))
    assert (refined[0] == START).all()
    assert (refined[-1] == GOAL).all()


def test_area_cost_prefers_low_paths() -> None:
    side = Wall(0.02, 0.07, 0.1)  # over it at 0.07 m, or around its end at y = 0.1
    low = grown(side, line_cost("area"), 4000).path()
    high = grown(side, line_cost("root"), 4000).path()
    assert low[:, 2].max() < 0.06 < high[:, 2].max()


@pytest.mark.parametrize("seed", [0, 1])
def test_same_seed_gives_the_same_tree(seed: int) -> None:
    one, two = grown(seed=seed), grown(seed=seed)
    assert (one.nodes == two.nodes).all()
    assert (one.parent == two.parent).all()
    assert not np.array_equal(one.nodes[:100], grown(seed=seed + 10).nodes[:100])


def test_closed_wall_is_not_passed() -> None:
    tree = grown(CLOSED, iterations=500)
    assert tree.path() is None
    assert tree.solved_at == -1
    assert np.isinf(tree.cost[1])
    assert tree.nodes[2:, 0].max() < 0.0


def test_straight_segment_is_tried_first() -> None:
    tree = grown(OPEN, iterations=100)
    assert tree.solved_at == 0
    assert tree.cost[1] == pytest.approx(segment_cost(COSTS[0], START, GOAL))
    assert tree.path().tolist() == [START.tolist(), GOAL.tolist()]


def test_segment_is_safe_raises_outside_of_compiled_code() -> None:
    with pytest.raises(TypeError, match="segment_passes"):
        segment_is_safe(OPEN, START, GOAL)
