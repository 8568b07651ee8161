"""The continuous test: it bounds the clearance along the whole segment, not only at poses (decision 16)."""

from typing import NamedTuple

import numpy as np

from deltasafe.compute.numba_cache import inlined, kernel
from deltasafe.planning.body import BodyParams
from deltasafe.planning.collision.clearance import clearance_of_pose, is_surely_unsafe, level_clearance
from deltasafe.planning.collision.clearance_tables import ClearanceTables, table_clearance_m
from deltasafe.planning.collision.collision_arrays import CollisionArrays
from deltasafe.planning.collision.exact_clearance import exact_clearance
from deltasafe.planning.collision.segment import in_order, motion_m, pose_at
from deltasafe.planning.collision.segment_query import register_segment_test
from deltasafe.planning.collision.yaw_clearance_table import is_free_by_yaw

PRECHECK_SPACING_M = 0.08
"""Motion between the poses of the collision precheck; affects the time, not the answer."""

BY_YAW_M = 0.01
"""Motion that one look-up in the table by yaw accepts."""

MIN_STEP_M = 0.001
"""Smallest first step. Independent of the resolution, so that a finer test accepts whatever a coarser one accepts."""

STEP_FACTOR = 0.98
"""Safety factor on the step length, so that rounding cannot flip the answer."""


class ContinuousTest(NamedTuple):
    """The continuous test of a body.

    Attributes:
        margin_m: distance to keep.
        resolution_m: motion below which a refused piece is not divided further.
        is_exact: measure the exact distance before a pose is refused; slower, and loses almost no clearance.
    """

    tables: ClearanceTables
    arrays: CollisionArrays
    body: BodyParams
    margin_m: float
    resolution_m: float
    is_exact: bool


@register_segment_test(ContinuousTest)
@kernel
def _continuous(test, first, second):  # type: ignore[no-untyped-def]
    """Step along the segment; each pose must be clear by the margin plus the motion since the last verified pose.

    The clearance at an accepted pose, less the margin, then verifies the motion ahead of it as well.
    """
    start, end = in_order(first, second)
    tables, body, margin_m = test.tables, test.body, test.margin_m
    whole_m = motion_m(body.rho_max_m, start, end)
    if _collides_at_sparse_poses(test, start, end, whole_m):
        return False
    rise_m = abs(end[2] - start[2])
    level_reach_m = test.arrays.slab_rise_m * whole_m / rise_m if rise_m > 0 else np.inf
    per_m = 1.0 / whole_m if whole_m > 0 else 0.0
    slope = rise_m * per_m
    by_yaw_m = tables.by_yaw.clear_m - margin_m  # negative if there is no such table
    start_m = table_clearance_m(tables, start) - margin_m
    verified_m, reach_m = 0.0, min(STEP_FACTOR * max(start_m, by_yaw_m, MIN_STEP_M), 0.5 * whole_m)
    while True:
        along_m = min(verified_m + reach_m, whole_m)
        reach_m = along_m - verified_m  # the clearance that this pose needs, beyond the margin
        pose = pose_at(start, end, along_m * per_m)
        free_m, next_m = table_clearance_m(tables, pose) - margin_m, 0.0
        accepted = free_m >= reach_m
        if not accepted and by_yaw_m > 0 and is_free_by_yaw(tables.by_yaw, tables.lattice, pose):
            if reach_m > by_yaw_m:
                reach_m = STEP_FACTOR * by_yaw_m
                continue
            free_m = by_yaw_m
        elif not accepted:
            if reach_m > level_reach_m:
                reach_m = STEP_FACTOR * level_reach_m
                continue
            height_m = body.half_thickness_m + margin_m + reach_m * slope
            level_m = level_clearance(test.arrays, body, pose, margin_m + reach_m, height_m)
            level_m -= margin_m
            if level_m < reach_m and test.is_exact:
                level_m = _exact_m(test, pose, reach_m)
                free_m = max(free_m, level_m)
            if level_m < reach_m:
                if reach_m <= test.resolution_m:
                    return False
                reach_m = max(min(STEP_FACTOR * free_m, 0.9 * reach_m), 0.5 * reach_m)
                continue
            free_m = max(free_m, reach_m)  # the slices that were read cover no larger motion
            next_m = min(STEP_FACTOR * level_m, 3 * free_m)
        verified_m = along_m + free_m
        if verified_m >= whole_m:
            return True
        reach_m = max(STEP_FACTOR * free_m, next_m, MIN_STEP_M)


@kernel
def _exact_m(test, pose, reach_m):  # type: ignore[no-untyped-def]
    """Clearance beyond the margin: by bounding balls, else exact and capped at twice the reach."""
    ball_m = clearance_of_pose(test.arrays, test.body, pose) - test.margin_m
    if ball_m >= reach_m:
        return ball_m
    least_m, most_m = test.margin_m + reach_m, test.margin_m + max(2.0 * reach_m, MIN_STEP_M)
    return exact_clearance(test.arrays, test.body, pose, least_m, most_m) - test.margin_m


@inlined
def _collides_at_sparse_poses(test, start, end, whole_m):  # type: ignore[no-untyped-def]
    """Return whether the body is surely unsafe at one of a few poses: most refused segments end here, at low cost."""
    count, index = 1 + int(whole_m * (1 / PRECHECK_SPACING_M)), 0
    per_pose = 1.0 / count
    while index < count:
        pose = pose_at(start, end, (index + 0.5) * per_pose)
        clearance_m = table_clearance_m(test.tables, pose)
        if clearance_m >= test.margin_m:  # the poses within the remaining clearance are free as well
            index += 1 + int((clearance_m - test.margin_m) * (1 / PRECHECK_SPACING_M))
            continue
        if is_surely_unsafe(test.arrays, pose):
            return True
        index += 1
    return False
