"""The paper's scenario test of a pose: N_x points drawn uniformly from the enlarged body (section IV-A)."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from deltasafe.compute.numba_cache import inlined
from deltasafe.planning.body import ToolBody
from deltasafe.planning.collision.distance_field import DistanceField

POOL_SIZE = 16384
BLOCK = 16
"""Samples per iteration of the vectorized loop; samples beyond N_x in the last block are masked."""


class SamplePool(NamedTuple):
    """Uniform points of the enlarged body, drawn once. A pose reads ``n_samples`` consecutive points.

    Attributes:
        points: (3, n) float32 in voxels, in the body's frame; padded to whole blocks.
        unsafe_bits: (nx * ny * ceil(nz / 32),) int32, one bit per voxel.
        n_samples: N_x.
        redraw: start at a random point for each pose, or always at the first.
        floor: height of the table in voxels above the lattice's lower face.
        seed: of the random starting points.
    """

    points: NDArray[np.float32]
    unsafe_bits: NDArray[np.int32]
    n_samples: int
    redraw: bool
    floor: float
    seed: int


def sample_pool(
    field: DistanceField, body: ToolBody, margin_m: float, n_samples: int, redraw: bool, seed: int
) -> SamplePool:
    """Draw the pool of points of R_0 + B(margin)."""
    lattice = field.arrays.lattice
    padded = -(-n_samples // BLOCK) * BLOCK
    points = body.samples(margin_m, POOL_SIZE if redraw else padded, seed) * lattice.per_m
    points = np.concatenate([points, points[:padded]]).T
    floor = (field.arrays.table_z_m - lattice.lower_z_m) * lattice.per_m
    return SamplePool(
        np.ascontiguousarray(points, np.float32), field.unsafe_bits.ravel(), int(n_samples), redraw, floor, int(seed)
    )


@inlined
def samples_are_free(lattice, pool, pose, bits):  # type: ignore[no-untyped-def]
    """Return whether none of N_x points of the body at a pose is unsafe; the random ``bits`` select the points.

    The body is symmetric in both axes of its disc. Two of the bits mirror the pool, which gives four pools for one.

    The inner loop is written so that LLVM vectorizes it: no branches, a fixed length, 32-bit arithmetic by NumPy
    functions (operators would widen to 64 bits), and unsigned indices (negative ones would need a check).
    """
    first = 0
    x, y, z, yaw = pose
    cos, sin = math.cos(yaw), math.sin(yaw)
    mirror_x, mirror_y = 1.0, 1.0
    if pool.redraw:
        first = np.int64(bits & np.uint64(POOL_SIZE - 1))
        mirror_x = 1.0 if bits & np.uint64(1 << 40) else -1.0
        mirror_y = 1.0 if bits & np.uint64(1 << 41) else -1.0
    a, b = np.float32(cos * mirror_x), np.float32(sin * mirror_y)
    c, d = np.float32(sin * mirror_x), np.float32(cos * mirror_y)
    u0 = np.float32((x - lattice.lower_x_m) * lattice.per_m)
    v0 = np.float32((y - lattice.lower_y_m) * lattice.per_m)
    w0 = np.float32((z - lattice.lower_z_m) * lattice.per_m)
    last_u, last_v, last_w = np.float32(lattice.nx - 1), np.float32(lattice.ny - 1), np.float32(lattice.nz - 1)
    zero, floor = np.float32(0.0), np.float32(pool.floor)
    rows, columns = np.int32(lattice.ny), np.int32((lattice.nz + 31) // 32)
    end, unsafe = first + pool.n_samples, pool.unsafe_bits
    for begin in range(first, end, BLOCK):
        stop, remaining, hit = begin + BLOCK, np.int32(end - begin), np.int32(0)
        xs, ys, zs = pool.points[0, begin:stop], pool.points[1, begin:stop], pool.points[2, begin:stop]
        for n in range(BLOCK):
            u, v, w = u0 + a * xs[n] - b * ys[n], v0 + c * xs[n] + d * ys[n], w0 + zs[n]
            below = np.int32(w < floor)
            u, v, w = u if u > zero else zero, v if v > zero else zero, w if w > zero else zero
            u, v, w = u if u < last_u else last_u, v if v < last_v else last_v, w if w < last_w else last_w
            column, k = np.add(np.multiply(np.int32(u), rows), np.int32(v)), np.int32(w)
            word = unsafe[np.uint32(np.add(np.multiply(column, columns), np.right_shift(k, np.int32(5))))]
            here = np.bitwise_or(np.right_shift(word, np.bitwise_and(k, np.int32(31))), below)
            hit = np.bitwise_or(hit, np.bitwise_and(here, np.int32(np.int32(n) < remaining)))
        if hit & 1:
            return False
    return True
