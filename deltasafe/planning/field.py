"""Distance to the unsafe set {p_occupied > delta}: conservative clearances, without noise (decision 23)."""

import dataclasses
import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from deltasafe.compiling import compiled
from deltasafe.errors import SettingsError
from deltasafe.scene import OccupancyGrid

__all__ = ["FieldArrays", "Lattice", "SafetyField", "clearance_at", "close_clearance_at", "voxel_of"]

REACH_M = 0.06
"""Clearances are exact up to this distance and capped there; nothing in planning asks for more."""

CERTIFICATE_M = 0.01
"""Edge of a cell of the coarse grid of minimum clearances."""


class Lattice(NamedTuple):
    """Where the voxels of a safety field lie. Numbers only: compiled code passes them without counting references."""

    lower_x_m: float
    lower_y_m: float
    lower_z_m: float
    voxel_m: float
    nx: int
    ny: int
    nz: int
    stride: int


class FieldArrays(NamedTuple):
    """A safety field as compiled code reads it; distances from a voxel's centre, in metres.

    ``ball`` (nx, ny, nz) is the distance to the unsafe set, ``ray`` the smallest distance of any point straight
    above. ``coarse_*`` are lower bounds of the clearance of every point of a block of ``lattice.stride`` voxels
    an edge. ``floor_z_m`` is the table.
    """

    ball: NDArray[np.float32]
    ray: NDArray[np.float32]
    coarse_ball: NDArray[np.float32]
    coarse_ray: NDArray[np.float32]
    lattice: Lattice
    floor_z_m: float


@dataclasses.dataclass(frozen=True)
class SafetyField:
    """The unsafe set of a grid at a level delta, and how far it is.

    The unsafe set is a union of whole voxels, of everything beside the grid below its upper face, and of the
    half-space below its lower face (the table). Build it anew for another delta; the grid stays.
    """

    grid: OccupancyGrid
    delta: float
    arrays: FieldArrays = dataclasses.field(repr=False)

    @classmethod
    def build(cls, grid: OccupancyGrid, delta: float) -> "SafetyField":
        """Exact Euclidean distances to {p_occupied > delta}, up to ``REACH_M``.

        Raises:
            SettingsError: delta is not in (0, 1).
        """
        if not (math.isfinite(delta) and 0 < delta < 1):
            raise SettingsError(f"delta must be in (0, 1), got {delta}")
        reach = math.ceil(REACH_M / grid.voxel_m)
        # one voxel of the unknown on each side, free space above: further out nothing changes
        unsafe = np.pad(grid.p_occupied.astype(np.float64) > delta, ((1, 1), (1, 1), (0, 0)), constant_values=True)
        unsafe = np.pad(unsafe, ((0, 0), (0, 0), (0, reach)))
        squared = squared_distance_to_voxels(unsafe, reach)
        ball = np.sqrt(squared, out=squared) * np.float32(grid.voxel_m * (1 - 1e-6))
        ray = np.ascontiguousarray(np.minimum.accumulate(ball[:, :, ::-1], axis=2)[:, :, ::-1])
        stride = max(1, round(CERTIFICATE_M / grid.voxel_m))
        arrays = FieldArrays(
            ball=ball,
            ray=ray,
            coarse_ball=_block_minimum(ball, stride, grid.voxel_m),
            coarse_ray=_block_minimum(ray, stride, grid.voxel_m),
            lattice=Lattice(
                float(grid.origin_m[0] - grid.voxel_m),
                float(grid.origin_m[1] - grid.voxel_m),
                float(grid.origin_m[2]),
                grid.voxel_m,
                ball.shape[0],
                ball.shape[1],
                ball.shape[2],
                stride,
            ),
            floor_z_m=float(grid.origin_m[2]),
        )
        return cls(grid, float(delta), arrays)

    @property
    def top_z_m(self) -> float:
        """Height of the field's upper face; above it all is free."""
        return float(self.grid.upper_m[2])

    def clearance_m(self, points_m: NDArray[np.float64]) -> NDArray[np.float64]:
        """Lower bound (N,) of the distance of points (N, 3) to the unsafe set, table included; <= 0 if unsafe.

        At most one voxel diagonal below the true distance, and capped at ``REACH_M``.
        """
        points_m = np.ascontiguousarray(points_m, dtype=np.float64)
        return np.asarray(_clearances(self.arrays, points_m))


@compiled
def clearance_at(distances, lattice, x, y, z):  # type: ignore[no-untyped-def]
    """Lower bound of the distance of a point (or of the ray above it) to the unsafe voxels; the table is apart.

    The distance of the voxel's centre less the way from there: the distance function is 1-Lipschitz. Beyond the
    stored box the nearest stored point is no farther from the unsafe set, so looking there is conservative.
    """
    u = min(max((x - lattice.lower_x_m) / lattice.voxel_m, 0.0), float(lattice.nx))
    v = min(max((y - lattice.lower_y_m) / lattice.voxel_m, 0.0), float(lattice.ny))
    w = min(max((z - lattice.lower_z_m) / lattice.voxel_m, 0.0), float(lattice.nz))
    i, j, k = min(int(u), lattice.nx - 1), min(int(v), lattice.ny - 1), min(int(w), lattice.nz - 1)
    u, v, w = u - i - 0.5, v - j - 0.5, w - k - 0.5
    return distances[i, j, k] - lattice.voxel_m * math.sqrt(u * u + v * v + w * w)


