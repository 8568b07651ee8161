"""Field and body as flat arrays, for the poses that the lookup tables do not accept."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from deltasafe.planning.body import ToolBody
from deltasafe.planning.collision.distance_field import DistanceField, Lattice

GOLDEN_RATIO = (math.sqrt(5) - 1) / 2


class CollisionArrays(NamedTuple):
    """Distances of a field and bounding balls of a body, as compiled code reads them.

    Attributes:
        ray_clearance: (nx, ny, nz) uint8. v > 0: rays upward from the voxel have a clearance of at least v - 1 fine
            units. 0: no bound.
        unsafe_bits: (nx, ny, ceil(nz / 32)) int32, one bit per voxel.
        circles: (m, 3) circles that cover the disc seen from above: center in voxels, radius in meters.
        max_circle_radius_m: largest radius of ``circles``.
        slice_distance: (nx, ny, nz) uint8, horizontal distance from the voxel's center to unsafe voxels of its slice,
            in fine units.
        slab_distance: the same for all slices that disc and margin reach while the height changes by at most
            ``slab_rise_m``.
        slab_rise_m: see ``slab_distance``.
        squared_distance, squared_ray_distance: see ``FieldArrays``.
        balls: (m, 5) bounding balls of the disc or the parts: center, radius, and radius that also contains the ball's
            group of the cover.
        cover: (n, 4) small balls that cover the disc tightly, sorted by group: center and radius.
        group_start: (m + 1,) index into ``cover`` of the first ball of each group.
        probes: (k, 3) points of the body that reveal most collisions.
        parts: (p, 10) convex parts of the body, see ``ToolPart.params``.
        lattice: of the field.
        table_z_m: height of the table.
    """

    ray_clearance: NDArray[np.uint8]
    unsafe_bits: NDArray[np.int32]
    circles: NDArray[np.float64]
    max_circle_radius_m: float
    slice_distance: NDArray[np.uint8]
    slab_distance: NDArray[np.uint8]
    slab_rise_m: float
    squared_distance: NDArray[np.uint16]
    squared_ray_distance: NDArray[np.uint16]
    balls: NDArray[np.float64]
    cover: NDArray[np.float64]
    group_start: NDArray[np.int64]
    probes: NDArray[np.float64]
    parts: NDArray[np.float64]
    lattice: Lattice
    table_z_m: float


def collision_arrays_of(field: DistanceField, body: ToolBody, margin_m: float) -> CollisionArrays:
    """Build the arrays of a body that keeps ``margin_m`` from the unsafe set."""
    if body.parts:
        slab_distance, slab_rise_m = np.zeros((0, 0, 0), np.uint8), np.inf
        balls, cover, group_start = _balls_of_parts(body)
        circles = np.full((1, 3), np.inf)  # beyond the reach of the horizontal distances, which know the disc only
        probes = np.array([[part.x_m, part.y_m, part.z_m] for part in body.parts])
    else:
        slab_distance, slab_rise_m = field.slab_distance(body.thickness_m / 2 + margin_m)
        balls, cover, group_start = _grouped_cover(body)
        circles = _circles(body, field.arrays.lattice)
        a, b = body.semi_axis_x_m, body.semi_axis_y_m
        probes = np.array([[0, 0, 0], [-a, 0, 0], [0, -b, 0], [a, 0, 0], [0, b, 0]], dtype=np.float64)
    return CollisionArrays(
        field.ray_clearance,
        field.unsafe_bits,
        circles,
        float(circles[:, 2].max()),
        field.slice_distance,
        slab_distance,
        slab_rise_m,
        field.arrays.squared_distance,
        field.arrays.squared_ray_distance,
        balls,
        cover,
        group_start,
        probes,
        np.array([part.params for part in body.solids]),
        field.arrays.lattice,
        field.arrays.table_z_m,
    )


def _balls_of_parts(body: ToolBody) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.int64]]:
    """One ball per group: what the balls do not accept is left to the exact distance."""
    balls = np.concatenate([part.balls() for part in body.solids])
    return np.column_stack([balls, balls[:, 3]]), balls, np.arange(len(balls) + 1)


def _circles(body: ToolBody, lattice: Lattice) -> NDArray[np.float64]:
    """Cross-sections of the bounding balls at the faces of the disc, in low-discrepancy order.

    Neighboring circles overlap and give similar answers. In this order the first few cover the whole disc coarsely, so
    that a collision is found early.
    """
    x, y, _, radius_m = body.bounding_balls.T
    circle_m = np.sqrt(np.maximum(radius_m**2 - body.thickness_m**2 / 4, 0.0)) * (1 + 1e-9)
    order = np.argsort(GOLDEN_RATIO * np.arange(len(x)) % 1)
    return np.ascontiguousarray(np.column_stack([x * lattice.per_m, y * lattice.per_m, circle_m])[order])


def _grouped_cover(body: ToolBody) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.int64]]:
    """Assign each ball of the cover to the bounding ball that it protrudes from least."""
    balls, (centers, radius_m) = body.bounding_balls, body.disc_cover
    distance = np.linalg.norm(centers[:, None] - balls[:, :3], axis=2)
    owner = (distance - balls[:, 3]).argmin(axis=1)
    outer = [distance[owner == n, n].max(initial=0.0) + radius_m for n in range(len(balls))]
    order = np.argsort(owner, kind="stable")  # outermost first within a group, as in the cover
    cover = np.column_stack([centers, np.full(len(centers), radius_m)])[order]
    group_start = np.searchsorted(owner[order], np.arange(len(balls) + 1))
    return np.column_stack([balls, np.maximum(outer, balls[:, 3])]), cover, group_start
