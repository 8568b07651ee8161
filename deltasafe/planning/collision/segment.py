"""The straight segment between two poses (x, y, z, yaw), as tests go along it."""

import math

from deltasafe.compute.numba_cache import inlined

__all__ = ["in_order", "motion_m", "pose_at"]


@inlined
def in_order(first, second):  # type: ignore[no-untyped-def]
    """The two ends in an order that does not depend on which is named first: tests are symmetric."""
    for axis in range(4):
        if first[axis] != second[axis]:
            if first[axis] > second[axis]:
                return second, first
            break
    return first, second


@inlined
def motion_m(rho_max_m, start, end):  # type: ignore[no-untyped-def]
    """Bound of the way that any point of the body makes along a segment."""
    dx, dy, dz = end[0] - start[0], end[1] - start[1], end[2] - start[2]
    return math.sqrt(dx * dx + dy * dy + dz * dz) + rho_max_m * abs(end[3] - start[3])


@inlined
def pose_at(start, end, t):  # type: ignore[no-untyped-def]
    """The pose at a share t of the segment."""
    return (
        start[0] + t * (end[0] - start[0]),
        start[1] + t * (end[1] - start[1]),
        start[2] + t * (end[2] - start[2]),
        start[3] + t * (end[3] - start[3]),
    )
