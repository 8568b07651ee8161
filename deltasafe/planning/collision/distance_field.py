"""Distance to the unsafe set {p_occupied > delta}: conservative clearances, without noise (decision 23)."""

import dataclasses
import functools
import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from deltasafe.compute.numba_cache import compiled, inlined, kernel
from deltasafe.errors import SettingsError
from deltasafe.geometry import as_rows
from deltasafe.planning.collision.distance_transform import (
    MOST_VOXELS,
    squared_distance_in_slabs,
    squared_distance_to_voxels,
)
from deltasafe.scene import OccupancyGrid

__all__ = ["DistanceField", "FieldArrays", "Lattice", "clearance_at", "close_clearance_at", "voxel_of"]

REACH_M = 0.06
"""Clearances are exact up to this distance and capped there; beyond it the coarse grid has a bound."""

COARSE_M = 0.01
"""Edge of a cell of the coarse grid of minimum clearances."""

COARSE_REACH_M = 0.12
SLAB_REACH_M = 0.04
LEAST_RISE = 0.8
"""Of voxels, by which a body may rise or sink within the slices that are looked at together."""
FINE_UNIT_M = 0.00025
"""Resolution of the clearances of voxels: 255 steps reach a little further than they are exact."""

ROUNDING = 1 - 1e-6


class Lattice(NamedTuple):
    """Where the voxels of a safety field lie. Numbers only: compiled code passes them without counting references."""

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
    """A safety field as compiled code reads it.

    ``ball`` (nx, ny, nz) is the squared distance of a voxel's center to the unsafe set, in half voxels squared, and
    ``ray`` the smallest of all voxels straight above. ``floor_z_m`` is the table.
    """

    ball: NDArray[np.uint16]
    ray: NDArray[np.uint16]
    lattice: Lattice
    floor_z_m: float


