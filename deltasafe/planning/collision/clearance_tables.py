"""What settles most poses of a body in one look-up each: its distance however it is turned, or where it is free."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from deltasafe.compute.numba_cache import compiled, inlined
from deltasafe.planning.body import ToolBody
from deltasafe.planning.collision.distance_field import DistanceField, Lattice
from deltasafe.planning.collision.yaw_clearance_table import (
    YawClearanceTable,
    empty_yaw_clearance_table,
    yaw_clearance_table,
)

__all__ = ["UNIT_M", "ClearanceTables", "clearance_tables_of", "table_clearance_m"]

UNIT_M = 0.0005
"""Resolution of the distance certificate: 255 steps reach 127 mm."""


class ClearanceTables(NamedTuple):
    """A field and a body, as far as one look-up tells.

    Attributes:
        distance: (cx, cy, cz) uint8, the distance certificate: v > 0 says that the body is clear by v - 1 units
            wherever in the cell its center is and however it is turned; 0 says nothing.
        by_yaw: another one, finer, that knows the yaw; may be empty.
        lattice: of the field; a cell of the distance certificate is ``stride`` voxels an edge.
        cells_per_m: cells in a meter.
    """

    distance: NDArray[np.uint8]
    by_yaw: YawClearanceTable
    lattice: Lattice
    cells_per_m: float


def clearance_tables_of(field: DistanceField, body: ToolBody, by_yaw_m: float | None) -> ClearanceTables:
    """Clearance tables of a body in a field; ``by_yaw_m`` is the margin of the finer table, None without it."""
    lattice = field.arrays.lattice
    cell_m = lattice.stride * lattice.voxel_m
    return ClearanceTables(
        _distance(*field.coarse_clearance_m, cell_m, *body.numbers[:3]),
        empty_yaw_clearance_table() if by_yaw_m is None else yaw_clearance_table(field, body, by_yaw_m),
        lattice,
        1.0 / cell_m,
    )


@inlined
def table_clearance_m(certificates, x, y, z):  # type: ignore[no-untyped-def]
    """Lower bound of the clearance of a body, however it is turned, by one look-up; -inf where that says nothing."""
    nx, ny, nz = certificates.distance.shape
    i = int(min(max((x - certificates.lattice.lower_x_m) * certificates.cells_per_m, 0.0), nx - 1.0))
    j = int(min(max((y - certificates.lattice.lower_y_m) * certificates.cells_per_m, 0.0), ny - 1.0))
    k = int(min(max((z - certificates.lattice.lower_z_m) * certificates.cells_per_m, 0.0), nz - 1.0))
    steps = certificates.distance[i, j, k]
    return UNIT_M * (steps - 1.0) if steps > 0 else -np.inf


@compiled
def _distance(ball_m, ray_m, cell_m, disc_radius_m, half_thickness_m, shaft_radius_m):  # type: ignore[no-untyped-def]
    steps = np.zeros(ball_m.shape, np.uint8)
    nx, ny, nz = ball_m.shape
    for i in range(nx):
        for j in range(ny):
            for k in range(nz):
                clear_m = min(ball_m[i, j, k] - disc_radius_m, ray_m[i, j, k] - shaft_radius_m)
                clear_m = min(clear_m, k * cell_m - half_thickness_m) - 1e-6
                if clear_m >= 0.0:
                    steps[i, j, k] = min(int(clear_m / UNIT_M), 254) + 1
    return steps
