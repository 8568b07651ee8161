"""How far a body is from the unsafe set: lower bounds, from one look-up to a cover of its disc by many balls."""

import math

import numpy as np

from deltasafe.compute.numba_cache import inlined, kernel
from deltasafe.planning.collision.distance_field import (
    FINE_UNIT_M,
    SLAB_REACH_M,
    clearance_at,
    close_clearance_at,
    voxel_of,
)

__all__ = [
    "clearance_of_pose",
    "is_surely_unsafe",
    "level_clearance",
]


@inlined
def level_clearance(around, body, x, y, z, yaw, enough_m, height_m):  # type: ignore[no-untyped-def]
    """Lower bound of the way that the body may go sideways; -inf if it is not ``enough_m``.

    Each of the disc's few balls is seen from above, with all that is unsafe in the slices that it may meet while it
    keeps its height up to ``slab_m``; what that leaves open is settled by no more slices than it meets within
    ``height_m`` above and below.
    """
    lattice = around.lattice
    if enough_m + around.widest_m > SLAB_REACH_M + lattice.voxel_m:  # farther than is seen
        return -np.inf
    last_u, last_v, last_w = lattice.nx - 1.0, lattice.ny - 1.0, lattice.nz - 1.0
    u, v = (x - lattice.lower_x_m) * lattice.per_m, (y - lattice.lower_y_m) * lattice.per_m
    w = (z - lattice.lower_z_m) * lattice.per_m
    k = int(min(max(w, 0.0), last_w))
    least_m = z - body.half_thickness_m - around.floor_z_m
    if body.shaft_radius_m > 0:
        i, j = int(min(max(u, 0.0), last_u)), int(min(max(v, 0.0), last_v))
        shaft_m = FINE_UNIT_M * (around.above[i, j, k] - 1.0)
        if shaft_m - body.shaft_radius_m < enough_m:
            shaft_m = close_clearance_at(around.ray, lattice, x, y, z)
        least_m = min(least_m, shaft_m - body.shaft_radius_m)
    if least_m < enough_m:
        return -np.inf
    cos, sin = math.cos(yaw), math.sin(yaw)
    lowest = int(min(max(w - height_m * lattice.per_m, 0.0), last_w))
    highest = int(min(max(w + height_m * lattice.per_m, 0.0), last_w))
    for n in range(len(around.few)):
        a, b = around.few[n, 0], around.few[n, 1]
        p, q = min(max(u + cos * a - sin * b, 0.0), last_u + 1), min(max(v + sin * a + cos * b, 0.0), last_v + 1)
        one_m = _seen_from_above(around, p, q, k, enough_m + around.few[n, 2]) - around.few[n, 2]
        if one_m < enough_m:
            one_m = _seen_in_slices(around, p, q, lowest, highest) - around.few[n, 2]
            if one_m < enough_m:
                return -np.inf
        least_m = min(least_m, one_m)
    return least_m


@inlined
def _seen_from_above(around, p, q, k, enough_m):  # type: ignore[no-untyped-def]
    """Horizontal clearance of a point (p, q), in voxels, in slice k: from its own voxel, or from the best of four."""
    lattice, slabs = around.lattice, around.slabs
    i, j = min(int(p), lattice.nx - 1), min(int(q), lattice.ny - 1)
    du, dv = p - i - 0.5, q - j - 0.5
    best_m = FINE_UNIT_M * slabs[i, j, k] - lattice.voxel_m * math.sqrt(du * du + dv * dv)
    if best_m < enough_m:
        i2 = min(max(i + (1 if du > 0 else -1), 0), lattice.nx - 1)
        j2 = min(max(j + (1 if dv > 0 else -1), 0), lattice.ny - 1)
        eu, ev = p - i2 - 0.5, q - j2 - 0.5
        best_m = max(best_m, FINE_UNIT_M * slabs[i2, j, k] - lattice.voxel_m * math.sqrt(eu * eu + dv * dv))
        best_m = max(best_m, FINE_UNIT_M * slabs[i, j2, k] - lattice.voxel_m * math.sqrt(du * du + ev * ev))
        best_m = max(best_m, FINE_UNIT_M * slabs[i2, j2, k] - lattice.voxel_m * math.sqrt(eu * eu + ev * ev))
    return best_m


