"""Where a body is free as it is turned: a grid that settles most poses near obstacles in one look-up.

The unsafe set is dilated by the body's footprint at each of some yaws: morphology on bits, a column of voxels a word.
"""

import functools
import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from deltasafe.compute.numba_cache import compiled, inlined
from deltasafe.planning.body import ToolBody
from deltasafe.planning.collision.distance_field import DistanceField, voxel_of

__all__ = ["YawClearanceTable", "empty_yaw_clearance_table", "is_free_by_yaw", "yaw_clearance_table"]

BINS = 8
"""Of half a turn, after which the disc is the same; more of them settle little more."""

WIDE = 0.75
"""Share of the margin from which on layers above and below the disc count as if they were beside it."""

NORMALS = 96
ROUNDING_M = 1e-9

Rows = NDArray[np.int64]


class YawClearanceTable(NamedTuple):
    """What a body may do by voxel and yaw.

    Attributes:
        free: (bins, nx, ny, ceil(nz / 64)) uint64: a bit says that the body keeps ``clear_m`` from all that is unsafe
            wherever in the voxel its center is and whatever yaw of the bin it has. Empty if there is none.
        bins_per_rad: bins in a radian.
        clear_m: what a free body keeps; negative if there is no certificate.
    """

    free: NDArray[np.uint64]
    bins_per_rad: float
    clear_m: float


def empty_yaw_clearance_table() -> YawClearanceTable:
    """One that settles nothing."""
    return YawClearanceTable(np.empty((0, 0, 0, 0), np.uint64), 0.0, -1.0)


def yaw_clearance_table(field: DistanceField, body: ToolBody, clear_m: float) -> YawClearanceTable:
    """The certificate of a body that keeps ``clear_m``; made once, and kept with the field."""
    key = (body, clear_m)
    if key not in field.kept:
        lattice = field.arrays.lattice
        layers = math.ceil((body.thickness_m / 2 + clear_m) / lattice.voxel_m + 1)
        wide = max(n for n in range(layers + 1) if _beside_m(body, clear_m, lattice.voxel_m, n) >= WIDE * clear_m)
        unsafe = _words(field.unsafe_bits)
        shape = body.semi_axis_x_m, body.semi_axis_y_m, lattice.voxel_m
        blocked = np.zeros((BINS, lattice.nx, lattice.ny, unsafe.shape[2]), np.uint64)
        for reach, beside_m in ((wide, clear_m), (layers, _beside_m(body, clear_m, lattice.voxel_m, wide + 1))):
            if beside_m >= 0:
                _dilate(blocked, _layers(unsafe, reach, reach), _footprints(*shape, beside_m))
        if body.shaft_length_m > 0:  # whatever is above, as for the other certificates
            radius_m = body.shaft_radius_m
            every = _footprints(radius_m, radius_m, lattice.voxel_m, clear_m)
            _dilate(blocked, _layers(_all_below(unsafe), layers, 0), every)
        lowest = math.ceil((body.thickness_m / 2 + clear_m) / lattice.voxel_m - ROUNDING_M)
        free = ~blocked & _from(lowest, unsafe.shape[2])
        field.kept[key] = YawClearanceTable(free, BINS / math.pi, float(clear_m))
    certificate: YawClearanceTable = field.kept[key]
    return certificate


@inlined
def is_free_by_yaw(certificate, lattice, x, y, z, yaw):  # type: ignore[no-untyped-def]
    """Whether the certificate shows that the body keeps ``clear_m`` at a pose; it must not be empty."""
    i, j, k = voxel_of(lattice, x, y, z)
    turns = yaw * certificate.bins_per_rad
    turns -= BINS * math.floor(turns / BINS)
    word = certificate.free[min(int(turns), BINS - 1), i, j, k >> 6]
    return (word >> np.uint64(k & 63)) & np.uint64(1) == np.uint64(1)


def _beside_m(body: ToolBody, clear_m: float, voxel_m: float, layer: int) -> float:
    """How far beside the disc a voxel so many layers above it may come before it is within ``clear_m``; -1: never."""
    above_m = max(0.0, (layer - 1) * voxel_m - body.thickness_m / 2)
    return math.sqrt(clear_m**2 - above_m**2) if above_m <= clear_m else -1.0


@functools.lru_cache(maxsize=64)
def _footprints(semi_axis_x_m: float, semi_axis_y_m: float, voxel_m: float, beside_m: float) -> tuple[Rows, ...]:
    """By bin, the rows (di, first dj, last dj) of voxels that an ellipse may come within ``beside_m`` of.

    Of those around the voxel that holds its center, wherever in it. An outer bound: of the convex set of offsets by
    tangents, and of the turn within a bin by the difference of the support functions, at most that of the semi-axes
    times the angle.
    """
    angle = np.linspace(0, 2 * np.pi, NORMALS, endpoint=False)
    normal = np.stack([np.cos(angle), np.sin(angle)])
    voxels_m = voxel_m * np.abs(normal).sum(axis=0)  # two voxels: that of the center, and the unsafe one
    turn_m = abs(semi_axis_x_m - semi_axis_y_m) * np.pi / (2 * BINS)
    most = math.ceil((max(semi_axis_x_m, semi_axis_y_m) + beside_m + turn_m) / voxel_m) + 2
    offset = np.arange(-most, most + 1)
    along_m = voxel_m * (offset[:, None, None] * normal[0] + offset[None, :, None] * normal[1])
    found = []
    for n in range(BINS):
        turned = angle - np.pi * (n + 0.5) / BINS
        support_m = np.hypot(semi_axis_x_m * np.cos(turned), semi_axis_y_m * np.sin(turned))
        within = (along_m <= support_m + beside_m + turn_m + voxels_m + ROUNDING_M).all(axis=2)
        rows = np.flatnonzero(within.any(axis=1))
        first, last = within[rows].argmax(axis=1), within.shape[1] - 1 - within[rows, ::-1].argmax(axis=1)
        found.append(np.column_stack([offset[rows], offset[first], offset[last]]))
    return tuple(found)


