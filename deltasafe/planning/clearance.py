"""How far a body is from the unsafe set: lower bounds, from one look-up to a cover of its disc by many balls."""

import math

import numpy as np

from deltasafe.compiling import kernel
from deltasafe.planning.field import FINE_UNIT_M, clearance_at, close_clearance_at, is_unsafe_at
from deltasafe.planning.surroundings import UNIT_M

__all__ = [
    "certified_clearance_m",
    "clearance_of_pose",
    "is_certified",
    "is_surely_unsafe",
    "level_clearance",
    "quick_clearance",
]


@kernel
def certified_clearance_m(around, x, y, z):  # type: ignore[no-untyped-def]
    """Lower bound of the body's clearance from the coarse grid alone; -inf where it says nothing."""
    nx, ny, nz = around.certificate.shape
    i = int(min(max((x - around.lattice.lower_x_m) * around.cells_per_m, 0.0), nx - 1.0))
    j = int(min(max((y - around.lattice.lower_y_m) * around.cells_per_m, 0.0), ny - 1.0))
    k = int(min(max((z - around.lattice.lower_z_m) * around.cells_per_m, 0.0), nz - 1.0))
    steps = around.certificate[i, j, k]
    return UNIT_M * (steps - 1.0) if steps > 0 else -np.inf


@kernel
def is_certified(around, x, y, z, need_m):  # type: ignore[no-untyped-def]
    """Whether the coarse grid alone shows that the body is clear by ``need_m``, however it is turned."""
    return certified_clearance_m(around, x, y, z) >= need_m


@kernel
def quick_clearance(around, body, x, y, z, yaw):  # type: ignore[no-untyped-def]
    """Lower bound of the body's clearance from one look-up a ball, in the disc's few balls and along the shaft."""
    lattice = around.lattice
    last_u, last_v, last_w = lattice.nx - 1.0, lattice.ny - 1.0, lattice.nz - 1.0
    u, v = (x - lattice.lower_x_m) * lattice.per_m, (y - lattice.lower_y_m) * lattice.per_m
    k = int(min(max((z - lattice.lower_z_m) * lattice.per_m, 0.0), last_w))
    i, j = int(min(max(u, 0.0), last_u)), int(min(max(v, 0.0), last_v))
    least_m = FINE_UNIT_M * (around.above[i, j, k] - 1.0) - body.shaft_radius_m
    cos, sin = math.cos(yaw), math.sin(yaw)
    for n in range(len(around.few)):
        a, b = around.few[n, 0], around.few[n, 1]
        i, j = int(min(max(u + cos * a - sin * b, 0.0), last_u)), int(min(max(v + sin * a + cos * b, 0.0), last_v))
        least_m = min(least_m, FINE_UNIT_M * (around.near[i, j, k] - 1.0) - around.few[n, 2])
    return min(least_m, z - body.half_thickness_m - around.floor_z_m)


@kernel
def level_clearance(around, body, x, y, z, yaw, enough_m, closely):  # type: ignore[no-untyped-def]
    """Lower bound of the way that the body may go sideways while it keeps its height up to ``slab_m``.

    -inf if it is not ``enough_m``. Each of the disc's few balls is seen from above, with all that is unsafe in the
    slices that it may meet; ``closely``, what that leaves open is settled by the ball's own part of the cover.
    """
    lattice = around.lattice
    last_u, last_v, last_w = lattice.nx - 1.0, lattice.ny - 1.0, lattice.nz - 1.0
    u, v = (x - lattice.lower_x_m) * lattice.per_m, (y - lattice.lower_y_m) * lattice.per_m
    k = int(min(max((z - lattice.lower_z_m) * lattice.per_m, 0.0), last_w))
    least_m = z - body.half_thickness_m - around.floor_z_m
    if body.shaft_radius_m > 0:
        i, j = int(min(max(u, 0.0), last_u)), int(min(max(v, 0.0), last_v))
        shaft_m = FINE_UNIT_M * (around.above[i, j, k] - 1.0)
        if closely and shaft_m - body.shaft_radius_m < enough_m:
            shaft_m = close_clearance_at(around.ray, lattice, x, y, z)
        least_m = min(least_m, shaft_m - body.shaft_radius_m)
    if least_m < enough_m:
        return -np.inf
    cos, sin = math.cos(yaw), math.sin(yaw)
    for n in range(len(around.few)):
        a, b = around.few[n, 0], around.few[n, 1]
        p, q = min(max(u + cos * a - sin * b, 0.0), last_u + 1), min(max(v + sin * a + cos * b, 0.0), last_v + 1)
        one_m = _seen_from_above(around, p, q, k, enough_m + around.few[n, 3]) - around.few[n, 3]
        if one_m < enough_m:
            if not closely:
                return -np.inf
            one_m = _clearance_of_group(around, n, x, y, z, cos, sin, enough_m) - around.groups[n, 4]
            if one_m < enough_m:
                one_m = _clearance_of_cover(around, n, x, y, z, cos, sin, enough_m, enough_m)
                if one_m < enough_m:
                    return -np.inf
        least_m = min(least_m, one_m)
    return least_m


