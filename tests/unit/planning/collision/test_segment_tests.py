"""The three segment tests against an independent audit, against each other, and their symmetries."""

import dataclasses
from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from deltasafe.errors import SettingsError
from deltasafe.planning import (
    CheckSettings,
    DistanceField,
    SegmentTest,
    ToolBody,
    body_clearance_m,
    is_segment_safe,
    segment_test,
)
from deltasafe.planning.collision.distance_field import REACH_M
from deltasafe.planning.collision.segment_tests import METHODS
from deltasafe.scene import OccupancyGrid

BODY = ToolBody()
LOW, HIGH = np.array([-0.16, -0.11, 0.015, -1.6]), np.array([0.16, 0.11, 0.14, 1.6])
FIXED = settings(max_examples=40, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])


def segments(seed: int, count: int, length: float = 0.06) -> list[tuple[np.ndarray, np.ndarray]]:
    rng = np.random.default_rng(seed)
    starts = rng.uniform(LOW, HIGH, (count, 4))
    ends = starts + rng.normal(size=(count, 4)) * length * np.array([1, 1, 0.5, 8])
    return list(zip(starts, ends, strict=True))


def answers(test: SegmentTest, pairs: list) -> np.ndarray:
    return np.array([is_segment_safe(test, a, b) for a, b in pairs])


@pytest.fixture(scope="module")
def grids(make_grid: Callable[..., OccupancyGrid]) -> list[OccupancyGrid]:
    return [make_grid(seed) for seed in range(3)]


@pytest.mark.parametrize("method", ["exact", "continuous"])
def test_accepted_segments_hold_no_unsafe_pose(
    method: str, grids: list[OccupancyGrid], audit: Callable[..., float]
) -> None:
    margin_m, n_accepted = 0.001, 0
    for grid in grids:
        test = segment_test(DistanceField.build(grid, 0.05), BODY, margin_m, CheckSettings(method=method))
        for a, b in segments(1, 70):
            if is_segment_safe(test, a, b):
                n_accepted += 1
                assert audit(grid, 0.05, BODY, margin_m, np.array([a, b])) == 0
    assert n_accepted > 25


def test_continuous_test_accepts_segments_with_8_mm_to_spare(
    grids: list[OccupancyGrid], audit: Callable[..., float]
) -> None:
    # 8 mm cover the losses of bounding balls and voxels
    n_wide = 0
    for grid in grids:
        test = segment_test(DistanceField.build(grid, 0.05), BODY, 0.001)
        for a, b in segments(2, 60):
            if audit(grid, 0.05, BODY, 0.009, np.array([a, b]), 0.003) == 0:
                n_wide += 1
                assert is_segment_safe(test, a, b)
    assert n_wide > 15


def test_sampled_accepts_most_segments_and_exact_fewest(grids: list[OccupancyGrid]) -> None:
    counts = dict.fromkeys(METHODS, 0)
    for grid in grids:
        field = DistanceField.build(grid, 0.05)
        for method in METHODS:
            test = segment_test(field, BODY, 0.0005, CheckSettings(method=method, n_samples=20))
            counts[method] += answers(test, segments(3, 150)).sum()
    # exact adds half a step to the margin everywhere, continuous only what it needs; sampling misses thin overlaps
    assert counts["exact"] < counts["continuous"] < counts["sampled"]


@pytest.mark.parametrize("method", METHODS)
def test_answers_are_symmetric(method: str, grids: list[OccupancyGrid]) -> None:
    test = segment_test(DistanceField.build(grids[0], 0.05), BODY, 0.001, CheckSettings(method=method))
    pairs = segments(4, 200)
    forward, backward = answers(test, pairs), answers(test, [(b, a) for a, b in pairs])
    assert (forward == backward).all()
    assert 0 < forward.sum() < len(forward)


