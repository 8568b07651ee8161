"""Answers are invariant under rigid motions of the world."""

from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from deltasafe.planning import CheckSettings, DistanceField, ToolBody, body_clearance_m, is_segment_safe, segment_test
from deltasafe.scene import OccupancyGrid

BODY = ToolBody()
FIXED = settings(max_examples=30, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])


@pytest.fixture(scope="module")
def grid(make_grid: Callable[..., OccupancyGrid]) -> OccupancyGrid:
    return make_grid(1)


def random_segments(seed: int, count: int) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    starts = rng.uniform([-0.16, -0.11, 0.015, -1.6], [0.16, 0.11, 0.14, 1.6], (count, 4))
    return starts, starts + rng.normal(size=(count, 4)) * np.array([0.04, 0.04, 0.02, 0.4])


def answers(grid: OccupancyGrid, method: str, starts: np.ndarray, ends: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    test = segment_test(DistanceField.build(grid, 0.05), BODY, 0.001, CheckSettings(method=method))
    safe = [is_segment_safe(test, a, b) for a, b in zip(starts, ends, strict=True)]
    return np.array(safe), body_clearance_m(test, starts)


@FIXED
@given(st.sampled_from(["exact", "continuous"]), st.integers(0, 10**6), st.tuples(*[st.integers(-40, 40)] * 2))
def test_shift_by_whole_voxels_changes_no_clearance(
    grid: OccupancyGrid, method: str, seed: int, steps: tuple[int, int]
) -> None:
    shift = np.array([*steps, 0]) * grid.voxel_m
    moved = OccupancyGrid(grid.p_occupied, grid.origin_m + shift, grid.voxel_m)
    starts, ends = random_segments(seed, 15)
    by = np.append(shift, 0.0)
    safe, clearance_m = answers(grid, method, starts, ends)
    moved_safe, moved_clearance_m = answers(moved, method, starts + by, ends + by)
    np.testing.assert_allclose(clearance_m, moved_clearance_m, atol=1e-9)
    assert (safe == moved_safe).mean() > 0.99  # rounding decides if a clearance equals the required one


@FIXED
@given(st.sampled_from(["exact", "continuous"]), st.integers(0, 10**6), st.integers(1, 3))
def test_quarter_turn_changes_clearances_by_less_than_a_voxel(
    grid: OccupancyGrid, method: str, seed: int, quarters: int
) -> None:
    middle = grid.origin_m + np.array(grid.p_occupied.shape) * grid.voxel_m / 2
    turned = np.rot90(grid.p_occupied, quarters, axes=(0, 1))
    origin = middle - np.array(turned.shape) * grid.voxel_m / 2
    moved = OccupancyGrid(np.ascontiguousarray(turned), np.array([*origin[:2], grid.origin_m[2]]), grid.voxel_m)
    c, s = np.round([np.cos(quarters * np.pi / 2), np.sin(quarters * np.pi / 2)])

    def turn(poses: np.ndarray) -> np.ndarray:
        x, y = (poses[:, :2] - middle[:2]).T
        rotated = np.column_stack([c * x - s * y, s * x + c * y]) + middle[:2]
        return np.column_stack([rotated, poses[:, 2], poses[:, 3] + quarters * np.pi / 2])

    starts, ends = random_segments(seed, 15)
    safe, clearance_m = answers(grid, method, starts, ends)
    moved_safe, moved_clearance_m = answers(moved, method, turn(starts), turn(ends))
    # the cells of the coarse grid change, and rounding decides voxel faces: bounds differ a little
    assert np.abs(np.minimum(clearance_m, 0.03) - np.minimum(moved_clearance_m, 0.03)).max() < grid.voxel_m
    assert (safe == moved_safe).mean() > 0.8
