"""Is a segment of poses delta-safe? Three tests behind one interface (decision 16)."""

import dataclasses
import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from deltasafe.compiling import compiled, inlined, kernel
from deltasafe.errors import SettingsError
from deltasafe.planning.body import ToolBody
from deltasafe.planning.clearance import (
    certified_clearance_m,
    clearance_of_pose,
    is_certified,
    is_surely_unsafe,
    level_clearance,
)
from deltasafe.planning.constraint import answers_segments, ask_segment
from deltasafe.planning.counters import key_of_segment, mixed
from deltasafe.planning.field import SafetyField
from deltasafe.planning.scenarios import SamplePool, sample_pool, samples_are_free
from deltasafe.planning.surroundings import BodyNumbers, Surroundings, surroundings_of
from deltasafe.planning.yaw_certificate import is_free_by_yaw

__all__ = ["METHODS", "CheckSettings", "SegmentTest", "body_clearance_m", "is_segment_safe", "segment_test"]

METHODS = ("sampled", "exact", "continuous")
MOST_SAMPLES = 16384
GLANCE_M = 0.08
"""Motion between the few poses where a plain refusal is looked for; decides the time, not the answer."""

BY_YAW_M = 0.01
"""Motion that ``continuous`` shows to be safe by one look-up of the certificate that knows the yaw."""

STEP_M = 0.001
"""Least first step; poses do not depend on the resolution, so that a finer one accepts all that a coarser one does."""

SHORTER = 0.98
"""A step is so much shorter than what it would be if nothing came nearer: no answer hangs on the last bit."""

Array = NDArray[np.float64]


@dataclasses.dataclass(frozen=True)
class CheckSettings:
    """How a segment is tested.

    Attributes:
        method: ``sampled``, the paper's: N_x points of the enlarged body at poses at most ``delta_p_m`` apart;
            ``exact``: the distance transform at the same poses; ``continuous``: it along the whole segment.
        n_samples: N_x of ``sampled``.
        redraw_samples: draw anew for each pose (the paper), or keep one fixed set.
        delta_p_m: largest motion of any point of the body between two tested poses, for the first two methods;
            half of it is part of their margin (decision 18).
        resolution_m: ``continuous`` refuses when it cannot decide pieces with less motion than twice this.
        use_certificate: settle poses far from obstacles by a coarse grid first; changes nothing but the time.
            ``continuous`` always does so.
        by_yaw: settle most poses near obstacles by a second grid, which knows the yaw. It is made once for a field,
            body and margin, in the time of a few plans: for many plans in one field.
    """

    method: str = "continuous"
    n_samples: int = 100
    redraw_samples: bool = True
    delta_p_m: float = 0.01
    resolution_m: float = 0.001
    use_certificate: bool = True
    by_yaw: bool = False

    def __post_init__(self) -> None:
        if self.method not in METHODS:
            raise SettingsError(f"method must be one of {METHODS}, got {self.method!r}")
        if not 1 <= self.n_samples <= MOST_SAMPLES:
            raise SettingsError(f"n_samples must be between 1 and {MOST_SAMPLES}, got {self.n_samples}")
        for name in ("delta_p_m", "resolution_m"):
            if not (math.isfinite(getattr(self, name)) and 1e-5 <= getattr(self, name) <= 0.1):
                raise SettingsError(f"{name} must be between 1e-5 and 0.1 m, got {getattr(self, name)}")


class CheckNumbers(NamedTuple):
    """The numbers of a segment test; ``method`` is an index of ``METHODS``."""

    method: int
    margin_m: float
    delta_p_m: float
    resolution_m: float
    use_certificate: bool
    seed: int


class SegmentTest(NamedTuple):
    """All that a test needs, as compiled code reads it. Made by ``segment_test``."""

    around: Surroundings
    body: BodyNumbers
    pool: SamplePool
    numbers: CheckNumbers


