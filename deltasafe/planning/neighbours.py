"""The k nearest nodes: one pass over all and a few counts that close in on a radius; a tree of buckets later."""

import math
from typing import NamedTuple

import numpy as np
from llvmlite import ir
from numba import types
from numba.extending import intrinsic
from numpy.typing import NDArray

from deltasafe.compiling import inlined
from deltasafe.planning.buckets import BucketTree, collect, empty_buckets, insert, nearest_in

__all__ = ["MANY", "Neighbours", "add_point", "empty_neighbours", "k_nearest", "nearest", "within"]

MANY = 3000
"""Beyond this many nodes the bucket tree is faster than looking at all."""

GROUP = 64
"""Points whose distances are compared at once."""

FEW = 6


class Neighbours(NamedTuple):
    """Points in scaled coordinates (4, n), and what a query needs room for.

    Places without a point are infinitely far, so that whole groups of 64 are looked at. ``squared`` distances and the
    same memory as integers, ``bits``; the candidates ``found`` with their ``gap``. ``reach``: squared radius of the
    near set that a point had when it came, for the number of points there are now: a guess for its neighbours.
    """

    points: NDArray[np.float32]
    squared: NDArray[np.float32]
    bits: NDArray[np.int32]
    reach: NDArray[np.float32]
    found: NDArray[np.int32]
    gap: NDArray[np.float32]
    buckets: BucketTree
    many: int


def empty_neighbours(capacity: int, many: int = MANY) -> Neighbours:
    """Room for ``capacity`` points; beyond ``many`` the bucket tree is used. Both give the same neighbours."""
    groups = -(-capacity // GROUP)
    squared = np.empty(GROUP * (groups + 1), np.float32)
    return Neighbours(
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
    _measure(known, count, x)
    # the bits of floats that are not negative are ordered as they are, and vector units find the least integer
    bits, least, place = known.bits, np.int32(0x7F800000), 0
    for n in range(_in_groups(count)):
        least = min(least, bits[n])
    chosen = _at_most(bits, place, least)
    while not chosen:
        place += GROUP
        chosen = _at_most(bits, place, least)
    place += np.int64(_lowest_bit(chosen))
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
        _measure(known, count, x)
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
            some += np.int64(_how_many(_at_most(known.gap, begin, middle)))
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
        _measure(known, count, x)
    return _candidates(known, count, x, np.float32(squared_radius))


@inlined
def _candidates(known, count, x, wide):  # type: ignore[no-untyped-def]
    if count > known.many:
        return collect(known.buckets, x, wide, known.found, known.gap)
    found, gap, squared, m = known.found, known.gap, known.squared, 0
    for begin in range(0, count, GROUP):
        chosen = _at_most(squared, begin, wide)
        place, m = m, m + np.int64(_how_many(chosen))
        for _ in range(FEW):  # as many as most groups have, without asking whether there are so many
            n = begin + np.int64(_lowest_bit(chosen))
            found[place], gap[place] = n, squared[n]
            place += 1
            chosen &= chosen - np.uint64(1)
        while chosen:
            n = begin + np.int64(_lowest_bit(chosen))
            found[place], gap[place] = n, squared[n]
            place += 1
            chosen &= chosen - np.uint64(1)
    return m


@inlined
def _in_groups(count):  # type: ignore[no-untyped-def]
    """The next multiple of a group."""
    return (count + GROUP - 1) // GROUP * GROUP


@intrinsic
def _at_most(typing_context, values, begin, limit):  # type: ignore[no-untyped-def]
    """Which of a group of values (float32 or int32), from ``begin`` on, are at most ``limit``: a bit each, uint64."""

    def generate(context, builder, signature, arguments):  # type: ignore[no-untyped-def]
        array = context.make_array(values)(context, builder, arguments[0])
        many = ir.VectorType(array.data.type.pointee, GROUP)
        place = builder.bitcast(builder.gep(array.data, [arguments[1]]), many.as_pointer())
        lanes = builder.load(place, align=4)
        one = builder.insert_element(ir.Constant(many, ir.Undefined), arguments[2], ir.IntType(32)(0))
        zeros = ir.Constant(ir.VectorType(ir.IntType(32), GROUP), [0] * GROUP)
        limits = builder.shuffle_vector(one, ir.Constant(many, ir.Undefined), zeros)
        compare = builder.fcmp_ordered if isinstance(values.dtype, types.Float) else builder.icmp_signed
        return builder.bitcast(compare("<=", lanes, limits), ir.IntType(64))

    return types.uint64(values, types.int64, values.dtype), generate


@intrinsic
def _how_many(typing_context, bits):  # type: ignore[no-untyped-def]
    """Number of bits that are set, of uint64."""

    def generate(context, builder, signature, arguments):  # type: ignore[no-untyped-def]
        return builder.ctpop(arguments[0])

    return types.uint64(types.uint64), generate


@intrinsic
def _lowest_bit(typing_context, bits):  # type: ignore[no-untyped-def]
    """Place of the lowest bit that is set, of uint64; 64 if none is."""

    def generate(context, builder, signature, arguments):  # type: ignore[no-untyped-def]
        return builder.cttz(arguments[0], context.get_constant(types.boolean, 0))

    return types.uint64(types.uint64), generate


@inlined
def _measure(known, count, x):  # type: ignore[no-untyped-def]
    x0, x1, x2, x3 = x
    points, squared = known.points, known.squared
    for n in range(_in_groups(count)):
        d0, d1, d2, d3 = points[0, n] - x0, points[1, n] - x1, points[2, n] - x2, points[3, n] - x3
        squared[n] = d0 * d0 + d1 * d1 + d2 * d2 + d3 * d3
