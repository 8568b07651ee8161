"""Distance to the unsafe set {p_occupied > delta}: deterministic lower bounds of clearances (decision 23)."""

import dataclasses
import functools
import math
from collections.abc import Hashable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from deltasafe.compute.numba_cache import compiled, inlined, kernel
from deltasafe.errors import SettingsError
from deltasafe.geometry import as_rows
from deltasafe.planning.collision.distance_transform import (
    MAX_REACH,
    squared_distance_in_slabs,
    squared_distance_to_voxels,
)
from deltasafe.scene import OccupancyGrid

REACH_M = 0.06
"""Distances of voxels are exact up to here and capped beyond; the coarse grid has bounds that reach farther."""

COARSE_M = 0.01
"""Edge of a cell of the coarse grid of minimum clearances."""

COARSE_REACH_M = 0.12
SLAB_REACH_M = 0.04
MIN_SLAB_RISE = 0.8
"""In voxels: a body may rise or sink by at least this much inside a slab of slices."""

FINE_UNIT_M = 0.00025
"""Unit of the uint8 distances of voxels: 255 units reach a little farther than ``REACH_M``."""

ROUNDING = 1 - 1e-6


class Lattice(NamedTuple):
    """Position and size of the voxels of a distance field."""

    lower_x_m: float
    lower_y_m: float
    lower_z_m: float
    voxel_m: float
    per_m: float
    nx: int
    ny: int
    nz: int
    stride: int


class FieldArrays(NamedTuple):
    """A distance field as compiled code reads it.

    Attributes:
        squared_distance: (nx, ny, nz) from the center of a voxel to the unsafe set, squared, in half voxels.
        squared_ray_distance: (nx, ny, nz) smallest ``squared_distance`` of the voxel and all voxels above it.
        lattice: position and size of the voxels.
        table_z_m: height of the table.
    """

    squared_distance: NDArray[np.uint16]
    squared_ray_distance: NDArray[np.uint16]
    lattice: Lattice
    table_z_m: float