@pytest.mark.parametrize("method", ["sampled", "exact"])
def test_clearance_tables_change_no_answer(method: str, grids: list[OccupancyGrid]) -> None:
    for grid in grids:
        field = DistanceField.build(grid, 0.05)
        on, off = (
            segment_test(field, BODY, 0.001, CheckSettings(method=method, use_clearance_tables=flag), seed=5)
            for flag in (True, False)
        )
        assert (answers(on, segments(5, 300)) == answers(off, segments(5, 300))).all()


def test_finer_resolution_accepts_all_segments_of_a_coarser_one(grids: list[OccupancyGrid]) -> None:
    """Therefore the verification, which is the finest, never refuses a path that the search accepted."""
    gained = 0
    for grid in grids:
        field = DistanceField.build(grid, 0.05)
        coarse, fine = (
            answers(segment_test(field, BODY, 0.001, CheckSettings(resolution_m=resolution_m)), segments(7, 300))
            for resolution_m in (0.002, 0.00025)
        )
        assert (fine >= coarse).all()
        gained += int((fine > coarse).sum())
    assert gained > 0


@pytest.mark.parametrize("n_samples", [1, 15, 16, 17, 100, 333])
def test_sampled_test_equals_a_look_up_of_each_sample(n_samples: int, grids: list[OccupancyGrid]) -> None:
    """The test reads whole blocks: it must ignore the padding of the last block, and clamp points to the lattice."""
    rng = np.random.default_rng(n_samples)
    poses = rng.uniform(LOW - 0.03, HIGH + 0.03, (300, 4))
    free = 0
    for grid in grids:
        field = DistanceField.build(grid, 0.05)
        lattice, shape = field.arrays.lattice, np.array(field.arrays.squared_distance.shape)
        settings = CheckSettings("sampled", n_samples, redraw_samples=False, use_clearance_tables=False)
        test = segment_test(field, BODY, 0.001, settings, seed=3)
        points = test.pool.points[:, :n_samples].astype(np.float64).T / lattice.per_m
        accepted = answers(test, [(pose, pose) for pose in poses])
        for pose, answer in zip(poses, accepted, strict=True):
            cos, sin = np.cos(pose[3]), np.sin(pose[3])
            placed = points @ np.array([[cos, sin, 0], [-sin, cos, 0], [0, 0, 1]]) + pose[:3]
            voxels = (placed - np.array(lattice[:3])) * lattice.per_m
            if (np.abs(voxels - np.round(voxels)) < 2e-4).any():  # too close to a face for single precision
                continue
            index = np.clip(np.floor(voxels), 0, shape - 1).astype(int)
            unsafe = field.arrays.squared_distance[tuple(index.T)] == 0
            assert answer == (not unsafe.any() and (placed[:, 2] >= field.arrays.table_z_m).all())
            free += answer
    assert free > 20


def test_exact_test_accepts_only_segments_that_the_sampled_test_accepts(grids: list[OccupancyGrid]) -> None:
    for grid in grids:
        field = DistanceField.build(grid, 0.05)
        sampled = segment_test(field, BODY, 0.001, CheckSettings(method="sampled", n_samples=300), seed=5)
        exact = segment_test(field, BODY, 0.001, CheckSettings(method="exact"))
        pairs = segments(6, 200)
        assert (answers(sampled, pairs) >= answers(exact, pairs)).all()


def test_more_samples_accept_fewer_segments_and_seeds_differ(grids: list[OccupancyGrid]) -> None:
    field = DistanceField.build(grids[1], 0.05)
    few, many, other = (
        answers(segment_test(field, BODY, 0.001, CheckSettings(method="sampled", n_samples=n), seed), segments(6, 300))
        for n, seed in ((5, 0), (2000, 0), (5, 1))
    )
    assert many.sum() < few.sum()
    assert (few != other).any()


def accepts_a_subset(strict: SegmentTest, lax: SegmentTest, seed: int) -> bool:
    pairs = segments(seed, 20)
    return bool((answers(strict, pairs) <= answers(lax, pairs)).all())


