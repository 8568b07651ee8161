"""Lower bounds of the distance from a body to the unsafe set, from single look-ups to a tight cover of its disc."""

import math

import numpy as np

from deltasafe.compute.numba_cache import inlined, kernel
from deltasafe.planning.collision.distance_field import (
    FINE_UNIT_M,
    SLAB_REACH_M,
    tight_clearance_at,
    voxel_clearance_at,
    voxel_of,
)


@inlined
def level_clearance(arrays, body, pose, needed_m, height_m):  # type: ignore[no-untyped-def]
    """Lower bound of the clearance of a body that moves horizontally; -inf if it is less than ``needed_m``.

    Each circle of the disc is looked up in ``slab_distance`` first. That table covers all slices that the body reaches
    while its height changes by at most ``slab_rise_m``. If its bound is too small, only the slices within ``height_m``
    above and below the center are read.
    """
    lattice = arrays.lattice
    x, y, z, yaw = pose
    if needed_m + arrays.max_circle_radius_m > SLAB_REACH_M + lattice.voxel_m:  # beyond the reach of the tables
        return -np.inf
    last_u, last_v, last_w = lattice.nx - 1.0, lattice.ny - 1.0, lattice.nz - 1.0
    u, v = (x - lattice.lower_x_m) * lattice.per_m, (y - lattice.lower_y_m) * lattice.per_m
    w = (z - lattice.lower_z_m) * lattice.per_m
    k = int(min(max(w, 0.0), last_w))
    least_m = z - body.half_thickness_m - arrays.table_z_m
    if body.shaft_radius_m > 0:
        i, j = int(min(max(u, 0.0), last_u)), int(min(max(v, 0.0), last_v))
        shaft_m = FINE_UNIT_M * (arrays.ray_clearance[i, j, k] - 1.0)
        if shaft_m - body.shaft_radius_m < needed_m:
            shaft_m = tight_clearance_at(arrays.squared_ray_distance, lattice, x, y, z)
        least_m = min(least_m, shaft_m - body.shaft_radius_m)
    if least_m < needed_m:
        return -np.inf
    cos, sin = math.cos(yaw), math.sin(yaw)
    lowest = int(min(max(w - height_m * lattice.per_m, 0.0), last_w))
    highest = int(min(max(w + height_m * lattice.per_m, 0.0), last_w))
    for n in range(len(arrays.circles)):
        a, b, radius_m = arrays.circles[n, 0], arrays.circles[n, 1], arrays.circles[n, 2]
        p, q = min(max(u + cos * a - sin * b, 0.0), last_u + 1), min(max(v + sin * a + cos * b, 0.0), last_v + 1)
        circle_m = _clearance_in_slab(arrays, p, q, k, needed_m + radius_m) - radius_m
        if circle_m < needed_m:
            circle_m = _clearance_in_slices(arrays, p, q, lowest, highest) - radius_m
            if circle_m < needed_m:
                return -np.inf
        least_m = min(least_m, circle_m)
    return least_m


@inlined
def _clearance_in_slab(arrays, p, q, k, needed_m):  # type: ignore[no-untyped-def]
    """Horizontal clearance of a point (p, q) in voxels in the slab of slice k: by its own voxel, else the best of 4."""
    lattice, distance = arrays.lattice, arrays.slab_distance
    i, j = min(int(p), lattice.nx - 1), min(int(q), lattice.ny - 1)
    du, dv = p - i - 0.5, q - j - 0.5
    best_m = FINE_UNIT_M * distance[i, j, k] - lattice.voxel_m * math.sqrt(du * du + dv * dv)
    if best_m < needed_m:
        i2 = min(max(i + (1 if du > 0 else -1), 0), lattice.nx - 1)
        j2 = min(max(j + (1 if dv > 0 else -1), 0), lattice.ny - 1)
        eu, ev = p - i2 - 0.5, q - j2 - 0.5
        best_m = max(best_m, FINE_UNIT_M * distance[i2, j, k] - lattice.voxel_m * math.sqrt(eu * eu + dv * dv))
        best_m = max(best_m, FINE_UNIT_M * distance[i, j2, k] - lattice.voxel_m * math.sqrt(du * du + ev * ev))
        best_m = max(best_m, FINE_UNIT_M * distance[i2, j2, k] - lattice.voxel_m * math.sqrt(eu * eu + ev * ev))
    return best_m