@kernel
def _seen_from_above(around, p, q, k, enough_m):  # type: ignore[no-untyped-def]
    """Horizontal clearance of a point (p, q), in voxels, in slice k: from its own voxel, or from the best of four."""
    lattice, slabs = around.lattice, around.slabs
    i, j = min(int(p), lattice.nx - 1), min(int(q), lattice.ny - 1)
    du, dv = p - i - 0.5, q - j - 0.5
    best_m = FINE_UNIT_M * slabs[k, i, j] - lattice.voxel_m * math.sqrt(du * du + dv * dv)
    if best_m < enough_m:
        i2 = min(max(i + (1 if du > 0 else -1), 0), lattice.nx - 1)
        j2 = min(max(j + (1 if dv > 0 else -1), 0), lattice.ny - 1)
        eu, ev = p - i2 - 0.5, q - j2 - 0.5
        best_m = max(best_m, FINE_UNIT_M * slabs[k, i2, j] - lattice.voxel_m * math.sqrt(eu * eu + dv * dv))
        best_m = max(best_m, FINE_UNIT_M * slabs[k, i, j2] - lattice.voxel_m * math.sqrt(du * du + ev * ev))
        best_m = max(best_m, FINE_UNIT_M * slabs[k, i2, j2] - lattice.voxel_m * math.sqrt(eu * eu + ev * ev))
    return best_m


@kernel
def is_surely_unsafe(around, body, x, y, z, yaw):  # type: ignore[no-untyped-def]
    """Whether the centre or a vertex of the disc's ellipse is in an unsafe voxel: five look-ups, no bound."""
    if is_unsafe_at(around.ball, around.lattice, x, y, z):
        return True
    cos, sin = math.cos(yaw), math.sin(yaw)
    for sign in (-1.0, 1.0):
        u, v = sign * body.semi_axis_x_m, sign * body.semi_axis_y_m
        if is_unsafe_at(around.ball, around.lattice, x + cos * u, y + sin * u, z):
            return True
        if is_unsafe_at(around.ball, around.lattice, x - sin * v, y + cos * v, z):
            return True
    return False


@kernel
def clearance_of_pose(around, body, x, y, z, yaw):  # type: ignore[no-untyped-def]
    """Lower bound of the body's clearance, as close as there is: of the disc's lower face, the shaft, and the disc.

    The disc's is the best of its enclosing ball, its few balls and its cover.
    """
    others_m = z - body.half_thickness_m - around.floor_z_m
    others_m = min(others_m, close_clearance_at(around.ray, around.lattice, x, y, z) - body.shaft_radius_m)
    disc_m = clearance_at(around.ball, around.lattice, x, y, z) - body.disc_radius_m
    cos, sin = math.cos(yaw), math.sin(yaw)
    few_m, cover_m = np.inf, np.inf
    for n in range(len(around.groups)):
        centre_m = _clearance_of_group(around, n, x, y, z, cos, sin, np.inf)
        part_m = _clearance_of_cover(around, n, x, y, z, cos, sin, np.inf, -np.inf)
        few_m = min(few_m, centre_m - around.groups[n, 3])
        cover_m = min(cover_m, max(centre_m - around.groups[n, 4], part_m))
    return min(others_m, max(disc_m, few_m, cover_m))


@kernel
def _clearance_of_group(around, group, x, y, z, cos, sin, enough_m):  # type: ignore[no-untyped-def]
    """Clearance of a group's centre, no closer looked at than until its larger ball is clear by enough."""
    u, v, w = around.groups[group, 0], around.groups[group, 1], around.groups[group, 2]
    u, v, w = x + cos * u - sin * v, y + sin * u + cos * v, z + w
    centre_m = clearance_at(around.ball, around.lattice, u, v, w)
    if centre_m - around.groups[group, 4] < enough_m:
        centre_m = close_clearance_at(around.ball, around.lattice, u, v, w)
    return centre_m


@kernel
def _clearance_of_cover(around, group, x, y, z, cos, sin, enough_m, least_m):  # type: ignore[no-untyped-def]
    """Smallest clearance of a group's part of the cover, each ball no closer looked at than until it is enough."""
    clearance_m = np.inf
    for n in range(around.first[group], around.first[group + 1]):
        u, v, w, radius_m = around.cover[n, 0], around.cover[n, 1], around.cover[n, 2], around.cover[n, 3]
        u, v, w = x + cos * u - sin * v, y + sin * u + cos * v, z + w
        one_m = clearance_at(around.ball, around.lattice, u, v, w) - radius_m
        if one_m < enough_m:
            one_m = close_clearance_at(around.ball, around.lattice, u, v, w) - radius_m
        clearance_m = min(clearance_m, one_m)
        if clearance_m < least_m:
            return -np.inf
    return clearance_m
