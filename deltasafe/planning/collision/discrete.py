"""Discrete tests of a segment: the paper's sampled test and the exact one, at poses at most Delta_p apart (IV-A)."""

import math
from typing import NamedTuple

import numpy as np

from deltasafe.compute.counter_rng import segment_key, splitmix64
from deltasafe.compute.numba_cache import inlined, kernel
from deltasafe.planning.body import BodyParams
from deltasafe.planning.collision.clearance import level_clearance
from deltasafe.planning.collision.clearance_tables import ClearanceTables, table_clearance_m
from deltasafe.planning.collision.collision_arrays import CollisionArrays
from deltasafe.planning.collision.scenario_samples import SamplePool, samples_are_free
from deltasafe.planning.collision.segment import in_order, motion_m, pose_at
from deltasafe.planning.collision.segment_query import register_segment_test
from deltasafe.planning.collision.yaw_clearance_table import is_free_by_yaw


class StepParams(NamedTuple):
    """Spacing of the tested poses, and the clearance that each needs: margin plus half of the spacing."""

    rho_max_m: float
    needed_m: float
    delta_p_m: float
    use_clearance_tables: bool


class SampledTest(NamedTuple):
    """N_x samples at each pose. Kept small, because it is passed by value for every segment."""

    tables: ClearanceTables
    pool: SamplePool
    steps: StepParams


class ExactTest(NamedTuple):
    """Distances at each pose."""

    tables: ClearanceTables
    arrays: CollisionArrays
    body: BodyParams
    steps: StepParams


@register_segment_test(SampledTest)
@kernel
def _sampled(test, first, second):  # type: ignore[no-untyped-def]
    start, end = in_order(first, second)
    last = _last_step(test.steps, start, end)
    step, pose = _next_open_step(test.tables, test.steps, start, end, last, 0)
    if step > last:
        return True
    key = segment_key(np.uint64(test.pool.seed), start, end)
    while step <= last:
        step += 1
        if not samples_are_free(test.tables.lattice, test.pool, pose, splitmix64(key, step)):
            return False
        step, pose = _next_open_step(test.tables, test.steps, start, end, last, step)
    return True


@register_segment_test(ExactTest)
@kernel
def _exact(test, first, second):  # type: ignore[no-untyped-def]
    start, end = in_order(first, second)
    last, needed_m = _last_step(test.steps, start, end), test.steps.needed_m
    height_m = test.body.half_thickness_m + needed_m
    step, pose = _next_open_step(test.tables, test.steps, start, end, last, 0)
    while step <= last:
        clearance_m = level_clearance(test.arrays, test.body, pose, needed_m, height_m)
        if clearance_m < needed_m and table_clearance_m(test.tables, pose) < needed_m:
            return False
        step, pose = _next_open_step(test.tables, test.steps, start, end, last, step + 1)
    return True


@inlined
def _last_step(steps, start, end):  # type: ignore[no-untyped-def]
    return math.ceil(motion_m(steps.rho_max_m, start, end) / steps.delta_p_m)


@inlined
def _next_open_step(tables, steps, start, end, last, step):  # type: ignore[no-untyped-def]
    """Return the first step from ``step`` on that no table accepts, and its pose; ``last + 1`` or more if none."""
    per_step, per_m = 1.0 / max(last, 1), 1.0 / steps.delta_p_m  # divisions would take most of the time
    pose = start
    while step <= last:
        pose = pose_at(start, end, step * per_step)
        if steps.use_clearance_tables:
            clearance_m = table_clearance_m(tables, pose)
            if clearance_m >= steps.needed_m:  # the poses within the remaining clearance are free as well
                step += 1 + int((clearance_m - steps.needed_m) * per_m)
                continue
        if not (tables.by_yaw.clear_m >= steps.needed_m and is_free_by_yaw(tables.by_yaw, tables.lattice, pose)):
            break
        step += 1
    return step, pose