@compiled
def close_clearance_at(distances, lattice, x, y, z):  # type: ignore[no-untyped-def]
    """The best of the bounds of the eight voxels around a point: eight times the work, a fraction of the loss."""
    u = min(max((x - lattice.lower_x_m) / lattice.voxel_m, 0.0), float(lattice.nx)) - 0.5
    v = min(max((y - lattice.lower_y_m) / lattice.voxel_m, 0.0), float(lattice.ny)) - 0.5
    w = min(max((z - lattice.lower_z_m) / lattice.voxel_m, 0.0), float(lattice.nz)) - 0.5
    i = min(max(int(np.floor(u)), 0), max(lattice.nx - 2, 0))
    j = min(max(int(np.floor(v)), 0), max(lattice.ny - 2, 0))
    k = min(max(int(np.floor(w)), 0), max(lattice.nz - 2, 0))
    best = -np.inf
    for di in range(min(2, lattice.nx)):
        for dj in range(min(2, lattice.ny)):
            for dk in range(min(2, lattice.nz)):
                du, dv, dw = u - i - di, v - j - dj, w - k - dk
                away = lattice.voxel_m * math.sqrt(du * du + dv * dv + dw * dw)
                best = max(best, distances[i + di, j + dj, k + dk] - away)
    return best


@compiled
def voxel_of(lattice, x, y, z):  # type: ignore[no-untyped-def]
    """Index of the voxel that holds a point, or of the stored voxel nearest to it."""
    i = int(min(max((x - lattice.lower_x_m) / lattice.voxel_m, 0.0), lattice.nx - 1.0))
    j = int(min(max((y - lattice.lower_y_m) / lattice.voxel_m, 0.0), lattice.ny - 1.0))
    k = int(min(max((z - lattice.lower_z_m) / lattice.voxel_m, 0.0), lattice.nz - 1.0))
    return i, j, k


@compiled
def _clearances(field, points_m):  # type: ignore[no-untyped-def]
    clearance_m = np.empty(len(points_m))
    for n in range(len(points_m)):
        x, y, z = points_m[n, 0], points_m[n, 1], points_m[n, 2]
        clearance_m[n] = min(close_clearance_at(field.ball, field.lattice, x, y, z), z - field.floor_z_m)
    return clearance_m


@compiled
def squared_distance_to_voxels(unsafe, reach):  # type: ignore[no-untyped-def]  # noqa: PLR0912 - three axes
    """Squared distance, in voxels, from each centre to the nearest point of an unsafe voxel; at most reach^2.

    Separable: along each axis the distance to a voxel n away is n - 1/2 (0 for n = 0). Along z two sweeps do;
    along y and x the minimum over shifts, each a pass over contiguous rows. float32 (nx, ny, nz).
    """
    nx, ny, nz = unsafe.shape
    limit = np.float32(reach * reach)
    distance = np.empty((nx, ny, nz), np.float32)
    for i in range(nx):
        for j in range(ny):
            steps = reach + 1
            for k in range(nz):
                steps = 0 if unsafe[i, j, k] else steps + 1
                distance[i, j, k] = min(np.float32(max(steps - 0.5, 0.0)) ** 2, limit)
            steps = reach + 1
            for k in range(nz - 1, -1, -1):
                steps = 0 if unsafe[i, j, k] else steps + 1
                distance[i, j, k] = min(distance[i, j, k], np.float32(max(steps - 0.5, 0.0)) ** 2)
    source = distance.copy()
    for i in range(nx):
        for j in range(ny):
            for shift in range(1, reach + 1):
                away = np.float32((shift - 0.5) ** 2)
                if j >= shift:
                    for k in range(nz):
                        distance[i, j, k] = min(distance[i, j, k], source[i, j - shift, k] + away)
                if j + shift < ny:
                    for k in range(nz):
                        distance[i, j, k] = min(distance[i, j, k], source[i, j + shift, k] + away)
    source = distance.copy()
    for i in range(nx):
        for shift in range(1, reach + 1):
            away = np.float32((shift - 0.5) ** 2)
            for j in range(ny):
                if i >= shift:
                    for k in range(nz):
                        distance[i, j, k] = min(distance[i, j, k], source[i - shift, j, k] + away)
                if i + shift < nx:
                    for k in range(nz):
                        distance[i, j, k] = min(distance[i, j, k], source[i + shift, j, k] + away)
    return distance


def _block_minimum(distances: NDArray[np.float32], stride: int, voxel_m: float) -> NDArray[np.float32]:
    padding = [(0, -count % stride) for count in distances.shape]
    blocks = np.pad(distances, padding, constant_values=np.inf)
    nx, ny, nz = (count // stride for count in blocks.shape)
    minimum = blocks.reshape(nx, stride, ny, stride, nz, stride).min(axis=(1, 3, 5))
    return np.asarray(minimum - np.float32(voxel_m * math.sqrt(3) / 2 * (1 + 1e-6)), dtype=np.float32)
