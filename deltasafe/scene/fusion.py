"""Several cameras, one field: what any of them sees to be free is free."""

from collections.abc import Sequence

import numpy as np

from deltasafe.errors import SettingsError
from deltasafe.scene.occupancy import OccupancyGrid

__all__ = ["fuse_grids"]


def fuse_grids(grids: Sequence[OccupancyGrid]) -> OccupancyGrid:
    """The field of several cameras: at each point the smallest of their probabilities.

    A point can only be occupied if every camera that looks at it sees a hand in its pixel, so that each camera's
    p_occupied bounds it from above; where a camera sees nothing its field says 1, which bounds nothing. A product
    would need errors of the cameras to be independent, which those of one ensemble are not.

    The result spans all grids sideways, and upward to the lowest upper face: above it one of them is free already.

    Raises:
        SettingsError: no grid, or grids whose voxels do not coincide or that stand on different tables.
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
    fused = np.ones((*(upper - lower)[:2], layers), np.float32)
    for steps, grid in zip(offsets, grids, strict=True):
        (i, j), (nx, ny) = (steps - lower)[:2], grid.p_occupied.shape[:2]
        part = fused[i : i + nx, j : j + ny]
        np.minimum(part, grid.p_occupied[:, :, :layers], out=part)
    return OccupancyGrid(fused, first.origin_m + lower * first.voxel_m, first.voxel_m)
