"""Occupancy grids: look-ups, storage, and grids made from images and shapes."""

import dataclasses
import pathlib
import re
import tracemalloc

import numpy as np
import pytest

from deltasafe.errors import DataError, SettingsError
from deltasafe.geometry import Pose
from deltasafe.scene import (
    Camera,
    Cuboid,
    FieldSettings,
    OccupancyGrid,
    Sphere,
    extrusion,
    fuse_grids,
    grid_from_image,
    grid_from_shapes,
    p_occupied_near,
)
from deltasafe.scene.occupancy import MAX_VOXELS

DOWN = np.diag([1.0, -1.0, -1.0])


def camera(tilt: float = 0.0) -> Camera:
    cos, sin = np.cos(tilt), np.sin(tilt)
    rotation = np.array([[1, 0, 0], [0, cos, -sin], [0, sin, cos]]) @ DOWN
    return Camera(160, 120, 192.0, 192.0, 80.0, 60.0, np.array([0.0, 0.0, 0.5]), rotation)


def test_outside_the_grid_is_free_above_and_occupied_elsewhere() -> None:
    grid = OccupancyGrid(np.full((2, 2, 2), 0.25, np.float32), np.zeros(3), 0.1)
    points = [[0.1, 0.1, 0.1], [0.1, 0.1, 0.21], [9, 9, 0.21], [0.3, 0.1, 0.1], [-0.01, 0.1, 0.1], [0.1, 0.1, -0.01]]
    assert grid.at(np.array(points)).tolist() == [0.25, 0, 0, 1, 1, 1]


def test_stored_grid_equals_the_original(tmp_path: pathlib.Path) -> None:
    grid = OccupancyGrid(np.random.default_rng(0).random((3, 4, 5)), np.array([0.1, 0.2, 0.3]), 0.004)
    grid.save(tmp_path / "grid.npz")
    again = OccupancyGrid.load(tmp_path / "grid.npz")
    assert (again.p_occupied == grid.p_occupied).all()
    assert (again.origin_m == grid.origin_m).all()
    assert again.voxel_m == grid.voxel_m
    (tmp_path / "grid.npz").write_bytes(b"no zip")
    with pytest.raises(DataError, match="not an occupancy grid"):
        OccupancyGrid.load(tmp_path / "grid.npz")


def test_dilation_is_the_set_of_voxels_within_the_margin_of_an_unsafe_one() -> None:
    rng = np.random.default_rng(2)
    grid = OccupancyGrid((rng.random((13, 9, 4)) ** 12).astype(np.float32), np.zeros(3), 0.002)
    for delta, margin_m in [(0.5, 0.001), (0.5, 0.004), (0.3, 0.0075), (0.7, 0.1)]:
        dilated = grid.dilated(delta, margin_m).p_occupied
        unsafe = np.argwhere(grid.p_occupied > delta)
        for i, j, k in np.ndindex(grid.p_occupied.shape):
            same = unsafe[unsafe[:, 2] == k][:, :2]
            gap_m = np.maximum(np.abs(same - (i, j)) - 1, 0) * grid.voxel_m  # between the nearest points of two squares
            within = bool((np.hypot(*gap_m.T) <= margin_m + 1e-12).any())
            assert dilated[i, j, k] == (1.0 if within else grid.p_occupied[i, j, k])


def test_unseen_voxels_are_not_dilated() -> None:
    grid = grid_from_image(np.zeros((120, 160), np.float32), camera(), 0.0, 0.05, FieldSettings(voxel_m=0.005))
    assert grid.unseen is not None
    assert ((grid.p_occupied == 1) == grid.unseen).all()
    assert (grid.dilated(0.05, 0.03).p_occupied == grid.p_occupied).all()
    seen = np.zeros((120, 160), np.float32)
    seen[60, 80] = 1.0  # as certain as what is unseen
    grid = grid_from_image(seen, camera(), 0.0, 0.05, FieldSettings(voxel_m=0.005))
    assert (grid.dilated(0.05, 0.03).p_occupied > grid.p_occupied).any()
    with pytest.raises(SettingsError, match="unseen"):
        OccupancyGrid(np.zeros((2, 2, 2), np.float32), np.zeros(3), 0.1, np.ones((2, 2, 2), np.bool_))


def test_dilation_by_nothing_returns_the_grid() -> None:
    grid = OccupancyGrid(np.full((2, 2, 2), 0.25, np.float32), np.zeros(3), 0.1)
    assert grid.dilated(0.2, 0.0) is grid
    assert grid.dilated(0.3, 1.0) is grid
    for delta, margin_m in [(0.0, 0.01), (1.0, 0.01), (0.2, -0.01), (0.2, np.nan), (0.2, np.inf)]:
        with pytest.raises(SettingsError, match=r"delta|margin"):
            grid.dilated(delta, margin_m)


@pytest.mark.parametrize("value", [np.nan, -0.1, 1.1])
def test_values_outside_0_1_are_refused(value: float) -> None:
    with pytest.raises(SettingsError, match="p_occupied"):
        OccupancyGrid(np.full((2, 2, 2), value, np.float32), np.zeros(3), 0.1)
    with pytest.raises(SettingsError, match="p_occupied"):
        grid_from_image(np.full((120, 160), value, np.float32), camera(), 0.0, 0.05)