def segment_test(
    field: SafetyField,
    body: ToolBody,
    margin_m: float,
    settings: CheckSettings | None = None,
    seed: int = 0,
) -> SegmentTest:
    """Test of segments of a body that keeps ``margin_m`` (gamma at the smallest speed) from the unsafe set.

    Raises:
        SettingsError: the margin is negative or beyond the reach of the field's distances.
    """
    settings = settings or CheckSettings()
    if not (math.isfinite(margin_m) and 0 <= margin_m <= 0.02):
        raise SettingsError(f"margin_m must be between 0 and 0.02 m, got {margin_m}")
    method = METHODS.index(settings.method)
    n_samples = settings.n_samples if settings.method == "sampled" else 0
    between_m = 0.0 if settings.method == "continuous" else settings.delta_p_m / 2
    around, numbers = surroundings_of(
        field,
        body,
        margin_m + between_m if settings.method != "sampled" else None,
        margin_m + (between_m or BY_YAW_M) if settings.by_yaw else None,
    )
    return SegmentTest(
        around,
        numbers,
        sample_pool(
            field,
            body,
            margin_m + settings.delta_p_m / 2,
            n_samples,
            settings.redraw_samples,
            seed,
        ),
        CheckNumbers(
            method,
            float(margin_m),
            settings.delta_p_m,
            settings.resolution_m,
            settings.use_certificate,
            int(seed),
        ),
    )


def is_segment_safe(test: SegmentTest, start: Array, end: Array) -> bool:
    """Whether the segment between two poses (4,), yaw turning linearly, passes; symmetric in its ends."""
    return bool(ask_segment(test, np.asarray(start, dtype=np.float64).copy(), np.asarray(end, dtype=np.float64).copy()))


def body_clearance_m(test: SegmentTest, poses: Array) -> Array:
    """d_o (N,) of poses (N, 4): lower bound of the distance of the body to the unsafe set, table included."""
    return np.asarray(_clearances(test.around, test.body, np.ascontiguousarray(poses, dtype=np.float64)))


@answers_segments(SegmentTest)
@kernel
def _segment(test, first, second):  # type: ignore[no-untyped-def]
    start, end = first, second
    if _comes_after(first, second):  # one order for both directions: the test is symmetric
        start, end = second, first
    if test.numbers.method == 2:
        return _continuous(test.around, test.body, test.numbers, start, end)
    return _at_poses(test.around, test.body, test.pool, test.numbers, start, end)


@inlined
def _comes_after(first, second):  # type: ignore[no-untyped-def]
    for axis in range(4):
        if first[axis] != second[axis]:
            return first[axis] > second[axis]
    return False


@inlined
def _motion(rho_max_m, start, end):  # type: ignore[no-untyped-def]
    """Bound of the way that any point of the body makes along a segment."""
    dx, dy, dz = end[0] - start[0], end[1] - start[1], end[2] - start[2]
    return math.sqrt(dx * dx + dy * dy + dz * dz) + rho_max_m * abs(end[3] - start[3])


@inlined
def _at(start, end, t):  # type: ignore[no-untyped-def]
    return (
        start[0] + t * (end[0] - start[0]),
        start[1] + t * (end[1] - start[1]),
        start[2] + t * (end[2] - start[2]),
        start[3] + t * (end[3] - start[3]),
    )


@inlined
def _at_poses(around, body, pool, numbers, start, end):  # type: ignore[no-untyped-def]
    """``exact`` and ``sampled``: poses at most Delta_p apart, both ends included, with margin for the way between."""
    steps = math.ceil(_motion(body.rho_max_m, start, end) / numbers.delta_p_m)
    need_m = numbers.margin_m + numbers.delta_p_m / 2
    height_m = body.half_thickness_m + need_m
    key, keyed, step = np.uint64(0), False, 0
    while step <= steps:
        x, y, z, yaw = _at(start, end, step / max(steps, 1))
        step += 1
        if numbers.use_certificate:
            free_m = certified_clearance_m(around, x, y, z)
            if free_m >= need_m:  # and so are the poses within that way
                step += int((free_m - need_m) / numbers.delta_p_m)
                continue
        if around.by_yaw.clear_m >= need_m and is_free_by_yaw(around.by_yaw, around.lattice, x, y, z, yaw):
            continue
        if numbers.method == 1:
            looked_m = level_clearance(around, body, x, y, z, yaw, need_m, height_m)
            if looked_m < need_m and not is_certified(around, x, y, z, need_m):
                return False
        else:
            if not keyed:
                key, keyed = key_of_segment(np.uint64(numbers.seed), start, end), True
            if not samples_are_free(around.lattice, pool, x, y, z, yaw, mixed(key, step)):
                return False
    return True