def _words(bits: NDArray[np.int32]) -> NDArray[np.uint64]:
    """Words of 32 voxels, the lowest in the lowest bit, as words of 64."""
    padded = np.zeros((*bits.shape[:2], -(-bits.shape[2] // 2) * 2), "<i4")
    padded[:, :, : bits.shape[2]] = bits
    return padded.view("<u8")


def _from(lowest: int, n_words: int) -> NDArray[np.uint64]:
    """Words whose bits are set from ``lowest`` on."""
    bits = np.arange(64 * n_words) >= lowest
    return np.packbits(bits, bitorder="little").view("<u8")


def _dilate(blocked: NDArray[np.uint64], unsafe: NDArray[np.uint64], footprints: tuple[Rows, ...]) -> None:
    """Block, in each bin, what its footprint around an unsafe voxel touches (footprints are their own mirror images).

    Runs of 1, 2, 4, ... voxels are made once; a row of a footprint is two of them.
    """
    pad = max(int(np.abs(rows).max()) for rows in footprints)
    widest = max(int((rows[:, 2] - rows[:, 1]).max()) for rows in footprints) + 1
    padded = np.pad(unsafe, ((pad, pad), (pad, pad), (0, 0)), mode="edge")  # beside the grid it goes on as it ends
    runs = _runs(padded, widest.bit_length())
    for n, rows in enumerate(footprints):
        _add_rows(blocked[n].reshape(len(blocked[n]), -1), runs, rows, pad)


@compiled
def _runs(words, count):  # type: ignore[no-untyped-def]
    nx, ny, n_words = words.shape
    runs = np.empty((count, nx, ny * n_words), np.uint64)
    for i in range(nx):
        runs[0, i] = words[i].ravel()
        for power in range(1, count):
            shorter, longer, apart = runs[power - 1, i], runs[power, i], n_words << (power - 1)
            for n in range(len(longer) - apart):
                longer[n] = shorter[n] | shorter[n + apart]
            for n in range(max(len(longer) - apart, 0), len(longer)):
                longer[n] = shorter[n]
    return runs


@compiled
def _add_rows(blocked, runs, rows, pad):  # type: ignore[no-untyped-def]
    nx, size = blocked.shape
    n_words = (runs.shape[2] - size) // (2 * pad) if pad > 0 else 1
    for i in range(nx):
        into = blocked[i]
        for n in range(len(rows)):
            di, first, last = rows[n, 0], rows[n, 1], rows[n, 2]
            power = 0
            while (2 << power) <= last - first + 1:
                power += 1
            run = runs[power, i + di + pad]
            one = run[(first + pad) * n_words :]
            other = run[(last + 1 - (1 << power) + pad) * n_words :]
            for m in range(size):
                into[m] |= one[m] | other[m]


@compiled
def _layers(words, below, above):  # type: ignore[no-untyped-def]
    """A bit for whether any of the voxels from ``below`` under it to ``above`` over it is set."""
    found = words.copy()
    nx, ny, n_words = words.shape
    for i in range(nx):
        for j in range(ny):
            for w in range(n_words):
                here = words[i, j, w]
                if here == 0:
                    continue
                for layer in range(1, below + 1):  # seen from `layer` above
                    part, bits = layer >> 6, np.uint64(layer & 63)
                    if w + part < n_words:
                        found[i, j, w + part] |= here << bits
                    if bits > 0 and w + part + 1 < n_words:
                        found[i, j, w + part + 1] |= here >> (np.uint64(64) - bits)
                for layer in range(1, above + 1):
                    part, bits = layer >> 6, np.uint64(layer & 63)
                    if w - part >= 0:
                        found[i, j, w - part] |= here >> bits
                    if bits > 0 and w - part - 1 >= 0:
                        found[i, j, w - part - 1] |= here << (np.uint64(64) - bits)
    return found


@compiled
def _all_below(words):  # type: ignore[no-untyped-def]
    """A bit for whether the voxel or any above it is set."""
    found = words.copy()
    nx, ny, n_words = words.shape
    for i in range(nx):
        for j in range(ny):
            above = False
            for w in range(n_words - 1, -1, -1):
                here = found[i, j, w]
                if above:
                    here = np.uint64(0xFFFFFFFFFFFFFFFF)
                elif here != 0:
                    for bits in (1, 2, 4, 8, 16, 32):
                        here |= here >> np.uint64(bits)
                    above = True
                found[i, j, w] = here
    return found
