"""Tests of whether a segment of poses is delta-safe: three methods behind one interface (decision 16)."""

import dataclasses
import math

import numpy as np
from numpy.typing import NDArray

from deltasafe.compute.numba_cache import compiled
from deltasafe.errors import SettingsError
from deltasafe.geometry import as_rows
from deltasafe.planning.body import ToolBody
from deltasafe.planning.collision.clearance import clearance_of_pose
from deltasafe.planning.collision.clearance_tables import clearance_tables_of, table_clearance_m
from deltasafe.planning.collision.collision_arrays import collision_arrays_of
from deltasafe.planning.collision.continuous import BY_YAW_M, ContinuousTest
from deltasafe.planning.collision.discrete import ExactTest, SampledTest, StepParams
from deltasafe.planning.collision.distance_field import SLAB_REACH_M, DistanceField
from deltasafe.planning.collision.exact_clearance import exact_clearance
from deltasafe.planning.collision.scenario_samples import sample_pool
from deltasafe.planning.collision.segment_query import as_pose, segment_passes
from deltasafe.setting_ranges import check_choice, check_range

FINEST_M = 0.00025
"""Resolution of verifications. A search may use a coarser one, which refuses more."""

METHODS = ("sampled", "exact", "continuous")
MAX_SAMPLES = 16384
MAX_MARGIN_M = 0.02
MIN_REACH_M = 0.005
"""Least length of the steps that horizontal distances must allow; discs that are too wide are measured exactly."""

Array = NDArray[np.float64]


@dataclasses.dataclass(frozen=True)
class CheckSettings:
    """How a segment is tested.

    Attributes:
        method: test of a segment. ``sampled``: the paper's, N_x random points of the enlarged body at poses at most
            ``delta_p_m`` apart. ``exact``: the distance field at the same poses. ``continuous``: the distance field
            along the whole segment.
        n_samples: N_x, points per pose of method ``sampled``.
        redraw_samples: draw new points for each pose, as in the paper, or use one fixed set.
        delta_p_m: largest motion of any point of the body between two tested poses, for ``sampled`` and ``exact``; half
            of it is added to their margin (decision 18).
        resolution_m: ``continuous`` refuses a segment if it cannot decide a piece with less motion than twice this.
        use_clearance_tables: accept poses far from obstacles by a coarse lookup table; affects the time, not the
            answer. ``continuous`` always uses the table.
        by_yaw: accept most poses near obstacles by a second lookup table, per yaw bin. Building it takes as long as a
            few plans, once per field, body and margin: worthwhile for many plans in one field.
    """

    method: str = "continuous"
    n_samples: int = 100
    redraw_samples: bool = True
    delta_p_m: float = 0.01
    resolution_m: float = 0.001
    use_clearance_tables: bool = True
    by_yaw: bool = False

    def __post_init__(self) -> None:
        check_choice(self, METHODS, "method")
        check_range(self, f"[1, {MAX_SAMPLES}]", "n_samples")
        check_range(self, "[1e-5, 0.1]", "delta_p_m", "resolution_m")


SegmentTest = SampledTest | ExactTest | ContinuousTest
"""A segment test as compiled code reads it. Made by ``segment_test``."""


def segment_test(
    field: DistanceField,
    body: ToolBody,
    margin_m: float,
    settings: CheckSettings | None = None,
    seed: int = 0,
    is_exact: bool = False,
) -> SegmentTest:
    """Build the test of a body that keeps ``margin_m`` (gamma at the smallest speed) from the unsafe set.

    Args:
        is_exact: let the continuous test measure the exact distance before it refuses. It always does so for tools
            that the tables of horizontal distances do not know: those with parts, and discs beyond their reach.

    Raises:
        SettingsError: the margin is negative or beyond the reach of the field's distances, or the method is not
            continuous for a tool with parts.
    """
    settings = settings or CheckSettings()
    if not (math.isfinite(margin_m) and 0 <= margin_m <= MAX_MARGIN_M):
        raise SettingsError(f"margin_m must be between 0 and {MAX_MARGIN_M} m, got {margin_m}")
    is_continuous = settings.method == "continuous"
    if body.parts and not is_continuous:
        raise SettingsError(f"method must be continuous for a tool with parts, got {settings.method!r}")
    between_m = 0.0 if is_continuous else settings.delta_p_m / 2
    needed_m = float(margin_m) + between_m
    by_yaw_m = margin_m + (BY_YAW_M if is_continuous else between_m)
    tables = clearance_tables_of(field, body, by_yaw_m if settings.by_yaw and not body.parts else None)
    steps = StepParams(body.rho_max_m, needed_m, settings.delta_p_m, settings.use_clearance_tables)
    if settings.method == "sampled":
        pool = sample_pool(field, body, needed_m, settings.n_samples, settings.redraw_samples, seed)
        return SampledTest(tables, pool, steps)
    arrays = collision_arrays_of(field, body, needed_m)
    if settings.method == "exact":
        return ExactTest(tables, arrays, body.params, steps)
    is_exact |= margin_m + arrays.max_circle_radius_m + MIN_REACH_M > SLAB_REACH_M
    return ContinuousTest(tables, arrays, body.params, float(margin_m), settings.resolution_m, is_exact)


def verification_test(field: DistanceField, body: ToolBody, margin_m: float) -> SegmentTest:
    """Build the test that verifies paths, for planner and schedule alike: exact, at the finest resolution."""
    return segment_test(field, body, margin_m, CheckSettings(resolution_m=FINEST_M), is_exact=True)


def is_segment_safe(test: SegmentTest, start: Array, end: Array) -> bool:
    """Return whether the segment between two poses (4,) passes; symmetric in its ends, yaw turns linearly.

    Raises:
        SettingsError: a pose is not finite, or farther than 1000 m or 1000 rad from 0.
    """
    ends = as_rows((start, end), 4, "the poses of a segment")
    return bool(segment_passes(test, ends[0], ends[1]))


def body_clearance_m(test: SegmentTest, poses: Array, exact_below_m: float = 0.0) -> Array:
    """Lower bound d_o (N,) of the distance of the body to the unsafe set, table included, at poses (N, 4).

    Args:
        exact_below_m: bounds below this are replaced by the exact distance to the voxels, which is slower.

    Raises:
        SettingsError: the test is a sampled one, which has no distances; or a pose is not finite, or farther than
            1000 m or 1000 rad from 0.
    """
    if isinstance(test, SampledTest):
        raise SettingsError("method sampled has no clearances; make the test with method exact or continuous")
    poses = as_rows(poses, 4, "poses")
    return np.asarray(_clearances(test.tables, test.arrays, test.body, poses, float(exact_below_m)))


@compiled
def _clearances(tables, arrays, body, poses, exact_m):  # type: ignore[no-untyped-def]
    """Clearances (N,); those below ``exact_m`` are measured exactly."""
    clearance_m = np.empty(len(poses))
    for n in range(len(poses)):
        pose = as_pose(poses[n])
        clearance_m[n] = max(clearance_of_pose(arrays, body, pose), table_clearance_m(tables, pose))
        if clearance_m[n] < exact_m:
            clearance_m[n] = max(clearance_m[n], exact_clearance(arrays, body, pose, 0.0, exact_m))
    return clearance_m
