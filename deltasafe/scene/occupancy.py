"""The occupancy grid: P(occupied) of each voxel; free above the grid, unknown and therefore occupied beside it."""

import dataclasses
import math
import pathlib
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt, maximum_filter

from deltasafe.compute.numba_cache import compiled
from deltasafe.errors import DataError, SettingsError
from deltasafe.geometry import as_rows
from deltasafe.io.arrays import read_npz
from deltasafe.io.storage import atomic_file

MAX_VOXELS = 25_000_000
"""Largest grid that this package makes. A motion in it needs about 25 bytes a voxel, 0.6 GB."""

MIN_VOXEL_M = 1e-5
"""Smallest edge of a voxel: its inverse, which look-ups multiply by, must not overflow."""


def require_size(shape: Sequence[int], voxel_m: float) -> None:
    """Check the number of voxels of a grid before it is allocated.

    Raises:
        SettingsError: more than ``MAX_VOXELS``; names the voxel size that would do.
    """
    count = math.prod(int(length) for length in shape)
    if count > MAX_VOXELS:
        extent_m = " x ".join(f"{int(length) * voxel_m:.3g}" for length in shape)
        enough_m = 1.1 * voxel_m * (count / MAX_VOXELS) ** (1 / 3)  # 10 % for the rounding
        raise SettingsError(
            f"a grid of {extent_m} m with voxels of {voxel_m:g} m has {count:.3g} voxels, more than {MAX_VOXELS:.3g}; "
            f"set voxel_m to {enough_m:.2g} m or more, or choose a smaller area"
        )


