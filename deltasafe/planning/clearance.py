"""How far a body is from the unsafe set: bounds from the coarsest, one look-up, to the finest, a cover of its disc."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from deltasafe.compiling import compiled, kernel
from deltasafe.planning.body import ToolBody
from deltasafe.planning.field import Lattice, SafetyField, clearance_at, close_clearance_at, is_unsafe_at

__all__ = [
    "BodyNumbers",
    "Surroundings",
    "certified_clearance_m",
    "clearance_of_pose",
    "is_certified",
    "is_surely_unsafe",
    "surroundings_of",
]

UNIT_M = 0.0005
"""Resolution of the certificate: 255 steps reach 127 mm."""

NO_SHAFT_M = -1e6


class BodyNumbers(NamedTuple):
    """The numbers of a tool's body."""

    disc_radius_m: float
    half_thickness_m: float
    shaft_radius_m: float
    rho_max_m: float
    semi_axis_x_m: float
    semi_axis_y_m: float


class Surroundings(NamedTuple):
    """A field as a body meets it.

    Attributes:
        certificate: (cx, cy, cz) uint8, the distance certificate: v > 0 says that the body is clear by v - 1 units
            wherever in the cell its centre is and however it is turned; 0 says nothing.
        ball, ray: squared distances (``FieldArrays``).
        groups: (m, 5) few balls that contain the disc, tight in its plane: centre, radius, and the radius that also
            contains the balls of the cover given to it; cover: (n, 4) many balls that contain the disc closely, by
            group; first: (m + 1,) where in the cover each group begins.
        lattice: of ``ball`` and ``ray``; a cell of the certificate is ``stride`` voxels an edge.
        cells_per_m: cells of the certificate in a metre.
        floor_z_m: the table.
    """

    certificate: NDArray[np.uint8]
    ball: NDArray[np.uint16]
    ray: NDArray[np.uint16]
    groups: NDArray[np.float64]
    cover: NDArray[np.float64]
    first: NDArray[np.int64]
    lattice: Lattice
    cells_per_m: float
    floor_z_m: float


def surroundings_of(field: SafetyField, body: ToolBody) -> tuple[Surroundings, BodyNumbers]:
    """Field and body as the tests of segments read them."""
    shaft_m = body.shaft_radius_m if body.shaft_length_m > 0 else NO_SHAFT_M
    numbers = BodyNumbers(
        body.disc_radius_m, body.thickness_m / 2, shaft_m, body.rho_max_m, body.semi_axis_x_m, body.semi_axis_y_m
    )
    lattice = field.arrays.lattice
    cell_m = lattice.stride * lattice.voxel_m
    ball_m, ray_m = field.coarse_clearance_m
    around = Surroundings(
        _certificate(ball_m, ray_m, cell_m, *numbers[:3]),
        field.arrays.ball,
        field.arrays.ray,
        *_grouped(body),
        lattice,
        1.0 / cell_m,
        field.arrays.floor_z_m,
    )
    return around, numbers


def _grouped(body: ToolBody) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.int64]]:
    balls, (centres, radius_m) = body.disc_balls, body.disc_cover
    away = np.linalg.norm(centres[:, None] - balls[:, :3], axis=2)
    owner = (away - balls[:, 3]).argmin(axis=1)
    outer = [away[owner == n, n].max(initial=0.0) + radius_m for n in range(len(balls))]
    order = np.argsort(owner, kind="stable")  # within a group from the outside in, as in the cover
    cover = np.column_stack([centres, np.full(len(centres), radius_m)])[order]
    first = np.searchsorted(owner[order], np.arange(len(balls) + 1))
    return np.column_stack([balls, np.maximum(outer, balls[:, 3])]), cover, first


@compiled
def _certificate(ball_m, ray_m, cell_m, disc_radius_m, half_thickness_m, shaft_radius_m):  # type: ignore[no-untyped-def]
    certificate = np.zeros(ball_m.shape, np.uint8)
    nx, ny, nz = ball_m.shape
    for i in range(nx):
        for j in range(ny):
            for k in range(nz):
                clear_m = min(ball_m[i, j, k] - disc_radius_m, ray_m[i, j, k] - shaft_radius_m)
                clear_m = min(clear_m, k * cell_m - half_thickness_m) - 1e-6
                if clear_m >= 0.0:
                    certificate[i, j, k] = min(int(clear_m / UNIT_M), 254) + 1
    return certificate


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
def clearance_of_pose(around, body, x, y, z, yaw, enough_m, least_m, closely):  # type: ignore[no-untyped-def]
    """Lower bound of the body's clearance: not sought further once surely ``enough_m`` or below ``least_m``.

    Table: the disc's lower face. Shaft: the ray above the centre, thickened. Disc: its enclosing ball or, if that
    is not clear by enough, the few balls along it or, ``closely`` and where one of these is not, those of its cover.
    """
    lattice = around.lattice
    others_m = z - body.half_thickness_m - around.floor_z_m
    if others_m < least_m:
        return others_m
    centre_m = clearance_at(around.ball, lattice, x, y, z)
    shaft_m = clearance_at(around.ray, lattice, x, y, z) - body.shaft_radius_m
    if shaft_m < enough_m:
        shaft_m = close_clearance_at(around.ray, lattice, x, y, z) - body.shaft_radius_m
        if shaft_m < least_m:
            return shaft_m
    others_m = min(others_m, shaft_m)
    disc_m = centre_m - body.disc_radius_m
    if disc_m < enough_m:
        disc_m = max(disc_m, _clearance_of_disc(around, x, y, z, yaw, enough_m, least_m, closely))
    return min(others_m, disc_m)


@kernel
def _clearance_of_disc(around, x, y, z, yaw, enough_m, least_m, closely):  # type: ignore[no-untyped-def]
    """The better of two bounds: of the few balls, and of the cover; -inf once a ball of it is below ``least_m``.

    Within the second, a group is settled by one ball around its part of the cover, if that is clear by enough.
    """
    cos, sin = math.cos(yaw), math.sin(yaw)
    few_m, cover_m = np.inf, np.inf
    for n in range(len(around.groups)):
        few_m = min(few_m, _clearance_of_group(around, n, x, y, z, cos, sin, enough_m) - around.groups[n, 3])
        if few_m < enough_m < np.inf:
            few_m = -np.inf  # the smallest of some is no bound of all
            break
    if few_m >= enough_m or not closely:
        return few_m
    for n in range(len(around.groups)):
        group_m = _clearance_of_group(around, n, x, y, z, cos, sin, enough_m) - around.groups[n, 4]
        if group_m < enough_m:
            part_m = _clearance_of_cover(around, n, x, y, z, cos, sin, enough_m, least_m)
            if part_m < least_m:
                return -np.inf
            group_m = max(group_m, part_m)
        cover_m = min(cover_m, group_m)
    return max(few_m, cover_m)


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
