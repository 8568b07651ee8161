"""A group of 64 distances at once: compared by vector units, the answers are the bits of a word."""

import numpy as np
from llvmlite import ir
from numba import types
from numba.extending import intrinsic

from deltasafe.compute.numba_cache import inlined

__all__ = ["GROUP", "at_most", "how_many", "lowest_bit", "measure", "put_near"]

GROUP = 64

FEW = 6
"""As many as most groups hold: written without asking whether there are so many, a branch that nothing predicts."""


@inlined
def measure(points, count, x, squared):  # type: ignore[no-untyped-def]
    """Squared distances of the first ``count`` points (4, n) to one, a tuple of four float32."""
    x0, x1, x2, x3 = x
    for n in range(count):
        d0, d1, d2, d3 = points[0, n] - x0, points[1, n] - x1, points[2, n] - x2, points[3, n] - x3
        squared[n] = d0 * d0 + d1 * d1 + d2 * d2 + d3 * d3


@inlined
def put_near(squared, begin, wide, found, gap, m):  # type: ignore[no-untyped-def]
    """What is at most ``wide`` of the group at ``begin``: into ``gap`` from m on, and its places into ``found``.

    Returns m and how many they are. ``FEW`` places from m on are overwritten in any case, and ``squared`` is read one
    place beyond the group.
    """
    chosen = at_most(squared, begin, wide)
    place, m = m, m + np.int64(how_many(chosen))
    for _ in range(FEW):
        chosen = _put_first(chosen, squared, begin, found, gap, place)
        place += 1
    while chosen:
        chosen = _put_first(chosen, squared, begin, found, gap, place)
        place += 1
    return m


@inlined
def _put_first(chosen, squared, begin, found, gap, place):  # type: ignore[no-untyped-def]
    n = begin + np.int64(lowest_bit(chosen))
    found[place], gap[place] = n, squared[n]
    return chosen & (chosen - np.uint64(1))


@intrinsic
def at_most(typing_context, values, begin, limit):  # type: ignore[no-untyped-def]
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
def how_many(typing_context, bits):  # type: ignore[no-untyped-def]
    """Number of bits that are set, of uint64."""

    def generate(context, builder, signature, arguments):  # type: ignore[no-untyped-def]
        return builder.ctpop(arguments[0])

    return types.uint64(types.uint64), generate


@intrinsic
def lowest_bit(typing_context, bits):  # type: ignore[no-untyped-def]
    """Place of the lowest bit that is set, of uint64; 64 if none is."""

    def generate(context, builder, signature, arguments):  # type: ignore[no-untyped-def]
        return builder.cttz(arguments[0], context.get_constant(types.boolean, 0))

    return types.uint64(types.uint64), generate
