"""The distance field against brute force over boxes."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from deltasafe.errors import SettingsError
from deltasafe.planning import DistanceField
from deltasafe.planning.collision.distance_field import REACH_M
from deltasafe.planning.collision.distance_transform import squared_distance_in_slabs, squared_distance_to_voxels
from deltasafe.scene import OccupancyGrid


def box_distance(points: np.ndarray, lower: np.ndarray, upper: np.ndarray) -> np.ndarray:
    """(N,) smallest distance of points (N, 3) to any of the boxes (M, 3), (M, 3)."""
    gaps = np.maximum(np.maximum(lower[None] - points[:, None], points[:, None] - upper[None]), 0)
    return np.linalg.norm(gaps, axis=2).min(axis=1)


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 2**31), st.integers(1, 9), st.floats(0.01, 0.3))
def test_distance_transform_equals_brute_force(seed: int, reach: int, density: float) -> None:
    rng = np.random.default_rng(seed)
    unsafe = rng.random(rng.integers(1, 9, 3)) < density
    squared = squared_distance_to_voxels(unsafe, reach)
    cells = np.argwhere(unsafe)
    centers = np.argwhere(np.ones_like(unsafe)) + 0.5
    expected = np.full(len(centers), float(reach**2))
    if len(cells):
        expected = np.minimum(box_distance(centers, cells, cells + 1) ** 2, reach**2)
    np.testing.assert_array_equal(squared.ravel(), np.rint(4 * expected))


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 2**31), st.integers(0, 3), st.integers(1, 9), st.floats(0.01, 0.3))
def test_slab_distances_equal_brute_force(seed: int, half: int, reach: int, density: float) -> None:
    rng = np.random.default_rng(seed)
    unsafe = rng.random(rng.integers(1, 9, 3)) < density
    squared = squared_distance_in_slabs(unsafe, half, reach)
    assert squared.shape == unsafe.shape
    for k, of_slice in enumerate(squared.transpose(2, 0, 1)):
        slab = unsafe[:, :, max(k - half, 0) : k + half + 1].any(axis=2)
        cells = np.argwhere(slab)
        centers = np.argwhere(np.ones_like(slab)) + 0.5
        expected = np.full(len(centers), float(reach**2))
        if len(cells):
            expected = np.minimum(box_distance(centers, cells, cells + 1) ** 2, reach**2)
        np.testing.assert_array_equal(of_slice.ravel(), np.rint(4 * expected))


def true_distance(grid: OccupancyGrid, delta: float, points: np.ndarray) -> np.ndarray:
    """Distance to unsafe voxels, to the space beside the grid below its top, and to the table."""
    cells = np.argwhere(grid.p_occupied > delta)
    lower = grid.origin_m + cells * grid.voxel_m
    far = 9.0
    (x0, y0, z0), (x1, y1, z1) = grid.origin_m, grid.upper_m
    sides_low = [[-far, -far, z0], [x1, -far, z0], [-far, -far, z0], [-far, y1, z0], [-far, -far, -far]]
    sides_high = [[x0, far, z1], [far, far, z1], [far, y0, z1], [far, far, z1], [far, far, z0]]
    return box_distance(points, np.vstack([lower, sides_low]), np.vstack([lower + grid.voxel_m, sides_high]))


def test_clearance_is_a_tight_lower_bound() -> None:
    rng = np.random.default_rng(4)
    p_occupied = np.where(rng.random((20, 16, 8)) < 0.01, rng.random((20, 16, 8)), 0).astype(np.float32)
    grid = OccupancyGrid(p_occupied, np.array([-0.05, 0.1, 0.2]), 0.005)
    field = DistanceField.build(grid, 0.05)
    points = rng.uniform(grid.origin_m - 0.02, grid.upper_m + np.array([0.02, 0.02, 0.12]), (3000, 3))
    expected = true_distance(grid, 0.05, points)
    clearance_m = field.clearance_m(points)
    assert (clearance_m <= expected + 1e-9).all()
    free = expected > 0
    assert 500 < free.sum() < 2900
    assert (clearance_m[~free] <= 0).all()
    assert (clearance_m >= np.minimum(expected, REACH_M) - grid.voxel_m * np.sqrt(3) - 1e-9)[free].all()
    assert ((clearance_m > 0) <= (grid.at(points) <= 0.05)).all()


def test_ray_distance_is_the_minimum_of_the_voxels_above() -> None:
    rng = np.random.default_rng(5)
    grid = OccupancyGrid((rng.random((12, 12, 10)) < 0.01).astype(np.float32), np.zeros(3), 0.005)
    arrays = DistanceField.build(grid, 0.5).arrays
    for k in range(arrays.squared_distance.shape[2]):
        expected = arrays.squared_distance[:, :, k:].min(axis=2)
        assert (arrays.squared_ray_distance[:, :, k] == expected).all()


def test_coarse_clearance_is_a_lower_bound_for_all_voxels_of_a_cell() -> None:
    rng = np.random.default_rng(6)
    grid = OccupancyGrid((rng.random((21, 17, 10)) < 0.01).astype(np.float32), np.zeros(3), 0.0025)
    field = DistanceField.build(grid, 0.5)
    arrays = field.arrays
    index = np.argwhere(arrays.squared_distance > 0)
    for bound_m, squared in zip(field.coarse_clearance_m(), arrays[:2], strict=True):
        bounds = bound_m[tuple((index // arrays.lattice.stride).T)]
        exact_m = np.sqrt(squared[tuple(index.T)]) * 0.00125
        capped = squared == squared.max()
        assert (bounds <= np.where(capped[tuple(index.T)], np.inf, exact_m - 0.0025 * np.sqrt(3) / 2 + 1e-7)).all()
        # beyond the reach of the voxels' distances: at most the true distance to the nearest unsafe voxel
        cells = np.argwhere(arrays.squared_distance == 0)
        for far in index[capped[tuple(index.T)]][:40]:
            gap = np.maximum(np.abs(cells - far) - 0.5, 0)
            if squared is arrays.squared_distance:
                assert bound_m[tuple(far // arrays.lattice.stride)] <= np.sqrt((gap**2).sum(axis=1).min()) * 0.0025
    assert arrays.lattice.stride == 4


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 2**31), st.floats(0.02, 0.5), st.floats(0.02, 0.5))
def test_distances_grow_with_delta(seed: int, one: float, other: float) -> None:
    rng = np.random.default_rng(seed)
    grid = OccupancyGrid((rng.random((8, 8, 6)) ** 4).astype(np.float32), np.zeros(3), 0.01)
    low, high = (DistanceField.build(grid, delta) for delta in sorted((one, other)))
    for of_low, of_high in zip(
        (*low.arrays[:2], *low.coarse_clearance_m()), (*high.arrays[:2], *high.coarse_clearance_m()), strict=True
    ):
        assert (of_low <= of_high).all()


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf, 1e300])
def test_non_finite_points_are_refused(value: float) -> None:
    field = DistanceField.build(OccupancyGrid(np.zeros((4, 4, 4), np.float32), np.zeros(3), 0.01), 0.05)
    for axis in range(3):
        points = np.zeros((2, 3))
        points[1, axis] = value
        with pytest.raises(SettingsError, match="points_m must be finite"):
            field.clearance_m(points)
        with pytest.raises(SettingsError, match="points_m must be finite"):
            field.grid.at(points)
        with pytest.raises(SettingsError, match="positions_m must be finite"):
            field.grid.max_p_occupied_on(np.zeros((1, 3)), np.stack([np.eye(3)] * 2), points)
    for wrong in (np.zeros((2, 2)), np.zeros(3), np.zeros((2, 4))):
        with pytest.raises(SettingsError, match="points_m"):
            field.clearance_m(wrong)
    assert field.clearance_m(np.array([[900.0, 0.0, 0.02], [0.0, 0.0, -900.0]])).max() < 0


@pytest.mark.parametrize("delta", [0.0, 1.0, float("nan")])
def test_delta_outside_0_1_is_refused(delta: float) -> None:
    grid = OccupancyGrid(np.zeros((2, 2, 2), np.float32), np.zeros(3), 0.01)
    with pytest.raises(SettingsError, match="delta"):
        DistanceField.build(grid, delta)


def test_probability_equal_to_delta_is_free_and_the_next_larger_one_is_not() -> None:
    """The comparison of the stored single-precision value with delta is exact."""
    for delta in (0.05, 0.1, 0.25, 0.3):
        stored = np.float32(delta)
        below, above = np.nextafter(stored, np.float32(0)), np.nextafter(stored, np.float32(1))
        for p, unsafe in ((below, False), (stored, float(stored) > delta), (above, True)):
            grid = OccupancyGrid(np.full((3, 3, 3), p, np.float32), np.zeros(3), 0.01)
            inner = DistanceField.build(grid, delta).arrays.squared_distance[1:-1, 1:-1, 0]
            assert ((inner == 0) == unsafe).all()