@FIXED
@given(st.integers(0, 10**6), st.floats(0.02, 0.4), st.floats(0.02, 0.4))
def test_exact_test_with_smaller_delta_accepts_a_subset(
    grids: list[OccupancyGrid], seed: int, one: float, other: float
) -> None:
    fields = [DistanceField.build(grids[seed % 3], delta) for delta in sorted((one, other))]
    strict, lax = (segment_test(field, BODY, 0.001, CheckSettings(method="exact")) for field in fields)
    assert accepts_a_subset(strict, lax, seed)


@FIXED
@given(st.integers(0, 10**6), st.floats(0, 0.01), st.floats(0, 0.01))
def test_exact_test_with_larger_margin_accepts_a_subset(
    grids: list[OccupancyGrid], seed: int, one: float, other: float
) -> None:
    field = DistanceField.build(grids[seed % 3], 0.05)
    lax, strict = (
        segment_test(field, BODY, margin_m, CheckSettings(method="exact")) for margin_m in sorted((one, other))
    )
    assert accepts_a_subset(strict, lax, seed)


def test_continuous_test_with_smaller_delta_or_larger_margin_accepts_a_subset(grids: list[OccupancyGrid]) -> None:
    """With fixed draws: steps depend on the margin, so that nearly equal margins may rarely reverse an answer.

    Of 16,000 segments, 4 were refused that a margin larger by less than 0.1 mm accepts.
    """
    rng = np.random.default_rng(0)
    for seed in range(40):
        low, high = (DistanceField.build(grids[seed % 3], delta) for delta in np.sort(rng.uniform(0.02, 0.4, 2)))
        small_m, large_m = np.sort(rng.uniform(0, 0.01, 2))
        assert accepts_a_subset(segment_test(low, BODY, small_m), segment_test(high, BODY, small_m), seed)
        assert accepts_a_subset(segment_test(low, BODY, large_m), segment_test(low, BODY, small_m), seed)


def test_shaft_collides_with_a_bar_above_the_disc() -> None:
    p_occupied = np.zeros((60, 40, 20), np.float32)
    p_occupied[28:32, :, 14:18] = 1.0
    field = DistanceField.build(OccupancyGrid(p_occupied, np.zeros(3), 0.005), 0.05)
    test = segment_test(field, BODY, 0.0005)
    assert is_segment_safe(test, np.array([0.05, 0.1, 0.03, 0.0]), np.array([0.10, 0.1, 0.03, 0.0]))
    assert not is_segment_safe(test, np.array([0.05, 0.1, 0.03, 0.0]), np.array([0.25, 0.1, 0.03, 0.0]))
    assert field.clearance_m(np.array([[0.15, 0.1, 0.03]]))[0] > 0.02


def test_table_is_an_obstacle_and_space_above_the_grid_is_free() -> None:
    field = DistanceField.build(OccupancyGrid(np.zeros((80, 60, 8), np.float32), np.zeros(3), 0.005), 0.05)
    test = segment_test(field, BODY, 0.001)
    poses = np.array([[0.2, 0.15, z, 0.0] for z in (0.004, 0.0055, 0.0065, 0.02)])
    assert [is_segment_safe(test, pose, pose) for pose in poses] == [False, False, True, True]
    np.testing.assert_allclose(body_clearance_m(test, poses), poses[:, 2] - 0.005, atol=1e-9)
    far = np.array([5.0, 5.0, 0.08, 0.0]), np.array([-5.0, 5.0, 0.08, 3.0])
    assert is_segment_safe(test, *far)
    low = np.array([0.2, 0.15, 0.02, 0.0]), np.array([0.39, 0.15, 0.02, 0.0])
    assert not is_segment_safe(test, *low)  # half of the disc would leave the grid