@dataclasses.dataclass(frozen=True)
class DistanceField:
    """Distances to the unsafe set of a grid at a level delta. Made by ``build``.

    The unsafe set consists of the voxels with p_occupied > delta, of everything beside the grid below its upper face,
    and of the half-space below its lower face (the table).
    """

    grid: OccupancyGrid
    delta: float
    arrays: FieldArrays = dataclasses.field(repr=False)

    @classmethod
    def build(cls, grid: OccupancyGrid, delta: float, reach_m: float = REACH_M) -> "DistanceField":
        """Compute exact Euclidean distances to {p_occupied > delta}, up to ``reach_m`` or 90 voxels.

        Raises:
            SettingsError: delta is not in (0, 1).
        """
        if not (math.isfinite(delta) and 0 < delta < 1):
            raise SettingsError(f"delta must be in (0, 1), got {delta}")
        reach = min(math.ceil(reach_m / grid.voxel_m), MAX_REACH)
        nx, ny, nz = grid.p_occupied.shape
        # one layer of unknown voxels on each side, free space above: farther out, distances follow from these
        unsafe = np.ones((nx + 2, ny + 2, nz + reach), np.bool_)
        unsafe[:, :, nz:] = False
        level = np.float32(delta)  # the largest float32 that is at most delta: the comparison stays exact
        level = level if float(level) <= delta else np.nextafter(level, np.float32(0))
        np.greater(grid.p_occupied, level, out=unsafe[1:-1, 1:-1, :nz])
        squared = squared_distance_to_voxels(unsafe, reach)
        lattice = Lattice(
            float(grid.origin_m[0] - grid.voxel_m),
            float(grid.origin_m[1] - grid.voxel_m),
            float(grid.origin_m[2]),
            grid.voxel_m,
            1.0 / grid.voxel_m,
            nx + 2,
            ny + 2,
            nz + reach,
            max(1, round(COARSE_M / grid.voxel_m)),
        )
        return cls(grid, float(delta), FieldArrays(squared, _minimum_above(squared), lattice, float(grid.origin_m[2])))

    def at_delta(self, delta: float) -> "DistanceField":
        """Return the field of the same grid at another level; computes the distances anew."""
        return self if delta == self.delta else DistanceField.build(self.grid, delta)

    @property
    def top_z_m(self) -> float:
        """Height of the grid's upper face; above it, space is free."""
        return float(self.grid.upper_m[2])

    @functools.cached_property
    def cache(self) -> dict[Hashable, Any]:
        """Arrays and tables derived from this field, by key; freed together with the field."""
        return {}

    @functools.cached_property
    def unsafe_bits(self) -> NDArray[np.int32]:
        """Unsafe voxels as bits (nx, ny, ceil(nz / 32)): a word holds 32 voxels along z, the lowest in bit 0."""
        bits = np.packbits(self.arrays.squared_distance == 0, axis=2, bitorder="little")
        words = np.zeros((*bits.shape[:2], -(-bits.shape[2] // 4)), "<i4")
        words.view(np.uint8)[:, :, : bits.shape[2]] = bits
        return words

    @functools.cached_property
    def ray_clearance(self) -> NDArray[np.uint8]:
        """Lower bounds (nx, ny, nz) of the distance from upward rays, started anywhere in a voxel, to unsafe voxels.

        v > 0 means at least v - 1 units of ``FINE_UNIT_M``; 0 means no bound.
        """
        voxel_m = self.arrays.lattice.voxel_m
        squared = np.arange(int(self.arrays.squared_ray_distance.max()) + 1)
        bound_m = np.sqrt(squared) * (voxel_m / 2 * ROUNDING) - voxel_m * math.sqrt(3) / 2 * (2 - ROUNDING)
        units = np.where(bound_m >= 0, np.minimum(np.floor(bound_m / FINE_UNIT_M), 254) + 1, 0).astype(np.uint8)
        return np.asarray(_look_up(units, self.arrays.squared_ray_distance))

    def slab_distance(self, half_height_m: float) -> tuple[NDArray[np.uint8], float]:
        """Horizontal distances (nx, ny, nz) to unsafe voxels in a slab of slices, in units of ``FINE_UNIT_M``.

        Args:
            half_height_m: how far the body reaches above and below its center.

        Returns:
            The distances, and the height by which the body may rise or sink without leaving the slab.
        """
        lattice = self.arrays.lattice
        # an even number, so that similar margins share their slabs
        half = 2 * math.ceil((half_height_m / lattice.voxel_m + MIN_SLAB_RISE) / 2)
        return self._slab(half), half * lattice.voxel_m - half_height_m

    @property
    def slice_distance(self) -> NDArray[np.uint8]:
        """Horizontal distances (nx, ny, nz) to unsafe voxels of the same slice, in units of ``FINE_UNIT_M``."""
        return self._slab(0)

    def _slab(self, half: int) -> NDArray[np.uint8]:
        key = ("slab", half)
        if key not in self.cache:
            voxel_m = self.arrays.lattice.voxel_m
            reach = min(math.ceil(SLAB_REACH_M / voxel_m), MAX_REACH)
            squared = squared_distance_in_slabs(self.arrays.squared_distance == 0, half, reach)
            units = np.floor(np.sqrt(np.arange(int(squared.max()) + 1)) * (voxel_m / 2 * ROUNDING / FINE_UNIT_M))
            self.cache[key] = _look_up(np.minimum(units, 255).astype(np.uint8), squared)
        distance: NDArray[np.uint8] = self.cache[key]
        return distance

    def coarse_clearance_m(self, reach_m: float = COARSE_REACH_M) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Lower bounds of the distance to unsafe voxels from any point of a cell, and from any upward ray.

        A cell is a block of ``stride`` voxels along each axis. Beyond ``REACH_M`` the bounds come from a distance
        transform of the cells, which reaches up to ``reach_m``.
        """
        key = ("coarse", reach_m)
        if key not in self.cache:
            self.cache[key] = self._coarse_clearance_m(reach_m)
        bounds: tuple[NDArray[np.float32], NDArray[np.float32]] = self.cache[key]
        return bounds

    def _coarse_clearance_m(self, reach_m: float) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        lattice = self.arrays.lattice
        cell_m = lattice.stride * lattice.voxel_m
        bounds = []
        for squared in (self.arrays.squared_distance, self.arrays.squared_ray_distance):
            least = _block_minimum(squared, lattice.stride)
            near_m = np.sqrt(least, dtype=np.float32) * (lattice.voxel_m / 2 * ROUNDING)
            near_m -= lattice.voxel_m * math.sqrt(3) / 2 * (2 - ROUNDING)
            far = squared_distance_to_voxels(least == 0, min(math.ceil(reach_m / cell_m), MAX_REACH))
            far_m = np.sqrt(far, dtype=np.float32) * (cell_m / 2 * ROUNDING) - cell_m * math.sqrt(3) / 2
            bounds.append(np.maximum(near_m, far_m))
        return bounds[0], bounds[1]

    def clearance_m(self, points_m: NDArray[np.float64]) -> NDArray[np.float64]:
        """Lower bound (N,) of the distance of points (N, 3) to the unsafe set, table included; <= 0 if unsafe.

        It is at most one voxel diagonal below the true distance, and capped at ``REACH_M``.

        Raises:
            SettingsError: a point is not finite, or farther than 1000 m from 0.
        """
        return np.asarray(_clearances(self.arrays, as_rows(points_m, 3, "points_m")))


@inlined
def voxel_of(lattice, x, y, z):  # type: ignore[no-untyped-def]
    """Return the voxel (i, j, k) that contains a point, or the nearest one if the point is outside."""
    i = int(min(max((x - lattice.lower_x_m) * lattice.per_m, 0.0), lattice.nx - 1.0))
    j = int(min(max((y - lattice.lower_y_m) * lattice.per_m, 0.0), lattice.ny - 1.0))
    k = int(min(max((z - lattice.lower_z_m) * lattice.per_m, 0.0), lattice.nz - 1.0))
    return i, j, k


@kernel
def voxel_clearance_at(squared, lattice, x, y, z):  # type: ignore[no-untyped-def]
    """Lower bound of the distance from a point (or an upward ray) to unsafe voxels, by one look-up; without the table.

    Distances are 1-Lipschitz: the bound is the distance at the voxel's center minus the distance to that center. A
    point outside the stored box is not nearer to the unsafe set than the nearest point of the box.
    """
    u = min(max((x - lattice.lower_x_m) * lattice.per_m, 0.0), float(lattice.nx))
    v = min(max((y - lattice.lower_y_m) * lattice.per_m, 0.0), float(lattice.ny))
    w = min(max((z - lattice.lower_z_m) * lattice.per_m, 0.0), float(lattice.nz))
    i, j, k = min(int(u), lattice.nx - 1), min(int(v), lattice.ny - 1), min(int(w), lattice.nz - 1)
    u, v, w = u - i - 0.5, v - j - 0.5, w - k - 0.5
    return lattice.voxel_m * (0.5 * ROUNDING * math.sqrt(squared[i, j, k]) - math.sqrt(u * u + v * v + w * w))


@kernel
def tight_clearance_at(squared, lattice, x, y, z):  # type: ignore[no-untyped-def]
    """As ``voxel_clearance_at``, but the best bound of the eight voxels around the point."""
    u = min(max((x - lattice.lower_x_m) * lattice.per_m, 0.0), float(lattice.nx)) - 0.5
    v = min(max((y - lattice.lower_y_m) * lattice.per_m, 0.0), float(lattice.ny)) - 0.5
    w = min(max((z - lattice.lower_z_m) * lattice.per_m, 0.0), float(lattice.nz)) - 0.5
    i = min(max(math.floor(u), 0), max(lattice.nx - 2, 0))
    j = min(max(math.floor(v), 0), max(lattice.ny - 2, 0))
    k = min(max(math.floor(w), 0), max(lattice.nz - 2, 0))
    best = -np.inf
    for di in range(min(2, lattice.nx)):
        for dj in range(min(2, lattice.ny)):
            for dk in range(min(2, lattice.nz)):
                du, dv, dw = u - i - di, v - j - dj, w - k - dk
                to_center = math.sqrt(du * du + dv * dv + dw * dw)
                best = max(best, 0.5 * ROUNDING * math.sqrt(squared[i + di, j + dj, k + dk]) - to_center)
    return lattice.voxel_m * best


@compiled
def _clearances(field, points_m):  # type: ignore[no-untyped-def]
    clearance_m = np.empty(len(points_m))
    for n in range(len(points_m)):
        x, y, z = points_m[n, 0], points_m[n, 1], points_m[n, 2]
        clearance_m[n] = min(tight_clearance_at(field.squared_distance, field.lattice, x, y, z), z - field.table_z_m)
    return clearance_m


@compiled
def _look_up(table, indices):  # type: ignore[no-untyped-def]
    """``table[indices]`` for three-dimensional indices; several times faster than NumPy."""
    values = np.empty(indices.shape, table.dtype)
    nx, ny, nz = indices.shape
    for i in range(nx):
        for j in range(ny):
            for k in range(nz):
                values[i, j, k] = table[indices[i, j, k]]
    return values


@compiled
def _minimum_above(squared):  # type: ignore[no-untyped-def]
    """Minimum of each voxel and all voxels above it."""
    minimum = np.empty_like(squared)
    nx, ny, nz = squared.shape
    for i in range(nx):
        for j in range(ny):
            least = squared[i, j, nz - 1]
            for k in range(nz - 1, -1, -1):
                least = min(least, squared[i, j, k])
                minimum[i, j, k] = least
    return minimum


@compiled
def _block_minimum(squared, stride):  # type: ignore[no-untyped-def]
    """Minimum of each block of ``stride`` voxels along each axis."""
    nx, ny, nz = squared.shape
    minimum = np.full(((nx - 1) // stride + 1, (ny - 1) // stride + 1, (nz - 1) // stride + 1), 65535, np.uint16)
    for i in range(nx):
        for j in range(ny):
            least = minimum[i // stride, j // stride]
            for block in range(len(least)):
                for k in range(block * stride, min((block + 1) * stride, nz)):
                    least[block] = min(least[block], squared[i, j, k])
    return minimum
