"""Analytic obstacles with P(occupied) that decreases linearly with the distance to their surface (section V-B)."""

import dataclasses
import math
from collections.abc import Sequence
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from deltasafe.errors import SettingsError
from deltasafe.geometry import as_rows
from deltasafe.scene.occupancy import MIN_VOXEL_M, OccupancyGrid, require_size
from deltasafe.setting_ranges import check_range

Array = NDArray[np.float64]
Triple = tuple[float, float, float]


@dataclasses.dataclass(frozen=True)
class Sphere:
    """A ball of ``radius_m`` around ``center_m``."""

    center_m: Triple
    radius_m: float

    def __post_init__(self) -> None:
        as_rows([self.center_m], 3, "center_m")
        check_range(self, "(0, inf)", "radius_m")

    @property
    def reach_m(self) -> float:
        """Radius of the smallest ball around the center that contains the shape."""
        return self.radius_m

    def distance_m(self, points_m: Array) -> Array:
        """Distance (N,) of points (N, 3) to the ball, 0 inside."""
        return np.maximum(np.linalg.norm(np.asarray(points_m) - self.center_m, axis=1) - self.radius_m, 0.0)


@dataclasses.dataclass(frozen=True)
class Cuboid:
    """A box with half edges ``half_extents_m`` around ``center_m``, rotated by ``yaw_rad`` about the vertical."""

    center_m: Triple
    half_extents_m: Triple
    yaw_rad: float = 0.0

    def __post_init__(self) -> None:
        as_rows([self.center_m], 3, "center_m")
        if not all(math.isfinite(value) and value > 0 for value in self.half_extents_m):
            raise SettingsError(f"half_extents_m must be positive, got {self.half_extents_m}")
        if not math.isfinite(self.yaw_rad):
            raise SettingsError(f"yaw_rad must be finite, got {self.yaw_rad}")

    @property
    def reach_m(self) -> float:
        """Radius of the smallest ball around the center that contains the shape."""
        return math.hypot(*self.half_extents_m)

    def distance_m(self, points_m: Array) -> Array:
        """Distance (N,) of points (N, 3) to the box, 0 inside."""
        cos, sin = math.cos(self.yaw_rad), math.sin(self.yaw_rad)
        local = (np.asarray(points_m) - self.center_m) @ np.array([[cos, -sin, 0], [sin, cos, 0], [0, 0, 1]])
        return np.asarray(np.linalg.norm(np.maximum(np.abs(local) - self.half_extents_m, 0.0), axis=1))


Shape: TypeAlias = Sphere | Cuboid


def p_occupied_near(shapes: Sequence[Shape], decay_m: float, points_m: Array, slack_m: float = 0.0) -> Array:
    """P(occupied) (N,) at points (N, 3): 1 inside a shape, decreasing linearly to 0 at the distance ``decay_m``.

    Shapes are combined by noisy-OR, 1 - prod(1 - p_i) (decision 14), so that the inside of each is occupied. Distances
    are reduced by ``slack_m``: the result bounds P(occupied) of all points within that distance.
    """
    _check_decay(decay_m)
    points_m = as_rows(points_m, 3, "points_m")
    if not (math.isfinite(slack_m) and slack_m >= 0):
        raise SettingsError(f"slack_m must not be negative, got {slack_m}")
    p_free = np.ones(len(points_m))
    for shape in shapes:
        p_free *= _p_free(shape, decay_m, points_m, slack_m)
    return 1.0 - p_free


def _check_decay(decay_m: float) -> None:
    if not (math.isfinite(decay_m) and decay_m >= 0):
        raise SettingsError(f"decay_m must not be negative, got {decay_m}")


def _p_free(shape: Shape, decay_m: float, points_m: Array, slack_m: float) -> Array:
    distance_m = np.maximum(shape.distance_m(points_m) - slack_m, 0.0)
    return np.clip(distance_m / decay_m, 0.0, 1.0) if decay_m > 0 else (distance_m > 0).astype(np.float64)


def grid_from_shapes(
    shapes: Sequence[Shape], decay_m: float, lower_m: Triple, upper_m: Triple, voxel_m: float = 0.005
) -> OccupancyGrid:
    """Rasterize shapes between two corners; each voxel holds an upper bound of P(occupied) over its points.

    Raises:
        SettingsError: the corners do not span a box, ``decay_m`` or ``voxel_m`` is outside its domain, or there would
            be too many voxels.
    """
    lower, upper = as_rows((lower_m, upper_m), 3, "the corners of the grid")
    if not (upper > lower).all() or not MIN_VOXEL_M <= voxel_m < math.inf:
        raise SettingsError(
            f"a grid needs upper > lower and voxel_m >= {MIN_VOXEL_M:g}, got {lower_m}, {upper_m}, {voxel_m}"
        )
    _check_decay(decay_m)
    counts = np.ceil((upper - lower) / voxel_m - 1e-9).astype(int)
    require_size(counts, voxel_m)
    slack_m = voxel_m * math.sqrt(3) / 2
    p_free = np.ones(counts)
    for shape in shapes:  # a shape affects only the voxels within its reach
        reach_m = shape.reach_m + decay_m + slack_m
        first = np.clip(np.floor((np.asarray(shape.center_m) - reach_m - lower) / voxel_m), 0, counts).astype(int)
        last = np.clip(np.ceil((np.asarray(shape.center_m) + reach_m - lower) / voxel_m), first, counts).astype(int)
        axes = [lower[i] + voxel_m * (np.arange(first[i], last[i]) + 0.5) for i in range(3)]
        centers = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
        near = _p_free(shape, decay_m, centers.reshape(-1, 3), slack_m)
        p_free[tuple(slice(*ends) for ends in zip(first, last, strict=True))] *= near.reshape(centers.shape[:3])
    return OccupancyGrid((1.0 - p_free).astype(np.float32), lower, voxel_m)
