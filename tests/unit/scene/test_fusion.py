"""Fusion of the grids of several cameras."""

import numpy as np
import pytest

from deltasafe.errors import SettingsError
from deltasafe.scene import Camera, FieldSettings, OccupancyGrid, fuse_grids, grid_from_image


def random_grid(seed: int, shape: tuple[int, int, int], origin_voxels: tuple[int, int]) -> OccupancyGrid:
    p_occupied = np.random.default_rng(seed).random(shape).astype(np.float32)
    return OccupancyGrid(p_occupied, np.array([*origin_voxels, 0]) * 0.01, 0.01)


def test_fused_grid_is_the_minimum_at_each_point() -> None:
    grids = [random_grid(0, (8, 6, 5), (0, 0)), random_grid(1, (7, 9, 4), (3, -2)), random_grid(2, (2, 2, 6), (-1, 4))]
    fused = fuse_grids(grids)
    points_m = np.random.default_rng(3).uniform([-0.05, -0.05, -0.01], [0.15, 0.12, 0.07], (4000, 3))
    np.testing.assert_array_equal(fused.at(points_m), np.min([grid.at(points_m) for grid in grids], axis=0))


def test_second_camera_removes_the_shadow_of_the_first() -> None:
    """A post seen from two sides: each extrusion leans away from its camera, but their intersection does not."""
    grids = []
    for x_m in (-0.15, 0.15):
        rotation = np.diag([1.0, -1.0, -1.0])
        camera = Camera(200, 200, 150.0, 150.0, 100.0, 100.0, np.array([x_m, 0.0, 0.5]), rotation)
        height = np.linspace(0, 0.06, 30)
        post = np.stack(np.meshgrid([-0.01, 0.0, 0.01], [-0.01, 0.0, 0.01], height), axis=-1).reshape(-1, 3)
        image = np.zeros((200, 200), np.float32)
        u, v = camera.project(post)[0].astype(int).T
        image[v, u] = 1.0
        grids.append(grid_from_image(image, camera, 0.0, 0.06, FieldSettings(0.005, 0.0)))
    fused = fuse_grids(grids)
    inside = np.abs(fused.origin_m[0] + 0.005 * (np.arange(fused.p_occupied.shape[0]) + 0.5)) < 0.1
    seen = [float((grid.p_occupied > 0.5).mean()) for grid in grids]
    assert (fused.p_occupied[inside] > 0.5).sum() > 20
    assert (fused.at(post - [0, 0, 1e-9]) == 1.0)[height[0] < post[:, 2]].all()
    assert (fused.p_occupied > 0.5).mean() < 0.9 * min(seen)


@pytest.mark.parametrize("other", [random_grid(0, (3, 3, 3), (0, 0))])
def test_grids_with_other_voxels_or_tables_are_refused(other: OccupancyGrid) -> None:
    shifted = OccupancyGrid(other.p_occupied, np.array([0.004, 0.0, 0.0]), 0.01)
    raised = OccupancyGrid(other.p_occupied, np.array([0.0, 0.0, 0.01]), 0.01)
    coarse = OccupancyGrid(other.p_occupied, np.zeros(3), 0.02)
    for wrong in (shifted, raised, coarse):
        with pytest.raises(SettingsError, match="share voxels"):
            fuse_grids([other, wrong])
    with pytest.raises(SettingsError, match="no grid"):
        fuse_grids([])