def test_body_clearance_is_a_tight_lower_bound(grids: list[OccupancyGrid]) -> None:
    """Compared with the distance field at 20,000 points of the body."""
    field = DistanceField.build(grids[2], 0.05)
    test = segment_test(field, BODY, 0.0)
    poses = np.random.default_rng(8).uniform(LOW, HIGH, (60, 4))
    points = BODY.samples(0.0, 20000, 1)
    points = points[points[:, 2] < 0.1]
    for pose, clearance_m in zip(poses, body_clearance_m(test, poses), strict=True):
        cos, sin = np.cos(pose[3]), np.sin(pose[3])
        at_points = field.clearance_m(points @ np.array([[cos, sin, 0], [-sin, cos, 0], [0, 0, 1]]) + pose[:3])
        # the clearance at points is itself a bound, at most one voxel diagonal loose, and capped
        assert min(clearance_m, REACH_M) <= at_points.min() + field.grid.voxel_m
        if at_points.min() > 0:
            assert clearance_m >= at_points.min() - 0.006


BAD = [np.nan, np.inf, -np.inf, 1e300, -1e300, 1e12]


@pytest.mark.parametrize("value", BAD)
@pytest.mark.parametrize("method", METHODS)
def test_non_finite_or_far_poses_are_refused(method: str, value: float, grids: list[OccupancyGrid]) -> None:
    """Compiled look-ups convert poses to indices: NaN would crash the process, infinity would loop forever."""
    test = segment_test(DistanceField.build(grids[0], 0.05), BODY, 0.001, CheckSettings(method=method))
    sound = np.array([0.0, 0.0, 0.1, 0.0])
    for axis in range(4):
        bad = sound.copy()
        bad[axis] = value
        for ends in ((sound, bad), (bad, sound), (bad, bad), (bad, -bad)):
            with pytest.raises(SettingsError, match="must be finite and within 1000"):
                is_segment_safe(test, *ends)
        if method != "sampled":
            with pytest.raises(SettingsError, match="row 1"):
                body_clearance_m(test, np.array([sound, bad]))


@pytest.mark.parametrize("method", METHODS)
def test_poses_of_wrong_shape_are_refused(method: str, grids: list[OccupancyGrid]) -> None:
    test = segment_test(DistanceField.build(grids[0], 0.05), BODY, 0.001, CheckSettings(method=method))
    for wrong in (np.zeros(3), np.zeros(5), np.zeros((1, 4)), 0.0, None, "pose", [None] * 4):
        with pytest.raises(SettingsError, match="poses"):
            is_segment_safe(test, wrong, wrong)  # type: ignore[arg-type]
    if method != "sampled":
        for wrong in (np.zeros(4), np.zeros((2, 3)), np.zeros((2, 2, 4))):
            with pytest.raises(SettingsError, match="poses"):
                body_clearance_m(test, wrong)
        assert body_clearance_m(test, np.zeros((0, 4))).shape == (0,)
        single = np.array([[0.0, 0.0, 0.1, 0.0]])
        assert body_clearance_m(test, single.astype(np.float32)) == pytest.approx(body_clearance_m(test, single))


@pytest.mark.parametrize("method", METHODS)
def test_space_far_beside_the_grid_is_unsafe_below_its_top_and_free_above(
    method: str, grids: list[OccupancyGrid]
) -> None:
    test = segment_test(DistanceField.build(grids[0], 0.05), BODY, 0.001, CheckSettings(method=method))
    for x, y, z, free in ((900.0, 900.0, 0.05, False), (900.0, 900.0, 0.5, True), (900.0, -900.0, 900.0, True)):
        end = np.array([x, y, z, 900.0])
        assert is_segment_safe(test, end, end) == free
        assert is_segment_safe(test, end * [-1, 1, 1, 1], end) == free
    below = np.array([0.0, 0.0, -900.0, 0.0])
    assert not is_segment_safe(test, below, below)


@pytest.mark.parametrize(
    "changes",
    [
        {"method": "hope"},
        {"n_samples": 0},
        {"n_samples": 10.5},
        {"n_samples": float("nan")},
        {"delta_p_m": 0.0},
        {"resolution_m": float("nan")},
    ],
)
def test_settings_out_of_domain_are_refused(changes: dict) -> None:
    with pytest.raises(SettingsError, match=next(iter(changes))):
        dataclasses.replace(CheckSettings(), **changes)
