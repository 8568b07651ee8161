"""Fusion of the grids of several cameras: a point is free if any camera sees it free."""

from collections.abc import Sequence

import numpy as np

from deltasafe.errors import SettingsError
from deltasafe.scene.occupancy import OccupancyGrid, require_size


def fuse_grids(grids: Sequence[OccupancyGrid]) -> OccupancyGrid:
    """Fuse grids of the same scene: the smallest p_occupied at each point.

    If a point is occupied, each camera that sees it sees the hand in its pixel. The p_occupied of each camera is
    therefore an upper bound; where a camera sees nothing, its grid holds 1. A product would require independent errors
    of the cameras, but predictions of the same ensemble have dependent errors.

    The result covers the area of all grids, up to the lowest upper face: above that face, one of the grids is free.

    Raises:
        SettingsError: no grid, grids whose voxels do not coincide or whose tables differ in height, or so far apart
            that the result would have too many voxels.
    """
    if not grids:
        raise SettingsError("there is no grid to fuse")
    first = grids[0]
    offsets = []
    for grid in grids:
        offset = (grid.origin_m - first.origin_m) / first.voxel_m
        steps = np.rint(offset).astype(int)
        if abs(grid.voxel_m - first.voxel_m) > 1e-12 or np.abs(offset - steps).max() > 1e-6 or steps[2] != 0:
            raise SettingsError(
                f"grids must share voxels and table: {grid.voxel_m} m from {grid.origin_m.tolist()} "
                f"against {first.voxel_m} m from {first.origin_m.tolist()}"
            )
        offsets.append(steps)
    lower = np.min(offsets, axis=0)
    upper = np.max([steps + grid.p_occupied.shape for steps, grid in zip(offsets, grids, strict=True)], axis=0)
    layers = min(grid.p_occupied.shape[2] for grid in grids)
    require_size((*(upper - lower)[:2], layers), first.voxel_m)
    fused = np.ones((*(upper - lower)[:2], layers), np.float32)
    for steps, grid in zip(offsets, grids, strict=True):
        (i, j), (nx, ny) = (steps - lower)[:2], grid.p_occupied.shape[:2]
        part = fused[i : i + nx, j : j + ny]
        np.minimum(part, grid.p_occupied[:, :, :layers], out=part)
    return OccupancyGrid(fused, first.origin_m + lower * first.voxel_m, first.voxel_m)
