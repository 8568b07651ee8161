"""Nearest nodes: a scan of all points while they are few, a kd-tree beyond; both find the same neighbors."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from deltasafe.compute.numba_cache import inlined
from deltasafe.planning.search.bucket_tree import BucketTree, collect, empty_buckets, insert, nearest_in
from deltasafe.planning.search.simd_groups import GROUP, append_within, ctz, le_mask, popcount, squared_distances

BUCKET_THRESHOLD = 4500
"""Number of points beyond which the bucket tree is faster than a scan."""


class Neighbors(NamedTuple):
    """Points in scaled coordinates, and scratch arrays of the queries.

    Attributes:
        points: (4, n); unused places are infinitely far, so that scans cover whole groups.
        squared: squared distances of the last scan; ``squared_bits`` is the same memory as integers.
        squared_near_radius: (n,) squared radius of the near set at insertion, rescaled to the current tree size. It is
            the first guess for the near set of a neighbor.
        found, found_squared: indices and squared distances of the last query.
        buckets: the kd-tree, used beyond ``bucket_threshold`` points.
    """

    points: NDArray[np.float32]
    squared: NDArray[np.float32]
    squared_bits: NDArray[np.int32]
    squared_near_radius: NDArray[np.float32]
    found: NDArray[np.int32]
    found_squared: NDArray[np.float32]
    buckets: BucketTree
    bucket_threshold: int


def empty_neighbors(capacity: int, bucket_threshold: int = BUCKET_THRESHOLD) -> Neighbors:
    """Allocate for ``capacity`` points."""
    groups = -(-capacity // GROUP)
    squared = np.empty(GROUP * (groups + 1), np.float32)
    return Neighbors(
        np.full((4, GROUP * groups), np.inf, np.float32),
        squared,
        squared.view(np.int32),
        np.empty(capacity, np.float32),
        np.empty(capacity + 1 + GROUP, np.int32),
        np.empty(capacity + 1 + GROUP, np.float32),
        empty_buckets(capacity if capacity > bucket_threshold else 1),
        bucket_threshold,
    )


@inlined
def _float32(x):  # type: ignore[no-untyped-def]
    return np.float32(x[0]), np.float32(x[1]), np.float32(x[2]), np.float32(x[3])


@inlined
def point_of(neighbors, index):  # type: ignore[no-untyped-def]
    """Return a point as a tuple."""
    points = neighbors.points
    return points[0, index], points[1, index], points[2, index], points[3, index]


@inlined
def add_point(neighbors, count, point):  # type: ignore[no-untyped-def]
    """Add a point, a tuple of four, with index ``count``."""
    for axis in range(4):
        neighbors.points[axis, count] = point[axis]
    if count == neighbors.bucket_threshold:
        for n in range(count):
            insert(neighbors.buckets, n, point_of(neighbors, n))
    if count >= neighbors.bucket_threshold:
        insert(neighbors.buckets, count, _float32(point))


@inlined
def nearest(neighbors, count, point):  # type: ignore[no-untyped-def]
    """Return the index of the nearest of the first ``count`` points, and the squared distance."""
    x = _float32(point)
    if count > neighbors.bucket_threshold:
        return nearest_in(neighbors.buckets, x)
    squared_distances(neighbors.points, _whole_groups(count), x, neighbors.squared)
    # non-negative floats are ordered like their bits, and LLVM vectorizes the minimum of integers
    bits, least, place = neighbors.squared_bits, np.int32(0x7F800000), 0
    for n in range(_whole_groups(count)):
        least = min(least, bits[n])
    mask = le_mask(bits, place, least)
    while not mask:
        place += GROUP
        mask = le_mask(bits, place, least)
    place += np.int64(ctz(mask))
    return place, neighbors.squared[place]


@inlined
def k_nearest(neighbors, count, point, k, guess, is_scanned):  # type: ignore[no-untyped-def]
    """Find at least the k nearest of the first ``count`` points, and at most k / 8 more, except for ties.

    The radius is enlarged until it holds k points, then narrowed by bisection on its square.

    Args:
        guess: squared radius to begin with.
        is_scanned: ``nearest`` was called for the same point before, so that ``squared`` is up to date.

    Returns:
        The number of points in ``found``, and the squared radius.
    """
    if count <= k:
        for n in range(count):
            neighbors.found[n] = n
        return count, guess
    x = _float32(point)
    if count <= neighbors.bucket_threshold and not is_scanned:
        squared_distances(neighbors.points, _whole_groups(count), x, neighbors.squared)
    limit = np.float32(guess)
    while True:
        size = _collect(neighbors, count, x, limit)
        if size >= k:
            break
        limit *= np.float32(min(max(1.2 * math.sqrt(k / max(size, 1)), 1.1), 4.0))
    found, found_squared = neighbors.found, neighbors.found_squared
    found_squared[size : size + GROUP] = np.inf
    low, high, inside, most = np.float32(0.0), limit, size, k + k // 8
    while inside > most:
        middle = np.float32(0.5) * (low + high)
        if low == 0.0:  # in four dimensions the count grows with the fourth power of the radius
            middle = high * np.float32(math.sqrt(0.5 * (k + most) / inside))
        if not low < middle < high:
            break
        n_within = 0
        for begin in range(0, size, GROUP):
            n_within += np.int64(popcount(le_mask(found_squared, begin, middle)))
        if n_within >= k:
            high, inside = middle, n_within
        else:
            low = middle
    kept = 0
    for n in range(size):
        found[kept] = found[n]
        kept += found_squared[n] <= high
    return kept, high


@inlined
def within(neighbors, count, point, squared_radius):  # type: ignore[no-untyped-def]
    """Find the points within a radius; return their number in ``found``."""
    x = _float32(point)
    if count <= neighbors.bucket_threshold:
        squared_distances(neighbors.points, _whole_groups(count), x, neighbors.squared)
    return _collect(neighbors, count, x, np.float32(squared_radius))


@inlined
def _collect(neighbors, count, x, limit):  # type: ignore[no-untyped-def]
    if count > neighbors.bucket_threshold:
        return collect(neighbors.buckets, x, limit, neighbors.found, neighbors.found_squared)
    size = 0
    for begin in range(0, count, GROUP):
        size = append_within(neighbors.squared, begin, limit, neighbors.found, neighbors.found_squared, size)
    return size


@inlined
def _whole_groups(count):  # type: ignore[no-untyped-def]
    return (count + GROUP - 1) // GROUP * GROUP