@pytest.mark.parametrize(
    ("origin_m", "voxel_m"), [((0, 0, 0), 1e-320), ((0, 0, 0), np.inf), ((0, np.nan, 0), 0.1), ((1e300, 0, 0), 0.1)]
)
def test_grid_that_cannot_be_indexed_is_refused(origin_m: tuple, voxel_m: float) -> None:
    """The inverse of 1e-320 is infinite, and 0 times infinity is NaN: an index outside all arrays."""
    with pytest.raises(SettingsError, match=r"voxel_m|finite"):
        OccupancyGrid(np.zeros((2, 2, 2), np.float32), np.array(origin_m, dtype=float), voxel_m)


@pytest.mark.parametrize("table_z_m", [np.nan, -np.inf, -1e300])
def test_non_finite_or_far_table_is_refused(table_z_m: float) -> None:
    with pytest.raises(SettingsError):
        grid_from_image(np.zeros((120, 160), np.float32), camera(), table_z_m, 0.05)


@pytest.mark.parametrize("tilt", [0.0, 0.3])
def test_extruded_grid_bounds_the_pixel_of_each_point(tilt: float) -> None:
    """The grid at a visible point is at least the pixel that the point projects to, and 0 above the top."""
    rng = np.random.default_rng(1)
    image = (rng.random((120, 160)) ** 4).astype(np.float32)
    view = camera(tilt)
    settings = FieldSettings(voxel_m=0.004)
    grid = grid_from_image(image, view, 0.0, 0.06, settings)
    assert grid.upper_m[2] == pytest.approx(0.072)  # 0.06 + 0.01, rounded up to whole voxels
    points = rng.uniform(grid.origin_m, grid.upper_m, (20000, 3))
    uv, _ = view.project(points)
    seen = (uv[:, 0] > 0) & (uv[:, 0] < 160) & (uv[:, 1] > 0) & (uv[:, 1] < 120)
    p_occupied = grid.at(points)
    columns, rows = np.floor(uv[seen]).astype(int).T
    assert seen.sum() > 5000
    assert (p_occupied[seen] >= image[rows, columns]).all()
    assert (p_occupied[~seen] == 1).all()
    assert (grid.at(points + np.array([0, 0, 0.08])) == 0).all()


def test_extruded_disc_is_a_cone_of_at_most_one_voxel_more() -> None:
    """A disc in the middle of the image becomes a cone with its apex at the camera."""
    v, u = np.mgrid[:120, :160] + 0.5
    radius_px = 30.0
    image = (np.hypot(u - 80, v - 60) <= radius_px).astype(np.float32)
    grid = grid_from_image(image, camera(), 0.0, 0.09, FieldSettings(voxel_m=0.004))
    index = np.argwhere(grid.p_occupied < 2)
    centers = grid.origin_m + (index + 0.5) * grid.voxel_m
    cone_m = radius_px / 192.0 * (0.5 - centers[:, 2])
    off_m = np.hypot(centers[:, 0], centers[:, 1])
    inside = grid.p_occupied[tuple(index.T)] == 1
    seen = (np.abs(centers[:, 0]) < 0.15) & (np.abs(centers[:, 1]) < 0.1)
    assert inside[off_m < cone_m - 0.004].all()
    # the cone is exceeded by at most the bounding box of a voxel's projection
    assert not inside[seen & (off_m > cone_m + 0.016)].any()


TASK = (Pose(-0.1, 0.0, 0.03), Pose(0.1, 0.05, 0.03))


@pytest.mark.parametrize("tilt", [0.0, 0.4])
def test_grid_near_a_task_equals_the_whole_grid_where_it_is_and_is_occupied_elsewhere(tilt: float) -> None:
    image = np.random.default_rng(2).random((120, 160)).astype(np.float32) * 0.9
    whole = grid_from_image(image, camera(tilt), 0.0, 0.05, FieldSettings(0.005))
    near = grid_from_image(image, camera(tilt), 0.0, 0.05, FieldSettings(0.005, reach_m=0.06), TASK)
    assert near.p_occupied.size < whole.p_occupied.size
    points = np.random.default_rng(3).uniform(whole.origin_m, whole.upper_m, (20000, 3))
    ends = np.array([[-0.1, 0.0], [0.1, 0.05]])
    away = np.maximum(np.maximum(ends.min(axis=0) - points[:, :2], points[:, :2] - ends.max(axis=0)), 0).max(axis=1)
    inside, outside = away < 0.06, away > 0.06 + 2 * 0.005
    # the voxels of both grids may be shifted against each other, by less than one
    settings = FieldSettings(0.005)
    large = grid_from_image(image, camera(tilt), 0.0, 0.05, settings, TASK)
    assert (large.p_occupied == whole.p_occupied).all()
    assert (near.at(points[outside]) == 1).all()
    uv, _ = camera(tilt).project(points)
    seen = inside & ((uv > 0) & (uv < (160, 120))).all(axis=1)
    columns, rows = np.floor(uv[seen]).astype(int).T
    assert seen.sum() > 1000
    assert (near.at(points[seen]) >= image[rows, columns]).all()
    assert (near.at(points[seen]) < 1).mean() > 0.5


