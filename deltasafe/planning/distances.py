"""Exact Euclidean distances to a set of voxels, in half voxels squared: small integers, no rounding."""

import numpy as np
from numpy.typing import NDArray

from deltasafe.compiling import compiled, kernel

__all__ = ["MOST_VOXELS", "squared_distance_in_slabs", "squared_distance_to_voxels"]

MOST_VOXELS = 90
"""Largest reach in voxels: twice its square, in half voxels, still fits 16 bits."""


def squared_distance_to_voxels(unsafe: NDArray[np.bool_], reach: int) -> NDArray[np.uint16]:
    """Squared distance from each voxel's centre to the nearest point of an unsafe voxel; at most (2 reach)^2.

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
    """Squared horizontal distance (nz, nx, ny) to what is unsafe up to ``half_height`` slices below and above.

    From the middle of a voxel in plan view to the nearest edge, in half voxels squared; at most (2 reach)^2.
    """
    if not 1 <= reach <= MOST_VOXELS:
        raise ValueError(f"reach must be between 1 and {MOST_VOXELS} voxels, got {reach}")
    return np.asarray(_flat(np.ascontiguousarray(unsafe.transpose(2, 0, 1)), int(half_height), int(reach)))


@compiled
def _flat(slices, half_height, reach):  # type: ignore[no-untyped-def]
    nz, nx, ny = slices.shape
    limit = np.uint16(4 * reach * reach)
    squared = np.empty((nz, nx, ny), np.uint16)
    slab, beside = np.empty((nx, ny), np.bool_), np.empty((nx, ny), np.uint16)
    near = np.empty(nx, np.bool_)
    for k in range(nz):
        slab[:] = slices[k]
        for other in range(max(k - half_height, 0), min(k + half_height + 1, nz)):
            slab |= slices[other]
        for i in range(nx):
            near[i] = _sweep(slab[i], beside[i], reach)
        for i in range(nx):
            squared[k, i] = np.minimum(beside[i], limit)
            for shift in range(1, reach + 1):
                away = np.uint16((2 * shift - 1) * (2 * shift - 1))
                if i >= shift and near[i - shift]:
                    _lower(squared[k, i], beside[i - shift], away)
                if i + shift < nx and near[i + shift]:
                    _lower(squared[k, i], beside[i + shift], away)
    return squared


@compiled
def _transformed(unsafe, reach):  # type: ignore[no-untyped-def]
    nx, ny, nz = unsafe.shape
    limit = np.uint16(4 * reach * reach)
    squared, beside = np.empty((nx, ny * nz), np.uint16), np.empty((nx, ny * nz), np.uint16)
    near = np.zeros(nx, np.bool_)  # slices that hold an unsafe voxel
    for i in range(nx):
        along = squared[i]
        for j in range(ny):
            near[i] |= _sweep(unsafe[i, j], along[j * nz : (j + 1) * nz], reach)
        beside[i] = along
        for shift in range(1, reach + 1):
            if near[i] and shift < ny:
                away = np.uint16((2 * shift - 1) * (2 * shift - 1))
                _lower(beside[i, shift * nz :], along[: (ny - shift) * nz], away)
                _lower(beside[i, : (ny - shift) * nz], along[shift * nz :], away)
    for i in range(nx):
        squared[i] = np.minimum(beside[i], limit)
        for shift in range(1, reach + 1):
            away = np.uint16((2 * shift - 1) * (2 * shift - 1))
            if i >= shift and near[i - shift]:
                _lower(squared[i], beside[i - shift], away)
            if i + shift < nx and near[i + shift]:
                _lower(squared[i], beside[i + shift], away)
    return squared.reshape(nx, ny, nz)


@kernel
def _sweep(unsafe, squared, reach):  # type: ignore[no-untyped-def]
    """Squared distances along a line, up and down; whether there is an unsafe voxel."""
    some = False
    steps = 2 * reach
    for k in range(len(unsafe)):
        steps = -1 if unsafe[k] else min(steps + 2, 2 * reach)
        squared[k] = max(steps, 0) * max(steps, 0)
        some |= unsafe[k]
    if some:
        steps = 2 * reach
        for k in range(len(unsafe) - 1, -1, -1):
            steps = -1 if unsafe[k] else min(steps + 2, 2 * reach)
            squared[k] = min(squared[k], np.uint16(max(steps, 0) * max(steps, 0)))
    return some


@kernel
def _lower(target, source, away):  # type: ignore[no-untyped-def]
    for n in range(len(target)):
        through = np.uint16(source[n] + away)
        target[n] = through if through < target[n] else target[n]