@inlined
def _seen_in_slices(around, p, q, lowest, highest):  # type: ignore[no-untyped-def]
    """Horizontal clearance of a point (p, q), in voxels, in some slices: the best of four voxels."""
    lattice, slices = around.lattice, around.slices
    i = min(max(int(p - 0.5), 0), lattice.nx - 2)
    j = min(max(int(q - 0.5), 0), lattice.ny - 2)
    du, dv = p - 0.5 - i, q - 0.5 - j
    eu, ev = 1 - du, 1 - dv
    first = last = across = beyond = 255
    for k in range(lowest, highest + 1):  # without a branch, vector units take all four roots at once
        first, across = min(first, slices[i, j, k]), min(across, slices[i + 1, j, k])
        last, beyond = min(last, slices[i, j + 1, k]), min(beyond, slices[i + 1, j + 1, k])
    first_m = FINE_UNIT_M * first - lattice.voxel_m * math.sqrt(du * du + dv * dv)
    last_m = FINE_UNIT_M * last - lattice.voxel_m * math.sqrt(du * du + ev * ev)
    across_m = FINE_UNIT_M * across - lattice.voxel_m * math.sqrt(eu * eu + dv * dv)
    beyond_m = FINE_UNIT_M * beyond - lattice.voxel_m * math.sqrt(eu * eu + ev * ev)
    return max(first_m, last_m, across_m, beyond_m)


@inlined
def is_surely_unsafe(around, body, x, y, z, yaw):  # type: ignore[no-untyped-def]
    """Whether the center or a vertex of the disc's ellipse is in an unsafe voxel: five look-ups, no bound."""
    if _is_unsafe_at(around, x, y, z):
        return True
    cos, sin = math.cos(yaw), math.sin(yaw)
    for sign in (-1.0, 1.0):
        u, v = sign * body.semi_axis_x_m, sign * body.semi_axis_y_m
        if _is_unsafe_at(around, x + cos * u, y + sin * u, z):
            return True
        if _is_unsafe_at(around, x - sin * v, y + cos * v, z):
            return True
    return False


@inlined
def _is_unsafe_at(around, x, y, z):  # type: ignore[no-untyped-def]
    """Whether a point lies in an unsafe voxel, or beside the field."""
    i, j, k = voxel_of(around.lattice, x, y, z)
    return (around.unsafe[i, j, k >> 5] >> (k & 31)) & 1 == 1


@kernel
def clearance_of_pose(around, body, x, y, z, yaw):  # type: ignore[no-untyped-def]
    """Lower bound of the body's clearance, as close as there is: of the disc's lower face, the shaft, and the disc.

    The disc's is the best of its enclosing ball, its few balls and its cover.
    """
    others_m = z - body.half_thickness_m - around.floor_z_m
    others_m = min(others_m, close_clearance_at(around.ray, around.lattice, x, y, z) - body.shaft_radius_m)
    disc_m = clearance_at(around.ball, around.lattice, x, y, z) - body.disc_radius_m
    if disc_m >= others_m:
        return others_m
    cos, sin = math.cos(yaw), math.sin(yaw)
    few_m, outer_m = np.inf, np.inf
    for n in range(len(around.groups)):
        center_m = _clearance_of_center(around, n, x, y, z, cos, sin)
        few_m, outer_m = min(few_m, center_m - around.groups[n, 3]), min(outer_m, center_m - around.groups[n, 4])
    least_m, cover_m = max(disc_m, few_m, outer_m), others_m
    for n in range(len(around.groups)):  # only where the cover may say more than is known, and less than the others
        outer_m = _clearance_of_center(around, n, x, y, z, cos, sin) - around.groups[n, 4]
        known_m = max(least_m, outer_m)
        if cover_m > known_m:
            cover_m = min(cover_m, max(outer_m, _clearance_of_cover(around, n, x, y, z, cos, sin, known_m)))
        if cover_m <= least_m:
            break
    return min(others_m, max(least_m, cover_m))


@kernel
def _clearance_of_center(around, group, x, y, z, cos, sin):  # type: ignore[no-untyped-def]
    u, v, w = around.groups[group, 0], around.groups[group, 1], around.groups[group, 2]
    return close_clearance_at(around.ball, around.lattice, x + cos * u - sin * v, y + sin * u + cos * v, z + w)


@kernel
def _clearance_of_cover(around, group, x, y, z, cos, sin, least_m):  # type: ignore[no-untyped-def]
    """Smallest clearance of a group's part of the cover; any that is no more than ``least_m`` will do."""
    clearance_m = np.inf
    for n in range(around.first[group], around.first[group + 1]):
        u, v, w, radius_m = around.cover[n, 0], around.cover[n, 1], around.cover[n, 2], around.cover[n, 3]
        u, v, w = x + cos * u - sin * v, y + sin * u + cos * v, z + w
        clearance_m = min(clearance_m, close_clearance_at(around.ball, around.lattice, u, v, w) - radius_m)
        if clearance_m <= least_m:
            break
    return clearance_m
