"""A proof, at the resolution of voxels, that start and goal cannot be connected."""

import math

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from deltasafe.planning.body import ToolBody
from deltasafe.planning.collision.distance_field import DistanceField

Array = NDArray[np.float64]


def is_connected(
    field: DistanceField,
    body: ToolBody,
    margin_m: float,
    lower: Array,
    upper: Array,
    start: Array,
    goal: Array,
) -> bool:
    """Return whether a chain of voxels connects start and goal that a ball inside the disc, and the shaft, can pass.

    A necessary condition, optimistic by half a voxel diagonal: False proves that no path exists within the bounds.
    """
    arrays = field.arrays
    voxel_m = arrays.lattice.voxel_m
    slack_m = voxel_m * math.sqrt(3) / 2 * (1 + 1e-6)
    inscribed_m = min(body.semi_axis_x_m, body.semi_axis_y_m, body.thickness_m / 2)
    passable = _is_clear(arrays.squared_distance, inscribed_m + margin_m - slack_m, voxel_m)
    if body.shaft_length_m > 0:
        passable &= _is_clear(arrays.squared_ray_distance, body.shaft_radius_m + margin_m - slack_m, voxel_m)
    shape = np.array(passable.shape)
    origin_m = np.array(arrays.lattice[:3])
    first, last = ((value[:3] - origin_m) // voxel_m for value in (lower, upper))
    if last[2] >= shape[2]:
        return True  # the bounds extend above the stored box, where space is free
    passable[:, :, : max(int(first[2]), 0)] = False
    passable[:, :, int(last[2]) + 1 :] = False
    labels, _ = ndimage.label(passable, structure=np.ones((3, 3, 3)))
    cells = [tuple(np.clip((pose[:3] - origin_m) // voxel_m, 0, shape - 1).astype(int)) for pose in (start, goal)]
    return bool(labels[cells[0]] != 0 and labels[cells[0]] == labels[cells[1]])


def _is_clear(squared: NDArray[np.uint16], least_m: float, voxel_m: float) -> NDArray[np.bool_]:
    return np.asarray(squared >= (2 * max(least_m, 0.0) / voxel_m) ** 2)
