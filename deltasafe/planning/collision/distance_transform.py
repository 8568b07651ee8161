"""Exact Euclidean distances to a set of voxels, in half voxels squared: small integers, no rounding."""

import numpy as np
from numpy.typing import NDArray

from deltasafe.compute.numba_cache import compiled, kernel

__all__ = ["MOST_VOXELS", "squared_distance_in_slabs", "squared_distance_to_voxels"]

MOST_VOXELS = 90
"""Largest reach in voxels: twice its square, in half voxels, still fits 16 bits."""


def squared_distance_to_voxels(unsafe: NDArray[np.bool_], reach: int) -> NDArray[np.uint16]:
    """Squared distance from each voxel's center to the nearest point of an unsafe voxel; at most (2 reach)^2.

    In half voxels squared. Separable (Saito and Toriwaki 1994): along each axis a voxel n > 0 away is 2n - 1 half
    voxels away. Within a small reach the minimum over shifts is a few passes over contiguous 16-bit rows, which
    vector units take 32 at a time; the lower envelope of Felzenszwalb and Huttenlocher (2012), linear in theory,
    is several times slower here.

    Args:
        unsafe: (nx, ny, nz).
        reach: in voxels, 1 to ``MOST_VOXELS``.
    """
    if not 1 <= reach <= MOST_VOXELS:
        raise ValueError(f"reach must be between 1 and {MOST_VOXELS} voxels, got {reach}")
    return np.asarray(_transformed(np.ascontiguousarray(unsafe), int(reach)))


def squared_distance_in_slabs(unsafe: NDArray[np.bool_], half_height: int, reach: int) -> NDArray[np.uint16]:
    """Squared horizontal distance (nx, ny, nz) to what is unsafe up to ``half_height`` slices below and above.

    From the middle of a voxel in plan view to the nearest edge, in half voxels squared; at most (2 reach)^2.
    """
    if not 1 <= reach <= MOST_VOXELS:
        raise ValueError(f"reach must be between 1 and {MOST_VOXELS} voxels, got {reach}")
    return np.asarray(_flat(np.ascontiguousarray(unsafe), int(half_height), int(reach)))


@compiled
def _flat(unsafe, half_height, reach):  # type: ignore[no-untyped-def]
    """Columns lie side by side, with a gap that slices may spread into: passes are over whole rows of them.

    Above all that is unsafe or beside it, nothing is near: those slices are not looked at.
    """
    nx, ny, nz = unsafe.shape
    used = min(_highest(unsafe) + half_height, nz)
    wide, far = used + half_height, np.uint16(4 * reach * reach)
    beside, near = np.empty((nx, ny * wide), np.uint16), np.zeros(nx, np.bool_)
    whole, slab = np.zeros(ny * wide + half_height, np.bool_), np.zeros(ny * wide + half_height, np.bool_)
    for i in range(nx):  # slabs first, then along the second axis
        for j in range(ny):
            for k in range(used):
                whole[half_height + j * wide + k] = unsafe[i, j, k]
        slab[:] = whole
        for shift in range(1, half_height + 1):
            _spread(slab[shift:], whole[: len(whole) - shift])
            _spread(slab[: len(slab) - shift], whole[shift:])
        near[i] = _sweep_together(slab[half_height:], beside[i], wide, reach)
    squared = np.minimum(beside, far)
    _across(squared, beside, near, reach)
    found = np.empty(unsafe.shape, np.uint16)
    for i in range(nx):
        for j in range(ny):
            for k in range(used):
                found[i, j, k] = squared[i, j * wide + k]
            for k in range(used, nz):
                found[i, j, k] = far
    return found


@compiled
def _highest(unsafe):  # type: ignore[no-untyped-def]
    """Number of slices up to the highest that holds an unsafe voxel."""
    nx, ny, nz = unsafe.shape
    some = np.zeros(nz, np.bool_)
    for i in range(nx):
        for j in range(ny):
            for k in range(nz):
                some[k] |= unsafe[i, j, k]
    while nz > 0 and not some[nz - 1]:
        nz -= 1
    return nz


