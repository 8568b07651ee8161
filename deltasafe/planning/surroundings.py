"""A field and a body as compiled tests of segments read them: what is looked up, from the coarsest to the finest."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from deltasafe.compiling import compiled
from deltasafe.planning.body import ToolBody
from deltasafe.planning.field import Lattice, SafetyField
from deltasafe.planning.yaw_certificate import YawCertificate, no_yaw_certificate, yaw_certificate

__all__ = ["UNIT_M", "BodyNumbers", "Surroundings", "surroundings_of"]

UNIT_M = 0.0005
"""Resolution of the certificate: 255 steps reach 127 mm."""

NO_SHAFT_M = -1e6
GOLDEN = (math.sqrt(5) - 1) / 2


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
        by_yaw: another one, finer, that knows the yaw; may be empty.
        above: (nx, ny, nz) uint8, the clearance of any ray upwards from a voxel: v > 0 says at least v - 1 fine units.
        unsafe: (nx, ny, ceil(nz / 32)) int32, the unsafe voxels as bits.
        few: (m, 3) few balls that contain the disc: centre in its plane in voxels, radius in the plane in m;
            ``widest_m`` the largest radius.
        slices: (nx, ny, nz) uint8, horizontal distance from the middle of a voxel to all that is unsafe in its slice,
            in fine units.
        slabs: the same to all slices that disc and margin may meet while the pose keeps its height up to ``slab_m``.
        ball, ray: squared distances (``FieldArrays``).
        groups: (m, 5) few balls that contain the disc, tight in its plane: centre, radius, and the radius that also
            contains the balls of the cover given to it; cover: (n, 4) many balls that contain the disc closely, by
            group; first: (m + 1,) where in the cover each group begins.
        lattice: of ``ball`` and ``ray``; a cell of the certificate is ``stride`` voxels an edge.
        cells_per_m: cells of the certificate in a metre.
        floor_z_m: the table.
    """

    certificate: NDArray[np.uint8]
    by_yaw: YawCertificate
    above: NDArray[np.uint8]
    unsafe: NDArray[np.int32]
    few: NDArray[np.float64]
    widest_m: float
    slices: NDArray[np.uint8]
    slabs: NDArray[np.uint8]
    slab_m: float
    ball: NDArray[np.uint16]
    ray: NDArray[np.uint16]
    groups: NDArray[np.float64]
    cover: NDArray[np.float64]
    first: NDArray[np.int64]
    lattice: Lattice
    cells_per_m: float
    floor_z_m: float


def surroundings_of(
    field: SafetyField, body: ToolBody, margin_m: float | None, by_yaw_m: float | None
) -> tuple[Surroundings, BodyNumbers]:
    """Field and body as the tests of segments read them.

    Args:
        margin_m: what a pose keeps from the unsafe set; None for a test that looks at nothing finer than the
            certificate, and has no finer clearances made for it.
        by_yaw_m: what a pose is to be shown to keep by one look-up that knows the yaw; None without that.
    """
    shaft_m = body.shaft_radius_m if body.shaft_length_m > 0 else NO_SHAFT_M
    numbers = BodyNumbers(
        body.disc_radius_m, body.thickness_m / 2, shaft_m, body.rho_max_m, body.semi_axis_x_m, body.semi_axis_y_m
    )
    lattice = field.arrays.lattice
    cell_m = lattice.stride * lattice.voxel_m
    ball_m, ray_m = field.coarse_clearance_m
    above = slices = slabs = np.empty((0, 0, 0), np.uint8)
    slab_m = 0.0
    if margin_m is not None:
        above, slices = field.ray_clearance, field.slices
        slabs, slab_m = field.slabs(body.thickness_m / 2 + margin_m)
    groups, cover, first = _grouped(body)
    few = _few(body, lattice)
    around = Surroundings(
        certificate=_certificate(ball_m, ray_m, cell_m, *numbers[:3]),
        by_yaw=no_yaw_certificate() if by_yaw_m is None else yaw_certificate(field, body, by_yaw_m),
        above=above,
        unsafe=field.unsafe_bits,
        few=few,
        widest_m=float(few[:, 2].max()),
        slices=slices,
        slabs=slabs,
        slab_m=slab_m,
        ball=field.arrays.ball,
        ray=field.arrays.ray,
        groups=groups,
        cover=cover,
        first=first,
        lattice=lattice,
        cells_per_m=1.0 / cell_m,
        floor_z_m=field.arrays.floor_z_m,
    )
    return around, numbers


def _few(body: ToolBody, lattice: Lattice) -> NDArray[np.float64]:
    x, y, _, radius_m = body.disc_balls.T
    flat_m = np.sqrt(np.maximum(radius_m**2 - body.thickness_m**2 / 4, 0.0)) * (1 + 1e-9)
    spread = np.argsort(GOLDEN * np.arange(len(x)) % 1)  # the first ones tell most: none is beside the one before
    return np.ascontiguousarray(np.column_stack([x * lattice.per_m, y * lattice.per_m, flat_m])[spread])


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