@pytest.mark.parametrize("tilt_deg", [62, 67, 80, 85])
def test_oblique_camera_gets_a_bounded_grid(tilt_deg: float) -> None:
    """B14: the horizon is near or in the image. Only what is seen within reach of the task is in the grid."""
    tilt = np.radians(tilt_deg)
    view = dataclasses.replace(camera(tilt), position_m=np.array([0.0, -0.5 * np.tan(min(tilt, 1.2)), 0.5]))
    free = np.zeros((120, 160), np.float32)
    grid = grid_from_image(free, view, 0.0, 0.05, FieldSettings(0.01), TASK)
    extent_m = (grid.upper_m - grid.origin_m)[:2]
    assert (extent_m <= [1.2 + 0.02, 1.05 + 0.02]).all()
    index = np.argwhere(grid.p_occupied == 0)
    assert len(index)
    uv, _ = view.project(grid.origin_m + (index + 0.5) * grid.voxel_m)
    assert ((uv > 0) & (uv < (160, 120))).all()  # what is not seen stays occupied
    with pytest.raises(SettingsError, match=r"whole image must show the table|voxels|within 1000"):
        grid_from_image(free, view, 0.0, 0.05, FieldSettings(0.0005))


def test_large_image_is_reduced_without_losing_a_pixel(monkeypatch) -> None:
    image = (np.random.default_rng(4).random((120, 160)) ** 4).astype(np.float32)
    exact = grid_from_image(image, camera(0.3), 0.0, 0.05, FieldSettings(0.005))
    monkeypatch.setattr(extrusion, "MAX_PIXELS", 120 * 160 // 3)  # blocks of 2 x 2
    reduced = grid_from_image(image, camera(0.3), 0.0, 0.05, FieldSettings(0.005))
    assert (reduced.p_occupied >= exact.p_occupied).all()
    assert 0 < (reduced.p_occupied - exact.p_occupied).mean() < 0.15


def test_too_many_voxels_are_refused_before_they_are_allocated() -> None:
    free = np.zeros((120, 160), np.float32)
    tracemalloc.start()
    with pytest.raises(SettingsError, match=r"set voxel_m to ([\d.]+) m") as refused:
        grid_from_image(free, camera(), 0.0, 0.4, FieldSettings(0.0005), TASK)
    with pytest.raises(SettingsError, match="voxels"):
        grid_from_shapes([Sphere((0, 0, 0), 0.1)], 0.01, (-5, -5, 0), (5, 5, 3), 0.001)
    small = OccupancyGrid(np.zeros((2, 2, 2), np.float32), np.zeros(3), 0.01)
    with pytest.raises(SettingsError, match="voxels"):
        fuse_grids([small, dataclasses.replace(small, origin_m=np.array([900.0, 900.0, 0.0]))])
    assert tracemalloc.get_traced_memory()[1] < 5e6
    tracemalloc.stop()
    enough_m = float(re.search(r"set voxel_m to ([\d.]+) m", str(refused.value)).group(1))
    shape = np.ceil(np.array([0.44, 0.34, 0.42]) / enough_m)
    assert shape.prod() <= MAX_VOXELS


def test_image_of_another_size_is_refused() -> None:
    with pytest.raises(SettingsError, match="camera's size"):
        grid_from_image(np.zeros((10, 10), np.float32), camera(), 0.0, 0.05)


def test_decay_is_linear_and_shapes_combine_by_noisy_or() -> None:
    sphere, cuboid = Sphere((0, 0, 0), 0.1), Cuboid((0.5, 0, 0), (0.1, 0.2, 0.1), np.pi / 2)
    points = np.array([[0.0, 0, 0], [0.15, 0, 0], [0.2, 0, 0], [0.25, 0, 0], [0.5, 0.05, 0.15]])
    near = p_occupied_near([sphere, cuboid], 0.1, points)
    np.testing.assert_allclose(near, [1, 0.5, 0, 1 - 0.5, 0.5], atol=1e-12)
    both = p_occupied_near([sphere, Sphere((0.3, 0, 0), 0.1)], 0.1, np.array([[0.15, 0, 0]]))
    np.testing.assert_allclose(both, 1 - 0.5 * 0.5)


def test_grid_of_shapes_is_an_upper_bound() -> None:
    shapes = [Sphere((0.05, 0.05, 0.05), 0.02), Cuboid((0.1, 0.1, 0.02), (0.02, 0.01, 0.02), 0.4)]
    grid = grid_from_shapes(shapes, 0.01, (0, 0, 0), (0.15, 0.15, 0.1), 0.004)
    points = np.random.default_rng(0).uniform(0, (0.15, 0.15, 0.1), (20000, 3))
    assert (grid.at(points) >= p_occupied_near(shapes, 0.01, points) - 1e-6).all()
