"""The continuous test: the whole segment between two poses keeps its distance, not only poses of it (decision 16)."""

from typing import NamedTuple

import numpy as np

from deltasafe.compute.numba_cache import kernel
from deltasafe.planning.body import BodyParams
from deltasafe.planning.collision.clearance import is_surely_unsafe, level_clearance
from deltasafe.planning.collision.clearance_tables import ClearanceTables, table_clearance_m
from deltasafe.planning.collision.collision_arrays import CollisionArrays
from deltasafe.planning.collision.segment import in_order, motion_m, pose_at
from deltasafe.planning.collision.segment_query import answers_segments
from deltasafe.planning.collision.yaw_clearance_table import is_free_by_yaw

__all__ = ["BY_YAW_M", "ContinuousTest"]

GLANCE_M = 0.08
"""Motion between the few poses where a plain refusal is looked for; decides the time, not the answer."""

BY_YAW_M = 0.01
"""Motion that is shown to be safe by one look-up of the certificate that knows the yaw."""

STEP_M = 0.001
"""Least first step; poses do not depend on the resolution, so that a finer one accepts all that a coarser one does."""

SHORTER = 0.98
"""A step is so much shorter than what it would be if nothing came nearer: no answer hangs on the last bit."""


class ContinuousTest(NamedTuple):
    """All that the test looks at, the margin that it keeps, and the motion that it does not divide further."""

    certificates: ClearanceTables
    around: CollisionArrays
    body: BodyParams
    margin_m: float
    resolution_m: float


@answers_segments(ContinuousTest)
@kernel
def _continuous(test, first, second):  # type: ignore[no-untyped-def]
    """From pose to pose, each shown to be clear by the margin and by the motion between it and what is shown so far.

    Most refusals are plain: they are looked for first, at few poses, before anything is shown to be safe.
    """
    start, end = in_order(first, second)
    certificates, around, body, margin_m = test.certificates, test.around, test.body, test.margin_m
    whole_m = motion_m(body.rho_max_m, start, end)
    n_glances, glance = 1 + int(whole_m * (1 / GLANCE_M)), 0
    per_glance = 1.0 / n_glances
    while glance < n_glances:
        x, y, z, yaw = pose_at(start, end, (glance + 0.5) * per_glance)
        free_m = table_clearance_m(certificates, x, y, z)
        if free_m >= margin_m:  # and so are the poses within that way
            glance += 1 + int((free_m - margin_m) * (1 / GLANCE_M))
            continue
        if is_surely_unsafe(around, body, x, y, z, yaw):
            return False
        glance += 1
    rise_m = abs(end[2] - start[2])
    level_reach_m = around.slab_m * whole_m / rise_m if rise_m > 0 else np.inf
    per_m = 1.0 / whole_m if whole_m > 0 else 0.0
    slope = rise_m * per_m
    by_yaw_m = certificates.by_yaw.clear_m - margin_m  # negative where there is no such certificate
    start_m = table_clearance_m(certificates, start[0], start[1], start[2]) - margin_m
    shown_m, reach_m = 0.0, min(SHORTER * max(start_m, by_yaw_m, STEP_M), 0.5 * whole_m)
    while True:
        along_m = min(shown_m + reach_m, whole_m)
        reach_m = along_m - shown_m  # what the pose looked at must be clear by, beyond the margin
        x, y, z, yaw = pose_at(start, end, along_m * per_m)
        free_m, next_m = table_clearance_m(certificates, x, y, z) - margin_m, 0.0
        known = free_m >= reach_m
        if not known and by_yaw_m > 0 and is_free_by_yaw(certificates.by_yaw, certificates.lattice, x, y, z, yaw):
            if reach_m > by_yaw_m:
                reach_m = SHORTER * by_yaw_m
                continue
            free_m = by_yaw_m
        elif not known:
            if reach_m > level_reach_m:
                reach_m = SHORTER * level_reach_m
                continue
            height_m = body.half_thickness_m + margin_m + reach_m * slope
            level_m = level_clearance(around, body, x, y, z, yaw, margin_m + reach_m, height_m)
            level_m -= margin_m
            if level_m < reach_m:
                if reach_m <= test.resolution_m:
                    return False
                reach_m = max(min(SHORTER * free_m, 0.9 * reach_m), 0.5 * reach_m)
                continue
            free_m = max(free_m, reach_m)  # the slices looked at hold no farther
            next_m = min(SHORTER * level_m, 3 * free_m)
        shown_m = along_m + free_m
        if shown_m >= whole_m:
            return True
        reach_m = max(SHORTER * free_m, next_m, STEP_M)
