"""Line costs of a segment: the paper's squared cost, its additive root, and the area between path and table."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from deltasafe.compute.numba_cache import inlined, kernel
from deltasafe.errors import SettingsError

COSTS = ("root", "squared", "area")
ROOT, SQUARED, _ = range(3)
MAX_WEIGHT = 1e6

Array = NDArray[np.float64]


class LineCost(NamedTuple):
    """Cost of a straight segment between poses, as compiled code reads it. Made by ``line_cost``.

    With L = sqrt(|dx|^2 + r dphi^2), decisions 15 and 25:

    - root: L, additive, in meters.
    - squared: L^2, eq. (12) of the paper; dividing a segment lowers it.
    - area: the integral of (z - z_table) ds plus w L. The term w L contains the rotation, and gives motion near the
      table a price: with w = 0, any detour along the table would be almost free.
    """

    kind: int
    rotation_weight_m2: float
    table_z_m: float
    length_weight_m: float


def line_cost(
    kind: str, rotation_weight_m2: float = 0.01, table_z_m: float = 0.0, length_weight_m: float = 0.02
) -> LineCost:
    """Make a line cost: ``root``, ``squared`` or ``area``.

    Raises:
        SettingsError: an unknown kind, a weight that is not positive and at most 1e6, or a table that is not finite.
    """
    if kind not in COSTS:
        raise SettingsError(f"cost must be one of {COSTS}, got {kind!r}")
    # neighbors are compared by squared distances in single precision, which larger weights would overflow
    if not (0 < rotation_weight_m2 <= MAX_WEIGHT and 0 < length_weight_m <= MAX_WEIGHT):
        raise SettingsError(
            f"weights must be positive and at most {MAX_WEIGHT:g}, got {rotation_weight_m2} and {length_weight_m}"
        )
    if not math.isfinite(table_z_m):
        raise SettingsError(f"table_z_m must be finite, got {table_z_m}")
    return LineCost(COSTS.index(kind), float(rotation_weight_m2), float(table_z_m), float(length_weight_m))


def path_cost(cost: LineCost, poses: Array) -> float:
    """Sum of the line costs of a polyline (K, 4).

    Raises:
        SettingsError: another shape.
    """
    poses = np.ascontiguousarray(poses, dtype=np.float64)
    if poses.ndim != 2 or poses.shape[1] != 4:
        raise SettingsError(f"poses must have shape (K, 4), got {poses.shape}")
    return float(_path_cost(cost, poses))


def area_m2(poses: Array, table_z_m: float) -> float:
    """Integral of (z - z_table) ds along a polyline (K, 4), in square meters."""
    height_m = (poses[1:, 2] + poses[:-1, 2]) / 2 - table_z_m
    return float((height_m * np.linalg.norm(np.diff(poses[:, :3], axis=0), axis=1)).sum())


@inlined
def _squared_translation(a, b):  # type: ignore[no-untyped-def]
    dx, dy, dz = a[0] - b[0], a[1] - b[1], a[2] - b[2]
    return dx * dx + dy * dy + dz * dz


@inlined
def squared_pose_distance(rotation_weight_m2, a, b):  # type: ignore[no-untyped-def]
    """|dx|^2 + r dphi^2 of two poses with continuous yaw."""
    dyaw = a[3] - b[3]
    return _squared_translation(a, b) + rotation_weight_m2 * dyaw * dyaw


@inlined
def pose_distance(rotation_weight_m2, a, b):  # type: ignore[no-untyped-def]
    """sqrt(|dx|^2 + r dphi^2) of two poses with continuous yaw."""
    return math.sqrt(squared_pose_distance(rotation_weight_m2, a, b))


@inlined
def segment_cost(cost, a, b):  # type: ignore[no-untyped-def]
    """Cost of the segment between two poses (4,)."""
    squared = squared_pose_distance(cost.rotation_weight_m2, a, b)
    if cost.kind == ROOT:
        return math.sqrt(squared)
    if cost.kind == SQUARED:
        return squared
    height = max(0.5 * (a[2] + b[2]) - cost.table_z_m, 0.0)
    return height * math.sqrt(_squared_translation(a, b)) + cost.length_weight_m * math.sqrt(squared)


@kernel
def least_cost(cost, lowest_z, a, b):  # type: ignore[no-untyped-def]
    """Lower bound of the cost of any path between two poses that stays above ``lowest_z``."""
    if cost.kind == SQUARED:
        return 0.0
    length = pose_distance(cost.rotation_weight_m2, a, b)
    if cost.kind == ROOT:
        return length
    height = max(lowest_z - cost.table_z_m, 0.0)
    return height * math.sqrt(_squared_translation(a, b)) + cost.length_weight_m * length


@kernel
def _path_cost(cost, poses):  # type: ignore[no-untyped-def]
    total = 0.0
    for n in range(len(poses) - 1):
        total += segment_cost(cost, poses[n], poses[n + 1])
    return total
