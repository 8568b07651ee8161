"""Whether start and goal can be connected at all: a proof that they cannot, at the resolution of voxels."""

import math

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from deltasafe.planning.body import ToolBody
from deltasafe.planning.collision.distance_field import DistanceField

__all__ = ["is_connected"]

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
    """A necessary condition: a chain of voxels where a ball inside the disc and the shaft could pass.

    Optimiztic by half a voxel diagonal, so that False proves that no path exists within the bounds.
    """
    arrays = field.arrays
    voxel_m = arrays.lattice.voxel_m
    slack_m = voxel_m * math.sqrt(3) / 2 * (1 + 1e-6)
    inscribed_m = min(body.semi_axis_x_m, body.semi_axis_y_m, body.thickness_m / 2)
    passable = _clears(arrays.ball, inscribed_m + margin_m - slack_m, voxel_m)
    if body.shaft_length_m > 0:
        passable &= _clears(arrays.ray, body.shaft_radius_m + margin_m - slack_m, voxel_m)
    shape = np.array(passable.shape)
    origin_m = np.array(arrays.lattice[:3])
    first, last = ((value[:3] - origin_m) // voxel_m for value in (lower, upper))
    if last[2] >= shape[2]:
        return True  # the bounds leave the stored box, where all is free
    passable[:, :, : max(int(first[2]), 0)] = False
    passable[:, :, int(last[2]) + 1 :] = False
    labels, _ = ndimage.label(passable, structure=np.ones((3, 3, 3)))
    cells = [tuple(np.clip((pose[:3] - origin_m) // voxel_m, 0, shape - 1).astype(int)) for pose in (start, goal)]
    return bool(labels[cells[0]] != 0 and labels[cells[0]] == labels[cells[1]])


def _clears(squared: NDArray[np.uint16], least_m: float, voxel_m: float) -> NDArray[np.bool_]:
    return np.asarray(squared >= (2 * max(least_m, 0.0) / voxel_m) ** 2)
