"""The sampled test, the paper's, and the exact one: poses of a segment at most Delta_p apart (section IV-A)."""

import math
from typing import NamedTuple

import numpy as np

from deltasafe.compute.counter_rng import key_of_segment, mixed
from deltasafe.compute.numba_cache import inlined, kernel
from deltasafe.planning.body import BodyParams
from deltasafe.planning.collision.clearance import level_clearance
from deltasafe.planning.collision.clearance_tables import ClearanceTables, table_clearance_m
from deltasafe.planning.collision.collision_arrays import CollisionArrays
from deltasafe.planning.collision.scenario_samples import SamplePool, samples_are_free
from deltasafe.planning.collision.segment import in_order, motion_m, pose_at
from deltasafe.planning.collision.segment_query import answers_segments
from deltasafe.planning.collision.yaw_clearance_table import is_free_by_yaw

__all__ = ["ExactTest", "SampledTest", "StepParams"]


class StepParams(NamedTuple):
    """How poses follow each other: at most ``delta_p_m`` apart, each to keep ``need_m``, half of the way included."""

    rho_max_m: float
    need_m: float
    delta_p_m: float
    use_clearance_tables: bool


class SampledTest(NamedTuple):
    """N_x samples at every pose. It holds no more than it looks at: a search passes it on for every segment."""

    certificates: ClearanceTables
    pool: SamplePool
    steps: StepParams


class ExactTest(NamedTuple):
    """Distances at every pose."""

    certificates: ClearanceTables
    around: CollisionArrays
    body: BodyParams
    steps: StepParams


@answers_segments(SampledTest)
@kernel
def _sampled(test, first, second):  # type: ignore[no-untyped-def]
    start, end = in_order(first, second)
    last = _last_step(test.steps, start, end)
    step, pose = _open_step(test.certificates, test.steps, start, end, last, 0)
    if step > last:
        return True
    key = key_of_segment(np.uint64(test.pool.seed), start, end)
    while step <= last:
        x, y, z, yaw = pose
        step += 1
        if not samples_are_free(test.certificates.lattice, test.pool, x, y, z, yaw, mixed(key, step)):
            return False
        step, pose = _open_step(test.certificates, test.steps, start, end, last, step)
    return True


@answers_segments(ExactTest)
@kernel
def _exact(test, first, second):  # type: ignore[no-untyped-def]
    start, end = in_order(first, second)
    last, need_m = _last_step(test.steps, start, end), test.steps.need_m
    height_m = test.body.half_thickness_m + need_m
    step, pose = _open_step(test.certificates, test.steps, start, end, last, 0)
    while step <= last:
        x, y, z, yaw = pose
        clear_m = level_clearance(test.around, test.body, x, y, z, yaw, need_m, height_m)
        if clear_m < need_m and table_clearance_m(test.certificates, x, y, z) < need_m:
            return False
        step, pose = _open_step(test.certificates, test.steps, start, end, last, step + 1)
    return True


@inlined
def _last_step(steps, start, end):  # type: ignore[no-untyped-def]
    return math.ceil(motion_m(steps.rho_max_m, start, end) / steps.delta_p_m)


@inlined
def _open_step(certificates, steps, start, end, last, step):  # type: ignore[no-untyped-def]
    """The first step from ``step`` on that no certificate settles, with its pose; beyond ``last`` there is none."""
    per_step, per_m = 1.0 / max(last, 1), 1.0 / steps.delta_p_m  # divisions take longer than all the rest
    pose = start
    while step <= last:
        pose = pose_at(start, end, step * per_step)
        x, y, z, yaw = pose
        if steps.use_clearance_tables:
            free_m = table_clearance_m(certificates, x, y, z)
            if free_m >= steps.need_m:  # and so are the poses within that way
                step += 1 + int((free_m - steps.need_m) * per_m)
                continue
        by_yaw = certificates.by_yaw
        if not (by_yaw.clear_m >= steps.need_m and is_free_by_yaw(by_yaw, certificates.lattice, x, y, z, yaw)):
            break
        step += 1
    return step, pose
