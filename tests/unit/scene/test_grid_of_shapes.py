"""Rasterized shapes compared with the formula at each voxel, and refused input."""

import math

import numpy as np
import pytest

from deltasafe.errors import SettingsError
from deltasafe.scene import Cuboid, Sphere, grid_from_shapes, p_occupied_near


@pytest.mark.parametrize("decay_m", [0.0, 0.03])
def test_grid_equals_the_formula_at_each_voxel(decay_m):
    shapes = [
        Sphere((0.05, 0.06, 0.05), 0.03),
        Cuboid((0.12, 0.05, 0.02), (0.03, 0.01, 0.02), 0.7),
        Sphere((0.2, 0.2, 0.2), 0.05),
        Sphere((-0.3, 0.0, 0.0), 0.02),
    ]
    voxel_m = 0.01
    grid = grid_from_shapes(shapes, decay_m, (0, 0, 0), (0.2, 0.15, 0.1), voxel_m)
    axes = [voxel_m * (np.arange(count) + 0.5) for count in grid.p_occupied.shape]
    centers = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    expected = p_occupied_near(shapes, decay_m, centers, slack_m=voxel_m * math.sqrt(3) / 2)
    np.testing.assert_array_equal(grid.p_occupied.ravel(), expected.astype(np.float32))
    assert 0 < grid.p_occupied.mean() < 1


def test_negative_decay_is_refused_without_shapes():
    with pytest.raises(SettingsError, match="decay_m"):
        grid_from_shapes([], -0.1, (0, 0, 0), (0.1, 0.1, 0.1))


@pytest.mark.parametrize("value", [math.nan, math.inf, 1e300])
def test_non_finite_positions_are_refused(value):
    """Otherwise the obstacle would silently be missing from the grid."""
    for position in ((value, 0, 0), (0, value, 0), (0, 0, value)):
        with pytest.raises(SettingsError, match="center_m must be finite"):
            Sphere(position, 0.02)
        with pytest.raises(SettingsError, match="center_m must be finite"):
            Cuboid(position, (0.01, 0.01, 0.01))
        with pytest.raises(SettingsError, match="points_m must be finite"):
            p_occupied_near([Sphere((0, 0, 0), 0.02)], 0.01, np.array([position]))
        with pytest.raises(SettingsError, match="corners"):
            grid_from_shapes([], 0.0, (0, 0, 0), position)
    if not math.isfinite(value):
        with pytest.raises(SettingsError, match="yaw_rad"):
            Cuboid((0, 0, 0), (0.01, 0.01, 0.01), value)


@pytest.mark.parametrize("voxel_m", [0.0, 1e-300, math.nan, math.inf])
def test_invalid_voxel_sizes_are_refused(voxel_m):
    with pytest.raises(SettingsError, match="voxel_m"):
        grid_from_shapes([], 0.0, (0, 0, 0), (0.1, 0.1, 0.1), voxel_m)
