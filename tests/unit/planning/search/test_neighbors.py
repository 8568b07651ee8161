"""The nearest nodes against SciPy: all looked at, or in buckets, around the sizes of a group."""

import numpy as np
import pytest
from scipy.spatial import cKDTree

from deltasafe.planning.search.neighbors import Neighbors, add_point, empty_neighbors, k_nearest, nearest, within
from deltasafe.planning.search.simd_groups import GROUP

COUNTS = [1, 2, GROUP - 1, GROUP, GROUP + 1, 3 * GROUP, 1000]
EVERYWHERE, IN_BUCKETS = 10**6, 0


def filled(points: np.ndarray, many: int) -> Neighbors:
    known = empty_neighbors(len(points), many)
    for n, point in enumerate(points):
        add_point(known, n, tuple(point))
    return known


def clouds(count: int) -> list[np.ndarray]:
    rng = np.random.default_rng(count)
    spread = rng.random((count, 4))
    heap = np.round(rng.random((count, 4)), 1)  # many equal coordinates, and some equal points
    line = np.outer(np.arange(count) / count, np.ones(4))
    return [points.astype(np.float32) for points in (spread, heap, line)]


@pytest.mark.parametrize("many", [EVERYWHERE, IN_BUCKETS])
@pytest.mark.parametrize("count", COUNTS)
def test_the_nearest_is_the_nearest_and_of_equals_the_first(count: int, many: int) -> None:
    for points in clouds(count):
        known = filled(points, many)
        for asked in np.random.default_rng(1).random((40, 4)).astype(np.float32):
            place, squared = nearest(known, count, tuple(asked))
            distances = ((points - asked) ** 2).sum(axis=1, dtype=np.float32)
            assert squared == pytest.approx(distances.min(), rel=1e-5)
            assert place == np.flatnonzero((points == points[place]).all(axis=1))[0]


@pytest.mark.parametrize("many", [EVERYWHERE, IN_BUCKETS])
@pytest.mark.parametrize("count", COUNTS)
def test_the_k_nearest_are_among_those_found_and_no_more_than_an_eighth_is_too_many(count: int, many: int) -> None:
    for number, points in enumerate(clouds(count)):
        known = filled(points, many)
        for k in (1, 5, 30, GROUP + 9):
            for guess in (1e-6, 0.02, 10.0):
                asked = np.random.default_rng(k).random(4).astype(np.float32)
                m, squared = k_nearest(known, count, tuple(asked), k, guess, False)
                found = known.found[:m].tolist()
                assert len(set(found)) == m >= min(k, count)
                away = np.sqrt(((points - asked).astype(np.float64) ** 2).sum(axis=1))
                farthest = np.sort(away)[min(k, count) - 1]
                assert set(np.flatnonzero(away < farthest - 1e-6)) <= set(found)
                if count > k:
                    assert away[found].max() <= np.sqrt(squared) + 1e-6
                    if number == 0:  # without ties
                        assert m <= max(k, k + k // 8)


@pytest.mark.parametrize("many", [EVERYWHERE, IN_BUCKETS])
@pytest.mark.parametrize("count", COUNTS)
def test_all_within_a_radius_are_found(count: int, many: int) -> None:
    for points in clouds(count):
        known, tree = filled(points, many), cKDTree(points.astype(np.float64))
        for radius in (0.01, 0.2, 0.5, 3.0):
            asked = np.random.default_rng(7).random(4).astype(np.float32)
            m = within(known, count, tuple(asked), radius**2)
            found = set(known.found[:m].tolist())
            assert len(found) == m
            inside, outside = (set(tree.query_ball_point(asked, radius * (1 + d))) for d in (-1e-5, 1e-5))
            assert inside <= found <= outside