@dataclasses.dataclass(frozen=True)
class OccupancyGrid:
    """P(occupied), constant in each cubic voxel.

    Outside the grid (decision 11), p_occupied is 0 above the plane of the upper face, and 1 elsewhere: space that was
    not seen counts as occupied. The lower face is the table.

    Attributes:
        p_occupied: (nx, ny, nz) float32 in [0, 1], read-only.
        origin_m: (3,) lower corner of the grid in the world frame.
        voxel_m: edge of a voxel.
        unseen: (nx, ny, nz) bool, read-only: voxels that hold 1 because the camera does not see them completely, and
            not because of a prediction; None: no such voxels are known.

    Raises:
        SettingsError: wrong shapes, a value outside [0, 1], an unseen voxel that does not hold 1, a voxel smaller than
            1e-5 m, or a corner farther than 1000 m from 0.
    """

    p_occupied: NDArray[np.float32]
    origin_m: NDArray[np.float64]
    voxel_m: float
    unseen: NDArray[np.bool_] | None = None

    def __post_init__(self) -> None:
        p_occupied = np.array(self.p_occupied, dtype=np.float32, order="C")
        origin_m = np.array(self.origin_m, dtype=np.float64)
        if p_occupied.ndim != 3 or p_occupied.size == 0:
            raise SettingsError(f"p_occupied must have shape (nx, ny, nz), got {p_occupied.shape}")
        if not (p_occupied.min() >= 0 and p_occupied.max() <= 1):
            raise SettingsError("p_occupied must lie in [0, 1]; NaN is not a probability")
        if origin_m.shape != (3,) or not np.isfinite(origin_m).all():
            raise SettingsError(f"origin_m must be a finite point, got {origin_m.tolist()}")
        if not (math.isfinite(self.voxel_m) and self.voxel_m >= MIN_VOXEL_M):
            raise SettingsError(f"voxel_m must be a length of at least {MIN_VOXEL_M:g} meters, got {self.voxel_m}")
        as_rows([origin_m, origin_m + self.voxel_m * np.array(p_occupied.shape)], 3, "the corners of the grid")
        if self.unseen is not None:
            unseen = np.array(self.unseen, dtype=np.bool_, order="C")
            if unseen.shape != p_occupied.shape or (p_occupied[unseen] != 1).any():
                raise SettingsError("unseen must have the shape of p_occupied, which holds 1 there")
            unseen.setflags(write=False)
            object.__setattr__(self, "unseen", unseen)
        p_occupied.setflags(write=False)
        origin_m.setflags(write=False)
        object.__setattr__(self, "p_occupied", p_occupied)
        object.__setattr__(self, "origin_m", origin_m)
        object.__setattr__(self, "voxel_m", float(self.voxel_m))

    @property
    def upper_m(self) -> NDArray[np.float64]:
        """(3,) upper corner of the grid; above its z the workspace is free."""
        return np.asarray(self.origin_m + self.voxel_m * np.array(self.p_occupied.shape))

    def at(self, points_m: NDArray[np.float64]) -> NDArray[np.float32]:
        """Look up p_occupied (N,) float32 at world points (N, 3).

        Raises:
            SettingsError: a point is not finite, or farther than 1000 m from 0.
        """
        points_m = as_rows(points_m, 3, "points_m")
        index = np.floor((points_m - self.origin_m) / self.voxel_m).astype(np.int64)
        inside = ((index >= 0) & (index < self.p_occupied.shape)).all(axis=1)
        p_occupied = np.where(index[:, 2] >= self.p_occupied.shape[2], np.float32(0), np.float32(1))
        p_occupied[inside] = self.p_occupied[tuple(index[inside].T)]
        return p_occupied

    def max_p_occupied_on(
        self, points_m: NDArray[np.float64], rotations: NDArray[np.float64], positions_m: NDArray[np.float64]
    ) -> NDArray[np.float32]:
        """Look up the largest p_occupied (N,) at the points (P, 3) of a body, in each of N poses.

        Args:
            rotations: (N, 3, 3) world from body; positions_m: (N, 3).

        Raises:
            SettingsError: wrong shapes, or a value that is not finite or too large.
        """
        points, positions = as_rows(points_m, 3, "points_m"), as_rows(positions_m, 3, "positions_m")
        if np.shape(rotations) != (len(positions), 3, 3):
            raise SettingsError(f"rotations must have shape ({len(positions)}, 3, 3), got {np.shape(rotations)}")
        turns = as_rows(np.reshape(rotations, (-1, 3)), 3, "rows of rotations").reshape(-1, 3, 3)
        return np.asarray(_largest_on_body(self.p_occupied, self.origin_m, self.voxel_m, points, turns, positions))

    def dilated(self, delta: float, margin_m: float) -> "OccupancyGrid":
        """Return the grid in which also the voxels beside {p_occupied > delta} are occupied (p_occupied = 1).

        Each horizontal slice is dilated on its own: the margin of a motion bounds what the image misses *beside* the
        unsafe set (decision 75), and the height of the hand has a margin of its own. A voxel is occupied if any of its
        points is within ``margin_m`` of any point of an unsafe voxel of its slice. ``unseen`` voxels, and those outside
        of the grid, are not dilated: they stand for the whole border of the view, not for a hand.

        Raises:
            SettingsError: delta is not in (0, 1), or the margin is negative or not finite.
        """
        if not 0 < delta < 1:
            raise SettingsError(f"delta must be in (0, 1), got {delta}")
        if not (math.isfinite(margin_m) and margin_m >= 0):
            raise SettingsError(f"the margin around the unsafe set must be a finite length, got {margin_m} m")
        unsafe = self.p_occupied > np.float64(delta)  # exact: not rounded to float32
        if self.unseen is not None:
            unsafe &= ~self.unseen
        if margin_m == 0.0 or not unsafe.any():
            return self
        # the distance between two squares is the distance between their centers after one of them is enlarged by one
        # voxel on each side
        enlarged = maximum_filter(unsafe, size=(3, 3, 1))
        reached = np.zeros_like(unsafe)
        for k in np.flatnonzero(enlarged.any(axis=(0, 1))):
            reached[:, :, k] = distance_transform_edt(~enlarged[:, :, k]) * self.voxel_m <= margin_m
        p_occupied = np.where(reached, np.float32(1), self.p_occupied)
        return OccupancyGrid(p_occupied, self.origin_m, self.voxel_m, self.unseen)

    def save(self, file: str | pathlib.Path) -> None:
        """Write a compressed ``.npz``, atomically."""
        file = pathlib.Path(file)
        if file.suffix != ".npz":
            raise SettingsError(f"an occupancy grid is stored as .npz, got {file.name}")
        with atomic_file(file) as temporary:
            np.savez_compressed(
                temporary,
                p_occupied=self.p_occupied,
                origin_m=self.origin_m,
                voxel_m=np.float64(self.voxel_m),
                **({} if self.unseen is None else {"unseen": self.unseen}),  # type: ignore[arg-type]
            )

    @classmethod
    def load(cls, file: str | pathlib.Path) -> "OccupancyGrid":
        """Read a file that ``save`` wrote.

        Raises:
            DataError: the file is missing or is not an occupancy grid.
        """
        try:
            arrays = read_npz(file)
            voxel_m = float(arrays["voxel_m"])
            return cls(arrays["p_occupied"], arrays["origin_m"], voxel_m, arrays.get("unseen"))
        except (ValueError, KeyError, TypeError) as error:
            reason = error.reason if isinstance(error, DataError) else repr(error)
            raise DataError(file, f"is not an occupancy grid ({reason}); make the occupancy fields again") from error


@compiled
def _largest_on_body(p_occupied, origin, voxel, points, rotations, positions):  # type: ignore[no-untyped-def]  # pragma: no cover
    nx, ny, nz = p_occupied.shape
    largest = np.zeros(len(positions), np.float32)
    for n in range(len(positions)):
        for m in range(len(points)):
            x, y, z = points[m, 0], points[m, 1], points[m, 2]
            r = rotations[n]
            k = math.floor((positions[n, 2] + r[2, 0] * x + r[2, 1] * y + r[2, 2] * z - origin[2]) / voxel)
            if k >= nz:
                continue
            i = math.floor((positions[n, 0] + r[0, 0] * x + r[0, 1] * y + r[0, 2] * z - origin[0]) / voxel)
            j = math.floor((positions[n, 1] + r[1, 0] * x + r[1, 1] * y + r[1, 2] * z - origin[1]) / voxel)
            inside = 0 <= i < nx and 0 <= j < ny and k >= 0
            largest[n] = max(largest[n], p_occupied[i, j, k] if inside else np.float32(1.0))
            if largest[n] >= 1.0:
                break
    return largest
