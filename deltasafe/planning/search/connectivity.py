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
    """Return whether a chain of voxels connects start and goal that the shaft, and balls inside the body, can pass.

    The balls are centered on the yaw axis: in the disc, or in each part there.

    A necessary condition, optimistic by half a voxel diagonal: False proves that no path exists within the bounds.
    """
    arrays = field.arrays
    voxel_m = arrays.lattice.voxel_m
    slack_m = voxel_m * math.sqrt(3) / 2 * (1 + 1e-6)
    balls = [(part.z_m, part.inscribed_m) for part in body.solids if part.x_m == part.y_m == 0]
    passable: NDArray[np.bool_] = np.ones(arrays.squared_distance.shape, np.bool_)
    for height_m, inscribed_m in balls if body.parts else balls[:1]:
        shift = round(height_m / voxel_m)
        least_m = inscribed_m + margin_m - slack_m - abs(height_m - shift * voxel_m)
        passable &= _raised(_is_clear(arrays.squared_distance, least_m, voxel_m), shift)
    # treated as infinitely long, which is no loss if it always ends above the field
    if body.shaft_length_m > 0 and lower[2] + body.shaft_length_m >= field.top_z_m:
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


def _raised(clear: NDArray[np.bool_], shift: int) -> NDArray[np.bool_]:
    """Value of the voxel ``shift`` above each voxel; True beyond the field."""
    raised = np.ones_like(clear)
    size = clear.shape[2]
    if abs(shift) < size:
        raised[:, :, max(-shift, 0) : size - max(shift, 0)] = clear[:, :, max(shift, 0) : size + min(shift, 0)]
    return raised


def _is_clear(squared: NDArray[np.uint16], least_m: float, voxel_m: float) -> NDArray[np.bool_]:
    return np.asarray(squared >= (2 * max(least_m, 0.0) / voxel_m) ** 2)
