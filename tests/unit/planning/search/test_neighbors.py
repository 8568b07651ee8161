"""Neighbors by scan and by kd-tree, compared with NumPy and SciPy, for counts around the size of a group."""

import numpy as np
import pytest
from scipy.spatial import cKDTree

from deltasafe.planning.search.neighbors import Neighbors, add_point, empty_neighbors, k_nearest, nearest, within
from deltasafe.planning.search.simd_groups import GROUP

COUNTS = [1, 2, GROUP - 1, GROUP, GROUP + 1, 3 * GROUP, 1000]
SCAN, TREE = 10**6, 0


def filled(points: np.ndarray, threshold: int) -> Neighbors:
    neighbors = empty_neighbors(len(points), threshold)
    for n, point in enumerate(points):
        add_point(neighbors, n, tuple(point))
    return neighbors


def clouds(count: int) -> list[np.ndarray]:
    rng = np.random.default_rng(count)
    spread = rng.random((count, 4))
    clustered = np.round(rng.random((count, 4)), 1)  # many equal coordinates, and some equal points
    line = np.outer(np.arange(count) / count, np.ones(4))
    return [points.astype(np.float32) for points in (spread, clustered, line)]


@pytest.mark.parametrize("threshold", [SCAN, TREE])
@pytest.mark.parametrize("count", COUNTS)
def test_nearest_is_the_first_of_the_nearest_points(count: int, threshold: int) -> None:
    for points in clouds(count):
        neighbors = filled(points, threshold)
        for query in np.random.default_rng(1).random((40, 4)).astype(np.float32):
            place, squared = nearest(neighbors, count, tuple(query))
            distances = ((points - query) ** 2).sum(axis=1, dtype=np.float32)
            assert squared == pytest.approx(distances.min(), rel=1e-5)
            assert place == np.flatnonzero((points == points[place]).all(axis=1))[0]


@pytest.mark.parametrize("threshold", [SCAN, TREE])
@pytest.mark.parametrize("count", COUNTS)
def test_k_nearest_finds_the_k_nearest_and_at_most_an_eighth_more(count: int, threshold: int) -> None:
    for number, points in enumerate(clouds(count)):
        neighbors = filled(points, threshold)
        for k in (1, 5, 30, GROUP + 9):
            for guess in (1e-6, 0.02, 10.0):
                query = np.random.default_rng(k).random(4).astype(np.float32)
                m, squared = k_nearest(neighbors, count, tuple(query), k, guess, False)
                found = neighbors.found[:m].tolist()
                assert len(set(found)) == m >= min(k, count)
                distance = np.sqrt(((points - query).astype(np.float64) ** 2).sum(axis=1))
                farthest = np.sort(distance)[min(k, count) - 1]
                assert set(np.flatnonzero(distance < farthest - 1e-6)) <= set(found)
                if count > k:
                    assert distance[found].max() <= np.sqrt(squared) + 1e-6
                    if number == 0:  # without ties
                        assert m <= max(k, k + k // 8)


@pytest.mark.parametrize("threshold", [SCAN, TREE])
@pytest.mark.parametrize("count", COUNTS)
def test_within_finds_all_points_in_a_radius(count: int, threshold: int) -> None:
    for points in clouds(count):
        neighbors, tree = filled(points, threshold), cKDTree(points.astype(np.float64))
        for radius in (0.01, 0.2, 0.5, 3.0):
            query = np.random.default_rng(7).random(4).astype(np.float32)
            m = within(neighbors, count, tuple(query), radius**2)
            found = set(neighbors.found[:m].tolist())
            assert len(found) == m
            inside, outside = (set(tree.query_ball_point(query, radius * (1 + d))) for d in (-1e-5, 1e-5))
            assert inside <= found <= outside
