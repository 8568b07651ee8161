"""A field and a body as the exact tests of segments read them, where no certificate settles a pose."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from deltasafe.planning.body import ToolBody
from deltasafe.planning.collision.distance_field import DistanceField, Lattice

__all__ = ["CollisionArrays", "collision_arrays_of"]

GOLDEN = (math.sqrt(5) - 1) / 2


class CollisionArrays(NamedTuple):
    """A field as a body meets it.

    Attributes:
        above: (nx, ny, nz) uint8, the clearance of any ray upwards from a voxel: v > 0 says at least v - 1 fine units.
        unsafe: (nx, ny, ceil(nz / 32)) int32, the unsafe voxels as bits.
        few: (m, 3) few balls that contain the disc: center in its plane in voxels, radius in the plane in m;
            ``widest_m`` the largest radius.
        slices: (nx, ny, nz) uint8, horizontal distance from the middle of a voxel to all that is unsafe in its slice,
            in fine units.
        slabs: the same to all slices that disc and margin may meet while the pose keeps its height up to ``slab_m``.
        ball, ray: squared distances (``FieldArrays``).
        groups: (m, 5) few balls that contain the disc, tight in its plane: center, radius, and the radius that also
            contains the balls of the cover given to it; cover: (n, 4) many balls that contain the disc closely, by
            group; first: (m + 1,) where in the cover each group begins.
        lattice: of the field.
        floor_z_m: the table.
    """

    above: NDArray[np.uint8]
    unsafe: NDArray[np.int32]
    few: NDArray[np.float64]
    widest_m: float
    slices: NDArray[np.uint8]
    slabs: NDArray[np.uint8]
    slab_m: float
    ball: NDArray[np.uint16]
    ray: NDArray[np.uint16]
    groups: NDArray[np.float64]
    cover: NDArray[np.float64]
    first: NDArray[np.int64]
    lattice: Lattice
    floor_z_m: float


def collision_arrays_of(field: DistanceField, body: ToolBody, margin_m: float) -> CollisionArrays:
    """Field and body as the exact tests read them; ``margin_m`` is what a pose keeps from the unsafe set."""
    slabs, slab_m = field.slabs(body.thickness_m / 2 + margin_m)
    groups, cover, first = _grouped(body)
    few = _few(body, field.arrays.lattice)
    return CollisionArrays(
        above=field.ray_clearance,
        unsafe=field.unsafe_bits,
        few=few,
        widest_m=float(few[:, 2].max()),
        slices=field.slices,
        slabs=slabs,
        slab_m=slab_m,
        ball=field.arrays.ball,
        ray=field.arrays.ray,
        groups=groups,
        cover=cover,
        first=first,
        lattice=field.arrays.lattice,
        floor_z_m=field.arrays.floor_z_m,
    )


def _few(body: ToolBody, lattice: Lattice) -> NDArray[np.float64]:
    x, y, _, radius_m = body.disc_balls.T
    flat_m = np.sqrt(np.maximum(radius_m**2 - body.thickness_m**2 / 4, 0.0)) * (1 + 1e-9)
    spread = np.argsort(GOLDEN * np.arange(len(x)) % 1)  # the first ones tell most: none is beside the one before
    return np.ascontiguousarray(np.column_stack([x * lattice.per_m, y * lattice.per_m, flat_m])[spread])


def _grouped(body: ToolBody) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.int64]]:
    balls, (centers, radius_m) = body.disc_balls, body.disc_cover
    away = np.linalg.norm(centers[:, None] - balls[:, :3], axis=2)
    owner = (away - balls[:, 3]).argmin(axis=1)
    outer = [away[owner == n, n].max(initial=0.0) + radius_m for n in range(len(balls))]
    order = np.argsort(owner, kind="stable")  # within a group from the outside in, as in the cover
    cover = np.column_stack([centers, np.full(len(centers), radius_m)])[order]
    first = np.searchsorted(owner[order], np.arange(len(balls) + 1))
    return np.column_stack([balls, np.maximum(outer, balls[:, 3])]), cover, first