@dataclasses.dataclass(frozen=True)
class DistanceField:
    """The unsafe set of a grid at a level delta, and how far it is.

    The unsafe set is a union of whole voxels, of everything beside the grid below its upper face, and of the
    half-space below its lower face (the table). The grid serves any level: see ``at``.
    """

    grid: OccupancyGrid
    delta: float
    arrays: FieldArrays = dataclasses.field(repr=False)

    @classmethod
    def build(cls, grid: OccupancyGrid, delta: float) -> "DistanceField":
        """Exact Euclidean distances to {p_occupied > delta}, up to ``REACH_M`` (or 90 voxels, if that is less).

        Raises:
            SettingsError: delta is not in (0, 1).
        """
        if not (math.isfinite(delta) and 0 < delta < 1):
            raise SettingsError(f"delta must be in (0, 1), got {delta}")
        reach = min(math.ceil(REACH_M / grid.voxel_m), MOST_VOXELS)
        nx, ny, nz = grid.p_occupied.shape
        # one voxel of the unknown on each side, free space above: further out nothing changes
        unsafe = np.ones((nx + 2, ny + 2, nz + reach), np.bool_)
        unsafe[:, :, nz:] = False
        level = np.float32(delta)  # the largest single-precision number up to delta: the comparison stays exact
        level = level if float(level) <= delta else np.nextafter(level, np.float32(0))
        np.greater(grid.p_occupied, level, out=unsafe[1:-1, 1:-1, :nz])
        ball = squared_distance_to_voxels(unsafe, reach)
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
        return cls(grid, float(delta), FieldArrays(ball, _lowest_above(ball), lattice, float(grid.origin_m[2])))

    def at(self, delta: float) -> "DistanceField":
        """The field of the same grid at another level; only distances are computed anew."""
        return self if delta == self.delta else DistanceField.build(self.grid, delta)

    @property
    def top_z_m(self) -> float:
        """Height of the field's upper face; above it all is free."""
        return float(self.grid.upper_m[2])

    @functools.cached_property
    def unsafe_bits(self) -> NDArray[np.int32]:
        """The unsafe voxels (nx, ny, ceil(nz / 32)), 32 along z a word, the lowest in its lowest bit."""
        bits = np.packbits(self.arrays.ball == 0, axis=2, bitorder="little")
        words = np.zeros((*bits.shape[:2], -(-bits.shape[2] // 4)), "<i4")
        words.view(np.uint8)[:, :, : bits.shape[2]] = bits
        return words

    @functools.cached_property
    def ray_clearance(self) -> NDArray[np.uint8]:
        """Lower bounds (nx, ny, nz) of the distance to unsafe voxels over the rays above all points of a voxel.

        In steps of ``FINE_UNIT_M``, one more than the bound; 0 where there is none.
        """
        voxel_m = self.arrays.lattice.voxel_m
        squared = np.arange(int(self.arrays.ray.max()) + 1)
        bound_m = np.sqrt(squared) * (voxel_m / 2 * ROUNDING) - voxel_m * math.sqrt(3) / 2 * (2 - ROUNDING)
        steps = np.where(bound_m >= 0, np.minimum(np.floor(bound_m / FINE_UNIT_M), 254) + 1, 0).astype(np.uint8)
        return np.asarray(_looked_up(steps, self.arrays.ray))

    def slabs(self, half_height_m: float) -> tuple[NDArray[np.uint8], float]:
        """Horizontal distances (nx, ny, nz), in steps of ``FINE_UNIT_M``, to what is unsafe in the slices around.

        Args:
            half_height_m: how far above and below its middle a body reaches.

        Returns:
            distances, and by how much the body may rise or sink without meeting further slices.
        """
        lattice = self.arrays.lattice
        # even: margins that differ by little share their slabs
        half = 2 * math.ceil((half_height_m / lattice.voxel_m + LEAST_RISE) / 2)
        return self._slab(half), half * lattice.voxel_m - half_height_m

    @property
    def slices(self) -> NDArray[np.uint8]:
        """Horizontal distances (nx, ny, nz), in steps of ``FINE_UNIT_M``, to what is unsafe in the slice itself."""
        return self._slab(0)

    def _slab(self, half: int) -> NDArray[np.uint8]:
        if half not in self._slabs:
            lattice = self.arrays.lattice
            unsafe = self.arrays.ball == 0
            squared = squared_distance_in_slabs(
                unsafe, half, min(math.ceil(SLAB_REACH_M / lattice.voxel_m), MOST_VOXELS)
            )
            steps = np.floor(
                np.sqrt(np.arange(int(squared.max()) + 1)) * (lattice.voxel_m / 2 * ROUNDING / FINE_UNIT_M)
            )
            self._slabs[half] = _looked_up(np.minimum(steps, 255).astype(np.uint8), squared)
        return self._slabs[half]

    @functools.cached_property
    def kept(self) -> dict[Any, Any]:
        """What others have made from the field, by what they made it for; it lives as long as the field."""
        return {}

    @functools.cached_property
    def _slabs(self) -> dict[int, NDArray[np.uint8]]:
        return {}

    @functools.cached_property
    def coarse_clearance_m(self) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Lower bounds of the distance to unsafe voxels over all points of a block of ``stride`` voxels an edge.

        Of a point and of the ray above it. Beyond the reach of the voxels' distances a transform of the blocks goes on.
        """
        lattice = self.arrays.lattice
        cell_m = lattice.stride * lattice.voxel_m
        bounds = []
        for squared in (self.arrays.ball, self.arrays.ray):
            least = _block_minimum(squared, lattice.stride)
            near_m = np.sqrt(least, dtype=np.float32) * (lattice.voxel_m / 2 * ROUNDING)
            near_m -= lattice.voxel_m * math.sqrt(3) / 2 * (2 - ROUNDING)
            far = squared_distance_to_voxels(least == 0, min(math.ceil(COARSE_REACH_M / cell_m), MOST_VOXELS))
            far_m = np.sqrt(far, dtype=np.float32) * (cell_m / 2 * ROUNDING) - cell_m * math.sqrt(3) / 2
            bounds.append(np.maximum(near_m, far_m))
        return bounds[0], bounds[1]

    def clearance_m(self, points_m: NDArray[np.float64]) -> NDArray[np.float64]:
        """Lower bound (N,) of the distance of points (N, 3) to the unsafe set, table included; <= 0 if unsafe.

        At most one voxel diagonal below the true distance, and capped at ``REACH_M``.

        Raises:
            SettingsError: a point is not finite, or farther than 1000 m from 0.
        """
        return np.asarray(_clearances(self.arrays, as_rows(points_m, 3, "points_m")))


@inlined
def voxel_of(lattice, x, y, z):  # type: ignore[no-untyped-def]
    """The voxel (i, j, k) that holds a point; the nearest one of the lattice if the point is beside it."""
    i = int(min(max((x - lattice.lower_x_m) * lattice.per_m, 0.0), lattice.nx - 1.0))
    j = int(min(max((y - lattice.lower_y_m) * lattice.per_m, 0.0), lattice.ny - 1.0))
    k = int(min(max((z - lattice.lower_z_m) * lattice.per_m, 0.0), lattice.nz - 1.0))
    return i, j, k


@kernel
def clearance_at(squared, lattice, x, y, z):  # type: ignore[no-untyped-def]
    """Lower bound of the distance of a point (or of the ray above it) to the unsafe voxels; the table is apart.

    The distance of the voxel's center less the way from there: the distance function is 1-Lipschitz. Beyond the
    stored box the nearest stored point is no farther from the unsafe set, so looking there is conservative.
    """
    u = min(max((x - lattice.lower_x_m) * lattice.per_m, 0.0), float(lattice.nx))
    v = min(max((y - lattice.lower_y_m) * lattice.per_m, 0.0), float(lattice.ny))
    w = min(max((z - lattice.lower_z_m) * lattice.per_m, 0.0), float(lattice.nz))
    i, j, k = min(int(u), lattice.nx - 1), min(int(v), lattice.ny - 1), min(int(w), lattice.nz - 1)
    u, v, w = u - i - 0.5, v - j - 0.5, w - k - 0.5
    return lattice.voxel_m * (0.5 * ROUNDING * math.sqrt(squared[i, j, k]) - math.sqrt(u * u + v * v + w * w))


@kernel
def close_clearance_at(squared, lattice, x, y, z):  # type: ignore[no-untyped-def]
    """The best of the bounds of the eight voxels around a point: eight times the work, a fraction of the loss."""
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
                away = math.sqrt(du * du + dv * dv + dw * dw)
                best = max(best, 0.5 * ROUNDING * math.sqrt(squared[i + di, j + dj, k + dk]) - away)
    return lattice.voxel_m * best


@compiled
def _clearances(field, points_m):  # type: ignore[no-untyped-def]
    clearance_m = np.empty(len(points_m))
    for n in range(len(points_m)):
        x, y, z = points_m[n, 0], points_m[n, 1], points_m[n, 2]
        clearance_m[n] = min(close_clearance_at(field.ball, field.lattice, x, y, z), z - field.floor_z_m)
    return clearance_m


@compiled
def _looked_up(table, squared):  # type: ignore[no-untyped-def]
    found = np.empty(squared.shape, np.uint8)
    nx, ny, nz = squared.shape
    for i in range(nx):
        for j in range(ny):
            for k in range(nz):
                found[i, j, k] = table[squared[i, j, k]]
    return found


@compiled
def _lowest_above(squared):  # type: ignore[no-untyped-def]
    lowest = np.empty_like(squared)
    nx, ny, nz = squared.shape
    for i in range(nx):
        for j in range(ny):
            least = squared[i, j, nz - 1]
            for k in range(nz - 1, -1, -1):
                least = min(least, squared[i, j, k])
                lowest[i, j, k] = least
    return lowest


@compiled
def _block_minimum(squared, stride):  # type: ignore[no-untyped-def]
    nx, ny, nz = squared.shape
    minimum = np.full(((nx - 1) // stride + 1, (ny - 1) // stride + 1, (nz - 1) // stride + 1), 65535, np.uint16)
    for i in range(nx):
        for j in range(ny):
            least = minimum[i // stride, j // stride]
            for block in range(len(least)):
                for k in range(block * stride, min((block + 1) * stride, nz)):
                    least[block] = min(least[block], squared[i, j, k])
    return minimum
