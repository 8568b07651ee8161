"""Operations on groups of 64 distances: one comparison gives a bit mask, and the set bits are then visited.

numba does not vectorize loops that compact an array. ``le_mask`` is therefore written in LLVM IR: one load of a vector
of 64 lanes, one comparison, and a bit cast of the 64 booleans to an integer. LLVM splits these operations into what the
CPU has. It emits 4 comparisons with AVX-512, 8 with AVX2, 16 with SSE2 or NEON, and 64 scalar comparisons on a CPU
without vector registers. ``popcount`` and ``ctz`` become one instruction, or a short sequence of shifts and masks.

Only the speed depends on the CPU: comparisons do not round, and no sum is reordered, so that the results are the same.
"""

import numpy as np
from llvmlite import ir
from numba import types
from numba.extending import intrinsic

from deltasafe.compute.numba_cache import inlined

GROUP = 64
"""Values per group: one bit each in a word."""

UNROLLED = 6
"""Most groups hold at most so many hits: these are written without a loop condition, which is mispredicted often."""


@inlined
def squared_distances(points, count, x, squared):  # type: ignore[no-untyped-def]
    """Write the squared distances of the first ``count`` points (4, n) to a point x, a tuple of four float32."""
    x0, x1, x2, x3 = x
    for n in range(count):
        d0, d1, d2, d3 = points[0, n] - x0, points[1, n] - x1, points[2, n] - x2, points[3, n] - x3
        squared[n] = d0 * d0 + d1 * d1 + d2 * d2 + d3 * d3


@inlined
def append_within(squared, begin, limit, indices, values, size):  # type: ignore[no-untyped-def]
    """Append the indices and values of the group at ``begin`` that are at most ``limit``; return the new size.

    ``UNROLLED`` places after ``size`` are overwritten in any case, and ``squared`` is read one place beyond the group.
    """
    mask = le_mask(squared, begin, limit)
    place, size = size, size + np.int64(popcount(mask))
    for _ in range(UNROLLED):
        mask = _put_lowest(mask, squared, begin, indices, values, place)
        place += 1
    while mask:
        mask = _put_lowest(mask, squared, begin, indices, values, place)
        place += 1
    return size


@inlined
def _put_lowest(mask, squared, begin, indices, values, place):  # type: ignore[no-untyped-def]
    """Write the entry of the lowest set bit, and return the mask without that bit."""
    n = begin + np.int64(ctz(mask))
    indices[place], values[place] = n, squared[n]
    return mask & (mask - np.uint64(1))


@intrinsic
def le_mask(typing_context, values, begin, limit):  # type: ignore[no-untyped-def]
    """Compare 64 values (float32 or int32) from ``begin`` on; bit n of the uint64 is set if value n <= ``limit``."""

    def generate(context, builder, signature, arguments):  # type: ignore[no-untyped-def]
        array = context.make_array(values)(context, builder, arguments[0])
        vector = ir.VectorType(array.data.type.pointee, GROUP)
        address = builder.bitcast(builder.gep(array.data, [arguments[1]]), vector.as_pointer())
        lanes = builder.load(address, align=4)
        # broadcast the limit: insert it into lane 0, then shuffle lane 0 to all lanes
        first_lane = builder.insert_element(ir.Constant(vector, ir.Undefined), arguments[2], ir.IntType(32)(0))
        zeros = ir.Constant(ir.VectorType(ir.IntType(32), GROUP), [0] * GROUP)
        limits = builder.shuffle_vector(first_lane, ir.Constant(vector, ir.Undefined), zeros)
        compare = builder.fcmp_ordered if isinstance(values.dtype, types.Float) else builder.icmp_signed
        return builder.bitcast(compare("<=", lanes, limits), ir.IntType(64))

    return types.uint64(values, types.int64, values.dtype), generate


@intrinsic
def popcount(typing_context, bits):  # type: ignore[no-untyped-def]
    """Number of set bits of a uint64."""

    def generate(context, builder, signature, arguments):  # type: ignore[no-untyped-def]
        return builder.ctpop(arguments[0])

    return types.uint64(types.uint64), generate


@intrinsic
def ctz(typing_context, bits):  # type: ignore[no-untyped-def]
    """Number of trailing zeros of a uint64, which is the index of its lowest set bit; 64 for zero."""

    def generate(context, builder, signature, arguments):  # type: ignore[no-untyped-def]
        return builder.cttz(arguments[0], context.get_constant(types.boolean, 0))

    return types.uint64(types.uint64), generate
