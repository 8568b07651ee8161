"""The yaw clearance table against an independent audit, and against the segment tests."""

from collections.abc import Callable

import numpy as np
import pytest

from deltasafe.planning import CheckSettings, DistanceField, ToolBody, body_clearance_m, is_segment_safe, segment_test
from deltasafe.planning.collision.clearance_tables import table_clearance_m
from deltasafe.planning.collision.yaw_clearance_table import BINS, is_free_by_yaw, yaw_clearance_table
from deltasafe.scene import OccupancyGrid
from deltasafe.studies.planner.scenes import EllipticDisc

LOW, HIGH = np.array([-0.16, -0.11, 0.0, -4.0]), np.array([0.16, 0.11, 0.2, 4.0])
BODIES = ToolBody(), EllipticDisc(), ToolBody(semi_axis_x_m=0.012, semi_axis_y_m=0.025, thickness_m=0.002)
CLEAR_M = 0.006


@pytest.fixture(scope="module", params=range(3))
def field(make_grid: Callable[..., OccupancyGrid], request: pytest.FixtureRequest) -> DistanceField:
    return DistanceField.build(make_grid(request.param), 0.05)


def free(field: DistanceField, body: ToolBody, clear_m: float, poses: np.ndarray) -> np.ndarray:
    table = yaw_clearance_table(field, body, clear_m)
    return np.array([is_free_by_yaw(table, field.arrays.lattice, tuple(pose)) for pose in poses])


@pytest.mark.parametrize("body", BODIES)
def test_free_poses_keep_the_clearance(field: DistanceField, body: ToolBody, audit: Callable[..., float]) -> None:
    poses = np.random.default_rng(1).uniform(LOW, HIGH, (500, 4))
    is_free = free(field, body, CLEAR_M, poses)
    assert 50 < is_free.sum() < 450
    for pose in poses[is_free][:80]:
        assert audit(field.grid, 0.05, body, CLEAR_M, np.array([pose, pose])) == 0


@pytest.mark.parametrize("body", BODIES)
def test_poses_with_more_clearance_than_the_table_loses_are_free(field: DistanceField, body: ToolBody) -> None:
    """The table loses two voxels along each axis, and the turn within a bin."""
    poses = np.random.default_rng(2).uniform(LOW, HIGH, (3000, 4))
    voxel_m = field.grid.voxel_m
    lost_m = 2 * voxel_m * np.sqrt(3) + abs(body.semi_axis_x_m - body.semi_axis_y_m) * np.pi / BINS
    wide = body_clearance_m(segment_test(field, body, 0.0), poses) > CLEAR_M + lost_m
    assert wide.sum() > 100
    assert free(field, body, CLEAR_M, poses)[wide].all()


@pytest.mark.parametrize("body", BODIES[:2])
def test_table_accepts_most_poses_that_the_coarse_table_does_not(field: DistanceField, body: ToolBody) -> None:
    poses = np.random.default_rng(3).uniform(LOW, HIGH, (2000, 4))
    plain, with_yaw = (
        segment_test(field, body, 0.001, CheckSettings("exact", by_yaw=by_yaw)).tables for by_yaw in (False, True)
    )
    assert plain.by_yaw.clear_m < 0 < with_yaw.by_yaw.clear_m
    needed_m = with_yaw.by_yaw.clear_m
    coarse = np.array([table_clearance_m(plain, tuple(pose)) >= needed_m for pose in poses])
    clear = body_clearance_m(segment_test(field, body, 0.0), poses) >= needed_m
    assert (free(field, body, needed_m, poses) & ~coarse).sum() > 0.5 * (clear & ~coarse).sum() > 50


@pytest.mark.parametrize("method", ["sampled", "exact", "continuous"])
def test_answers_with_the_table_are_safe(field: DistanceField, method: str, audit: Callable[..., float]) -> None:
    """The sampled test answers the same; the others accept some more segments, all of them safe."""
    body, rng = ToolBody(), np.random.default_rng(4)
    starts = rng.uniform(LOW, HIGH, (400, 4))
    ends = starts + rng.normal(size=(400, 4)) * np.array([0.06, 0.06, 0.03, 0.5])
    tests = [segment_test(field, body, 0.001, CheckSettings(method, by_yaw=by_yaw)) for by_yaw in (False, True)]
    one, other = (np.array([is_segment_safe(test, a, b) for a, b in zip(starts, ends, strict=True)]) for test in tests)
    if method == "sampled":
        assert (one == other).all()
    assert 20 < other.sum() < 380
    gained = other & ~one
    for a, b in zip(starts[gained], ends[gained], strict=True):
        assert audit(field.grid, 0.05, body, 0.001, np.array([a, b])) == 0


def test_table_is_cached_per_field_body_and_clearance(field: DistanceField) -> None:
    first = yaw_clearance_table(field, ToolBody(), CLEAR_M)
    assert yaw_clearance_table(field, ToolBody(), CLEAR_M) is first
    assert yaw_clearance_table(field, ToolBody(thickness_m=0.011), CLEAR_M) is not first
    assert yaw_clearance_table(field.at_delta(0.2), ToolBody(), CLEAR_M) is not first