@kernel
def _spread(target, source):  # type: ignore[no-untyped-def]
    for n in range(len(target)):
        target[n] |= source[n]


@kernel
def _sweep_together(unsafe, squared, wide, reach):  # type: ignore[no-untyped-def]
    """Squared distances along lines that lie side by side, ``wide`` apart; whether there is an unsafe voxel."""
    most = np.uint16(2 * reach)
    some = False
    for n in range(len(squared)):
        some |= unsafe[n]
        squared[n] = np.uint16(0) if unsafe[n] else most
    if some:  # a voxel next to an unsafe one is one half voxel away, every further one two more
        for begin in range(wide, len(squared), wide):
            _one_further(squared[begin : begin + wide], squared[begin - wide : begin])
        for begin in range(len(squared) - 2 * wide, -1, -wide):
            _one_further(squared[begin : begin + wide], squared[begin + wide : begin + 2 * wide])
    for n in range(len(squared)):
        squared[n] *= squared[n]
    return some


@kernel
def _one_further(target, source):  # type: ignore[no-untyped-def]
    for n in range(len(target)):
        through = np.uint16(source[n] + np.uint16(2) - np.uint16(source[n] == 0))
        target[n] = min(target[n], through)


@compiled
def _transformed(unsafe, reach):  # type: ignore[no-untyped-def]
    nx, ny, nz = unsafe.shape
    along, beside = np.empty(ny * nz, np.uint16), np.empty((nx, ny * nz), np.uint16)
    near = np.zeros(nx, np.bool_)  # slices that hold an unsafe voxel
    for i in range(nx):
        for j in range(ny):
            near[i] |= _sweep(unsafe[i, j], along[j * nz : (j + 1) * nz], reach)
        beside[i] = along
        for shift in range(1, reach + 1):
            if near[i] and shift < ny:
                away = np.uint16((2 * shift - 1) * (2 * shift - 1))
                _lower(beside[i, shift * nz :], along[: (ny - shift) * nz], away)
                _lower(beside[i, : (ny - shift) * nz], along[shift * nz :], away)
    squared = np.minimum(beside, np.uint16(4 * reach * reach))
    _across(squared, beside, near, reach)
    return squared.reshape(nx, ny, nz)


@kernel
def _across(squared, beside, near, reach):  # type: ignore[no-untyped-def]
    """The last pass, along the first axis; rows that hold nothing near are not looked at."""
    for i in range(len(beside)):
        for shift in range(1, reach + 1):
            away = np.uint16((2 * shift - 1) * (2 * shift - 1))
            if i >= shift and near[i - shift]:
                _lower(squared[i], beside[i - shift], away)
            if i + shift < len(beside) and near[i + shift]:
                _lower(squared[i], beside[i + shift], away)


@kernel
def _sweep(unsafe, squared, reach):  # type: ignore[no-untyped-def]
    """Squared distances along a line, up and down; whether there is an unsafe voxel."""
    some = False
    for k in range(len(unsafe)):
        some |= unsafe[k]
    if not some:
        squared[:] = 4 * reach * reach
        return False
    steps = 2 * reach
    for k in range(len(unsafe)):
        steps = -1 if unsafe[k] else min(steps + 2, 2 * reach)
        squared[k] = max(steps, 0) * max(steps, 0)
    steps = 2 * reach
    for k in range(len(unsafe) - 1, -1, -1):
        steps = -1 if unsafe[k] else min(steps + 2, 2 * reach)
        squared[k] = min(squared[k], np.uint16(max(steps, 0) * max(steps, 0)))
    return True


@kernel
def _lower(target, source, away):  # type: ignore[no-untyped-def]
    for n in range(len(target)):
        through = np.uint16(source[n] + away)
        target[n] = through if through < target[n] else target[n]
