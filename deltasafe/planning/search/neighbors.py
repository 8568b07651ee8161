"""The k nearest nodes: one pass over all and a few counts that close in on a radius; a tree of buckets later."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from deltasafe.compute.numba_cache import inlined
from deltasafe.planning.search.bucket_tree import BucketTree, collect, empty_buckets, insert, nearest_in
from deltasafe.planning.search.simd_groups import GROUP, at_most, how_many, lowest_bit, measure, put_near

__all__ = ["MANY", "Neighbors", "add_point", "empty_neighbors", "k_nearest", "nearest", "within"]

MANY = 4500
"""Beyond this many nodes the bucket tree is faster than looking at all."""


class Neighbors(NamedTuple):
    """Points in scaled coordinates (4, n), and what a query needs room for.

    Places without a point are infinitely far, so that whole groups of 64 are looked at. ``squared`` distances and the
    same memory as integers, ``bits``; the candidates ``found`` with their ``gap``. ``reach``: squared radius of the
    near set that a point had when it came, for the number of points there are now: a guess for its neighbors.
    """

    points: NDArray[np.float32]
    squared: NDArray[np.float32]
    bits: NDArray[np.int32]
    reach: NDArray[np.float32]
    found: NDArray[np.int32]
    gap: NDArray[np.float32]
    buckets: BucketTree
    many: int


def empty_neighbors(capacity: int, many: int = MANY) -> Neighbors:
    """Room for ``capacity`` points; beyond ``many`` the bucket tree is used. Both give the same neighbors."""
    groups = -(-capacity // GROUP)
    squared = np.empty(GROUP * (groups + 1), np.float32)
    return Neighbors(
        np.full((4, GROUP * groups), np.inf, np.float32),
        squared,
        squared.view(np.int32),
        np.empty(capacity, np.float32),
        np.empty(capacity + 1 + GROUP, np.int32),
        np.empty(capacity + 1 + GROUP, np.float32),
        empty_buckets(capacity if capacity > many else 1),
        many,
    )


@inlined
def add_point(known, count, point):  # type: ignore[no-untyped-def]
    """Point number ``count``, a tuple of four."""
    for axis in range(4):
        known.points[axis, count] = point[axis]
    if count == known.many:  # from now on in buckets, those before included
        for n in range(count):
            insert(known.buckets, n, (known.points[0, n], known.points[1, n], known.points[2, n], known.points[3, n]))
    if count >= known.many:
        x = np.float32(point[0]), np.float32(point[1]), np.float32(point[2]), np.float32(point[3])
        insert(known.buckets, count, x)


@inlined
def nearest(known, count, point):  # type: ignore[no-untyped-def]
    """Index of the nearest of the first ``count`` points, and the squared distance."""
    x = np.float32(point[0]), np.float32(point[1]), np.float32(point[2]), np.float32(point[3])
    if count > known.many:
        return nearest_in(known.buckets, x)
    measure(known.points, _in_groups(count), x, known.squared)
    # the bits of floats that are not negative are ordered as they are, and vector units find the least integer
    bits, least, place = known.bits, np.int32(0x7F800000), 0
    for n in range(_in_groups(count)):
        least = min(least, bits[n])
    chosen = at_most(bits, place, least)
    while not chosen:
        place += GROUP
        chosen = at_most(bits, place, least)
    place += np.int64(lowest_bit(chosen))
    return place, known.squared[place]


@inlined
def k_nearest(known, count, point, k, guess, measured):  # type: ignore[no-untyped-def]
    """At least the k nearest of the first ``count`` points, in ``known.found``; their number and the squared radius.

    All points within a radius, which is looked for until it holds no more than an eighth too many. ``guess`` is a
    squared radius to begin with. ``measured`` says that ``nearest`` was asked for the same point before.
    """
    if count <= k:
        for n in range(count):
            known.found[n] = n
        return count, guess
    x = np.float32(point[0]), np.float32(point[1]), np.float32(point[2]), np.float32(point[3])
    if count <= known.many and not measured:
        measure(known.points, _in_groups(count), x, known.squared)
    wide = np.float32(guess)
    while True:
        m = _candidates(known, count, x, wide)
        if m >= k:
            break
        wide *= np.float32(min(max(1.2 * math.sqrt(k / max(m, 1)), 1.1), 4.0))
    known.gap[m : m + GROUP] = np.inf
    low, high, inside, most = np.float32(0.0), wide, m, k + k // 8
    while inside > most:
        middle = np.float32(0.5) * (low + high)
        if low == 0.0:  # in four dimensions the count grows with the fourth power of the radius
            middle = high * np.float32(math.sqrt(0.5 * (k + most) / inside))
        if not low < middle < high:
            break
        some = 0
        for begin in range(0, m, GROUP):
            some += np.int64(how_many(at_most(known.gap, begin, middle)))
        if some >= k:
            high, inside = middle, some
        else:
            low = middle
    kept = 0
    for n in range(m):
        known.found[kept] = known.found[n]
        kept += known.gap[n] <= high
    return kept, high


@inlined
def within(known, count, point, squared_radius):  # type: ignore[no-untyped-def]
    """The points within a radius, in ``known.found``; returns how many."""
    x = np.float32(point[0]), np.float32(point[1]), np.float32(point[2]), np.float32(point[3])
    if count <= known.many:
        measure(known.points, _in_groups(count), x, known.squared)
    return _candidates(known, count, x, np.float32(squared_radius))


@inlined
def _candidates(known, count, x, wide):  # type: ignore[no-untyped-def]
    if count > known.many:
        return collect(known.buckets, x, wide, known.found, known.gap)
    m = 0
    for begin in range(0, count, GROUP):
        m = put_near(known.squared, begin, wide, known.found, known.gap, m)
    return m


@inlined
def _in_groups(count):  # type: ignore[no-untyped-def]
    """The next multiple of a group."""
    return (count + GROUP - 1) // GROUP * GROUP
