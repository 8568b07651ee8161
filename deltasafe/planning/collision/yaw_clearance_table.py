"""Free voxels per yaw bin: a bit table that accepts most poses near obstacles with one look-up.

The unsafe set is dilated by the footprint of the body in each yaw bin, on words of 64 voxels along z.
"""

import functools
import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from deltasafe.compute.numba_cache import compiled, inlined, kernel
from deltasafe.planning.body import ToolBody
from deltasafe.planning.collision.distance_field import DistanceField, voxel_of

BINS = 8
"""Bins of half a turn, the period of the disc. More bins accept few more poses."""

BESIDE_FRACTION = 0.75
"""Layers above and below the disc that need at least this fraction of the clearance sideways are given all of it."""

NORMALS = 96
"""Directions in which the support functions of footprints are compared."""

ROUNDING_M = 1e-9

Rows = NDArray[np.int64]
Words = NDArray[np.uint64]


class YawClearanceTable(NamedTuple):
    """Voxels in which a body is clear, per yaw bin.

    Attributes:
        free: (bins, nx, ny, ceil(nz / 64)) uint64, one bit per voxel. A set bit states a clearance of ``clear_m`` at
            any center in the voxel and any yaw in the bin.
        bins_per_rad: bins per radian.
        clear_m: clearance of free voxels; negative if the table is empty.
    """

    free: Words
    bins_per_rad: float
    clear_m: float


NO_YAW_TABLE = YawClearanceTable(np.empty((0, 0, 0, 0), np.uint64), 0.0, -1.0)
"""The table that accepts no pose."""


def yaw_clearance_table(field: DistanceField, body: ToolBody, clear_m: float) -> YawClearanceTable:
    """Build the table of a body that keeps ``clear_m``, or return the one cached with the field."""
    key = (body, clear_m)
    if key not in field.cache:
        field.cache[key] = YawClearanceTable(_free_voxels(field, body, clear_m), BINS / math.pi, float(clear_m))
    table: YawClearanceTable = field.cache[key]
    return table


@inlined
def is_free_by_yaw(table, lattice, pose):  # type: ignore[no-untyped-def]
    """Return whether the table states a clearance of ``clear_m`` at a pose; the table must not be empty."""
    i, j, k = voxel_of(lattice, pose[0], pose[1], pose[2])
    turns = pose[3] * table.bins_per_rad
    turns -= BINS * math.floor(turns / BINS)
    word = table.free[min(int(turns), BINS - 1), i, j, k >> 6]
    return (word >> np.uint64(k & 63)) & np.uint64(1) == np.uint64(1)


def _free_voxels(field: DistanceField, body: ToolBody, clear_m: float) -> Words:
    lattice = field.arrays.lattice
    voxel_m = lattice.voxel_m
    half_layers = (body.thickness_m / 2 + clear_m) / voxel_m
    layers = math.ceil(half_layers + 1)
    beside = [_beside_m(body, clear_m, voxel_m, layer) for layer in range(layers + 2)]
    wide = max(n for n in range(layers + 1) if beside[n] >= BESIDE_FRACTION * clear_m)
    unsafe = _words_of_64(field.unsafe_bits)
    blocked = np.zeros((BINS, lattice.nx, lattice.ny, unsafe.shape[2]), np.uint64)
    for reach, beside_m in ((wide, clear_m), (layers, beside[wide + 1])):
        if beside_m >= 0:
            footprints = _footprints(body.semi_axis_x_m, body.semi_axis_y_m, voxel_m, beside_m)
            _dilate(blocked, _spread_layers(unsafe, reach, reach), footprints)
    if body.shaft_length_m > 0:  # treated as infinitely long, as in the other tables
        footprints = _footprints(body.shaft_radius_m, body.shaft_radius_m, voxel_m, clear_m)
        _dilate(blocked, _spread_layers(_spread_down(unsafe), layers, 0), footprints)
    above_table = np.arange(64 * unsafe.shape[2]) >= math.ceil(half_layers - ROUNDING_M)
    return np.asarray(~blocked & np.packbits(above_table, bitorder="little").view("<u8"))


def _beside_m(body: ToolBody, clear_m: float, voxel_m: float, layer: int) -> float:
    """Horizontal clearance that the disc needs from a voxel ``layer`` layers above its center; -1 for none."""
    above_m = max(0.0, (layer - 1) * voxel_m - body.thickness_m / 2)
    return math.sqrt(clear_m**2 - above_m**2) if above_m <= clear_m else -1.0


