"""Geometry of the straight segment between two poses, tuples (x, y, z, yaw)."""

import math

from deltasafe.compute.numba_cache import inlined


@inlined
def in_order(first, second):  # type: ignore[no-untyped-def]
    """Order both ends lexicographically, so that tests give the same answer in both directions."""
    for axis in range(4):
        if first[axis] != second[axis]:
            if first[axis] > second[axis]:
                return second, first
            break
    return first, second


@inlined
def motion_m(rho_max_m, start, end):  # type: ignore[no-untyped-def]
    """Upper bound of the path length of any point of the body along a segment."""
    dx, dy, dz = end[0] - start[0], end[1] - start[1], end[2] - start[2]
    return math.sqrt(dx * dx + dy * dy + dz * dz) + rho_max_m * abs(end[3] - start[3])


@inlined
def pose_at(start, end, fraction):  # type: ignore[no-untyped-def]
    """Interpolate linearly between two poses."""
    return (
        start[0] + fraction * (end[0] - start[0]),
        start[1] + fraction * (end[1] - start[1]),
        start[2] + fraction * (end[2] - start[2]),
        start[3] + fraction * (end[3] - start[3]),
    )
