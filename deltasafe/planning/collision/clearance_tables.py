"""Lookup tables that accept most poses of a body in O(1): clearance at any yaw, and free voxels per yaw bin."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from deltasafe.compute.numba_cache import compiled, inlined
from deltasafe.planning.body import ToolBody
from deltasafe.planning.collision.distance_field import COARSE_REACH_M, DistanceField, Lattice
from deltasafe.planning.collision.yaw_clearance_table import NO_YAW_TABLE, YawClearanceTable, yaw_clearance_table

UNIT_M = 0.0005
"""Resolution of ``ClearanceTables.steps``: 255 steps reach 127 mm."""


class ClearanceTables(NamedTuple):
    """Clearance tables of a body in a field.

    Attributes:
        steps: (cx, cy, cz) uint8. v > 0: the clearance is at least (v - 1) ``UNIT_M``, wherever in the cell the
            center is and whatever its yaw. 0: no bound.
        by_yaw: finer table with a bound per yaw bin; may be empty.
        lattice: of the field; a cell of ``steps`` has an edge of ``stride`` voxels.
        cells_per_m: cells of ``steps`` per meter.
    """

    steps: NDArray[np.uint8]
    by_yaw: YawClearanceTable
    lattice: Lattice
    cells_per_m: float


def clearance_tables_of(field: DistanceField, body: ToolBody, yaw_clearance_m: float | None) -> ClearanceTables:
    """Build the tables of a body in a field; ``yaw_clearance_m`` is the clearance of ``by_yaw``, None to omit it."""
    lattice = field.arrays.lattice
    cell_m = lattice.stride * lattice.voxel_m
    # scales with the body, in steps, so that bodies of similar size share it
    reach_m = COARSE_REACH_M * max(1, math.ceil((body.params.disc_radius_m + 0.05) / COARSE_REACH_M))
    return ClearanceTables(
        _clearance_steps(*field.coarse_clearance_m(reach_m), cell_m, body.params),
        NO_YAW_TABLE if yaw_clearance_m is None else yaw_clearance_table(field, body, yaw_clearance_m),
        lattice,
        1.0 / cell_m,
    )


@compiled
def _clearance_steps(point_m, ray_m, cell_m, body):  # type: ignore[no-untyped-def]
    steps = np.zeros(point_m.shape, np.uint8)
    nx, ny, nz = point_m.shape
    for i in range(nx):
        for j in range(ny):
            for k in range(nz):
                clearance_m = min(point_m[i, j, k] - body.disc_radius_m, ray_m[i, j, k] - body.shaft_radius_m)
                clearance_m = min(clearance_m, k * cell_m - body.half_thickness_m) - 1e-6
                if clearance_m >= 0.0:
                    steps[i, j, k] = min(int(clearance_m / UNIT_M), 254) + 1
    return steps


@inlined
def table_clearance_m(tables, pose):  # type: ignore[no-untyped-def]
    """Look up a lower bound of the clearance at a pose, valid at any yaw; -inf if the table has none."""
    nx, ny, nz = tables.steps.shape
    i = int(min(max((pose[0] - tables.lattice.lower_x_m) * tables.cells_per_m, 0.0), nx - 1.0))
    j = int(min(max((pose[1] - tables.lattice.lower_y_m) * tables.cells_per_m, 0.0), ny - 1.0))
    k = int(min(max((pose[2] - tables.lattice.lower_z_m) * tables.cells_per_m, 0.0), nz - 1.0))
    steps = tables.steps[i, j, k]
    return UNIT_M * (steps - 1.0) if steps > 0 else -np.inf