@inlined
def _clearance_in_slices(arrays, p, q, lowest, highest):  # type: ignore[no-untyped-def]
    """Horizontal clearance of a point (p, q) in voxels in a range of slices: the best of the four voxels around it."""
    lattice, distance = arrays.lattice, arrays.slice_distance
    i = min(max(int(p - 0.5), 0), lattice.nx - 2)
    j = min(max(int(q - 0.5), 0), lattice.ny - 2)
    du, dv = p - 0.5 - i, q - 0.5 - j
    eu, ev = 1 - du, 1 - dv
    d00 = d01 = d10 = d11 = 255
    for k in range(lowest, highest + 1):
        d00, d10 = min(d00, distance[i, j, k]), min(d10, distance[i + 1, j, k])
        d01, d11 = min(d01, distance[i, j + 1, k]), min(d11, distance[i + 1, j + 1, k])
    # no branches: the compiler vectorizes the four square roots
    c00_m = FINE_UNIT_M * d00 - lattice.voxel_m * math.sqrt(du * du + dv * dv)
    c01_m = FINE_UNIT_M * d01 - lattice.voxel_m * math.sqrt(du * du + ev * ev)
    c10_m = FINE_UNIT_M * d10 - lattice.voxel_m * math.sqrt(eu * eu + dv * dv)
    c11_m = FINE_UNIT_M * d11 - lattice.voxel_m * math.sqrt(eu * eu + ev * ev)
    return max(c00_m, c01_m, c10_m, c11_m)


@inlined
def is_surely_unsafe(arrays, pose):  # type: ignore[no-untyped-def]
    """Return whether a probe, such as the center or a vertex of the ellipse, lies in an unsafe voxel; no margin."""
    x, y, z, yaw = pose
    cos, sin = math.cos(yaw), math.sin(yaw)
    for n in range(len(arrays.probes)):
        u, v, w = arrays.probes[n, 0], arrays.probes[n, 1], arrays.probes[n, 2]
        if _is_unsafe_at(arrays, x + cos * u - sin * v, y + sin * u + cos * v, z + w):
            return True
    return False


@inlined
def _is_unsafe_at(arrays, x, y, z):  # type: ignore[no-untyped-def]
    """Return whether a point lies in an unsafe voxel, or beside the field."""
    i, j, k = voxel_of(arrays.lattice, x, y, z)
    return (arrays.unsafe_bits[i, j, k >> 5] >> (k & 31)) & 1 == 1


@kernel
def clearance_of_pose(arrays, body, pose):  # type: ignore[no-untyped-def]
    """Tightest lower bound of the body's clearance: the smallest of the bounds of table, shaft and disc.

    The bound of the disc is the best of its enclosing ball, its bounding balls and its cover.
    """
    x, y, z, yaw = pose
    others_m = z - body.half_thickness_m - arrays.table_z_m
    shaft_m = tight_clearance_at(arrays.squared_ray_distance, arrays.lattice, x, y, z) - body.shaft_radius_m
    others_m = min(others_m, shaft_m)
    disc_m = voxel_clearance_at(arrays.squared_distance, arrays.lattice, x, y, z) - body.disc_radius_m
    if disc_m >= others_m:
        return others_m
    frame = x, y, z, math.cos(yaw), math.sin(yaw)
    balls_m, outer_m = np.inf, np.inf
    for n in range(len(arrays.balls)):
        center_m = _clearance_at_center(arrays, arrays.balls[n], frame)
        balls_m, outer_m = min(balls_m, center_m - arrays.balls[n, 3]), min(outer_m, center_m - arrays.balls[n, 4])
    least_m, cover_m = max(disc_m, balls_m, outer_m), others_m
    for n in range(len(arrays.balls)):
        outer_m = _clearance_at_center(arrays, arrays.balls[n], frame) - arrays.balls[n, 4]
        known_m = max(least_m, outer_m)
        if cover_m > known_m:  # else this group of the cover cannot improve the bound
            cover_m = min(cover_m, max(outer_m, _clearance_of_group(arrays, n, frame, known_m)))
        if cover_m <= least_m:
            break
    return min(others_m, max(least_m, cover_m))


@kernel
def _clearance_of_group(arrays, group, frame, enough_m):  # type: ignore[no-untyped-def]
    """Smallest clearance of one group of the cover; stops at the first one that is at most ``enough_m``."""
    clearance_m = np.inf
    for n in range(arrays.group_start[group], arrays.group_start[group + 1]):
        clearance_m = min(clearance_m, _clearance_at_center(arrays, arrays.cover[n], frame) - arrays.cover[n, 3])
        if clearance_m <= enough_m:
            break
    return clearance_m


@kernel
def _clearance_at_center(arrays, ball, frame):  # type: ignore[no-untyped-def]
    """Clearance of the center of a ball (u, v, w, ...) of the body in the frame (x, y, z, cos yaw, sin yaw)."""
    x, y, z, cos, sin = frame
    u, v, w = ball[0], ball[1], ball[2]
    x, y, z = x + cos * u - sin * v, y + sin * u + cos * v, z + w
    return tight_clearance_at(arrays.squared_distance, arrays.lattice, x, y, z)