@inlined
def _continuous(around, body, numbers, start, end):  # type: ignore[no-untyped-def]
    """From pose to pose, each shown to be clear by the margin and by the motion between it and what is shown so far.

    Most refusals are plain: they are looked for first, at few poses, before anything is shown to be safe.
    """
    motion_m = _motion(body.rho_max_m, start, end)
    n_glances, glance = 1 + int(motion_m * (1 / GLANCE_M)), 0
    per_glance = 1.0 / n_glances
    while glance < n_glances:
        x, y, z, yaw = _at(start, end, (glance + 0.5) * per_glance)
        free_m = certified_clearance_m(around, x, y, z)
        if free_m >= numbers.margin_m:  # and so are the poses within that way
            glance += 1 + int((free_m - numbers.margin_m) * (1 / GLANCE_M))
            continue
        if is_surely_unsafe(around, body, x, y, z, yaw):
            return False
        glance += 1
    rise_m = abs(end[2] - start[2])
    level_reach_m = around.slab_m * motion_m / rise_m if rise_m > 0 else np.inf
    per_m = 1.0 / motion_m if motion_m > 0 else 0.0
    slope = rise_m * per_m
    by_yaw_m = around.by_yaw.clear_m - numbers.margin_m  # negative where there is no such certificate
    start_m = certified_clearance_m(around, start[0], start[1], start[2]) - numbers.margin_m
    shown_m, reach_m = 0.0, min(SHORTER * max(start_m, by_yaw_m, STEP_M), 0.5 * motion_m)
    while True:
        along_m = min(shown_m + reach_m, motion_m)
        reach_m = along_m - shown_m  # what the pose looked at must be clear by, beyond the margin
        x, y, z, yaw = _at(start, end, along_m * per_m)
        free_m, next_m = certified_clearance_m(around, x, y, z) - numbers.margin_m, 0.0
        known = free_m >= reach_m
        if not known and by_yaw_m > 0 and is_free_by_yaw(around.by_yaw, around.lattice, x, y, z, yaw):
            if reach_m > by_yaw_m:
                reach_m = SHORTER * by_yaw_m
                continue
            free_m = by_yaw_m
        elif not known:
            if reach_m > level_reach_m:
                reach_m = SHORTER * level_reach_m
                continue
            height_m = body.half_thickness_m + numbers.margin_m + reach_m * slope
            level_m = level_clearance(around, body, x, y, z, yaw, numbers.margin_m + reach_m, height_m)
            level_m -= numbers.margin_m
            if level_m < reach_m:
                if reach_m <= numbers.resolution_m:
                    return False
                reach_m = max(min(SHORTER * free_m, 0.9 * reach_m), 0.5 * reach_m)
                continue
            free_m = max(free_m, reach_m)  # the slices looked at hold no farther
            next_m = min(SHORTER * level_m, 3 * free_m)
        shown_m = along_m + free_m
        if shown_m >= motion_m:
            return True
        reach_m = max(SHORTER * free_m, next_m, STEP_M)


@compiled
def _clearances(around, body, poses):  # type: ignore[no-untyped-def]
    clearance_m = np.empty(len(poses))
    for n in range(len(poses)):
        x, y, z, yaw = poses[n, 0], poses[n, 1], poses[n, 2], poses[n, 3]
        clearance_m[n] = max(clearance_of_pose(around, body, x, y, z, yaw), certified_clearance_m(around, x, y, z))
    return clearance_m