@functools.lru_cache(maxsize=64)
def _footprints(semi_axis_x_m: float, semi_axis_y_m: float, voxel_m: float, beside_m: float) -> tuple[Rows, ...]:
    """Rows (di, first dj, last dj) of voxels that an ellipse may approach within ``beside_m``, for each bin.

    Voxels are counted from the one that contains the ellipse's center. This is an outer bound: tangents bound the
    convex set of offsets, and the turn within a bin is bounded by the difference of the semi-axes times the angle.
    """
    angle = np.linspace(0, 2 * np.pi, NORMALS, endpoint=False)
    normal = np.stack([np.cos(angle), np.sin(angle)])
    voxels_m = voxel_m * np.abs(normal).sum(axis=0)  # half of each: the voxel of the center, and the unsafe voxel
    turn_m = abs(semi_axis_x_m - semi_axis_y_m) * np.pi / (2 * BINS)
    radius = math.ceil((max(semi_axis_x_m, semi_axis_y_m) + beside_m + turn_m) / voxel_m) + 2
    offset = np.arange(-radius, radius + 1)
    along_m = voxel_m * (offset[:, None, None] * normal[0] + offset[None, :, None] * normal[1])
    footprints = []
    for n in range(BINS):
        turned = angle - np.pi * (n + 0.5) / BINS
        support_m = np.hypot(semi_axis_x_m * np.cos(turned), semi_axis_y_m * np.sin(turned))
        within = (along_m <= support_m + beside_m + turn_m + voxels_m + ROUNDING_M).all(axis=2)
        rows = np.flatnonzero(within.any(axis=1))
        first, last = within[rows].argmax(axis=1), within.shape[1] - 1 - within[rows, ::-1].argmax(axis=1)
        footprints.append(np.column_stack([offset[rows], offset[first], offset[last]]))
    return tuple(footprints)


def _words_of_64(bits: NDArray[np.int32]) -> Words:
    padded = np.zeros((*bits.shape[:2], -(-bits.shape[2] // 2) * 2), "<i4")
    padded[:, :, : bits.shape[2]] = bits
    return padded.view("<u8")


def _dilate(blocked: Words, unsafe: Words, footprints: tuple[Rows, ...]) -> None:
    """Block the voxels that the footprint around an unsafe voxel covers, in each bin; footprints are symmetric.

    Runs of 1, 2, 4, ... voxels are computed once. A row of a footprint is the union of two of them.
    """
    pad = max(int(np.abs(rows).max()) for rows in footprints)
    widest = max(int((rows[:, 2] - rows[:, 1]).max()) for rows in footprints) + 1
    padded = np.pad(unsafe, ((pad, pad), (pad, pad), (0, 0)), mode="edge")  # outside, the border voxels continue
    runs = _runs(padded, widest.bit_length())
    for n, rows in enumerate(footprints):
        _or_rows(blocked[n].reshape(len(blocked[n]), -1), runs, rows, pad)


@compiled
def _runs(words, count):  # type: ignore[no-untyped-def]
    """OR over runs of 1, 2, 4, ... 2^(count - 1) voxels along the second axis: (count, nx, ny * words)."""
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
def _or_rows(blocked, runs, rows, pad):  # type: ignore[no-untyped-def]
    nx, size = blocked.shape
    n_words = (runs.shape[2] - size) // (2 * pad) if pad > 0 else 1
    for i in range(nx):
        target = blocked[i]
        for n in range(len(rows)):
            di, first, last = rows[n, 0], rows[n, 1], rows[n, 2]
            power = 0
            while (2 << power) <= last - first + 1:
                power += 1
            run = runs[power, i + di + pad]
            head = run[(first + pad) * n_words :]
            tail = run[(last + 1 - (1 << power) + pad) * n_words :]
            for m in range(size):
                target[m] |= head[m] | tail[m]


@compiled
def _spread_layers(words, up, down):  # type: ignore[no-untyped-def]
    """Copy each set bit to the ``up`` voxels above it and the ``down`` voxels below it."""
    spread = words.copy()
    nx, ny, n_words = words.shape
    for i in range(nx):
        for j in range(ny):
            for w in range(n_words):
                if words[i, j, w] != 0:
                    for shift in range(-down, up + 1):
                        _or_shifted(spread[i, j], w, words[i, j, w], shift)
    return spread


@kernel
def _or_shifted(row, w, word, shift):  # type: ignore[no-untyped-def]
    """OR a word, shifted up by ``shift`` bits (down if negative), into a row of words at index w."""
    w, bits = w + (shift >> 6), np.uint64(shift & 63)
    if 0 <= w < len(row):
        row[w] |= word << bits
    if bits > 0 and 0 <= w + 1 < len(row):
        row[w + 1] |= word >> (np.uint64(64) - bits)


@compiled
def _spread_down(words):  # type: ignore[no-untyped-def]
    """Copy each set bit to all voxels below it."""
    spread = words.copy()
    nx, ny, n_words = words.shape
    for i in range(nx):
        for j in range(ny):
            above = False
            for w in range(n_words - 1, -1, -1):
                word = spread[i, j, w]
                if above:
                    word = np.uint64(0xFFFFFFFFFFFFFFFF)
                elif word != 0:
                    for bits in (1, 2, 4, 8, 16, 32):
                        word |= word >> np.uint64(bits)
                    above = True
                spread[i, j, w] = word
    return spread
