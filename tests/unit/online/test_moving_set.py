"""The growing unsafe set, against closed forms and a brute-force distance."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from deltasafe.online.moving_set import MovingSet
from deltasafe.planning import ToolBody, TrackingBound
from deltasafe.scene import OccupancyGrid

VOXEL_M = 0.01
DELTA = 0.05
TRACKING = TrackingBound(0.001, 0.05)
BODY = ToolBody()


def block(margin_m: float = 0.0, v_hand_mps: float = 0.2) -> MovingSet:
    """A hand of one column of voxels at x, y in [0, 0.01], 0.1 m high, in a view of 1 m."""
    p_occupied = np.zeros((100, 100, 10), np.float32)
    p_occupied[50, 50] = 1.0
    grid = OccupancyGrid(p_occupied, np.array([-0.5, -0.5, 0.0]), VOXEL_M)
    return MovingSet(grid, DELTA, 0.0, v_hand_mps, margin_m, BODY, 0.25)


SET = block()


def held(x_m: float, until_s: float, z_m: float = 0.05) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A tool that rests on the left of the hand."""
    return np.array([0.0, until_s]), np.array([[x_m, 0.005, z_m, 0.0]] * 2), np.zeros(2)


def allowed_s(x_m: float) -> float:
    """When the hand may have reached a resting tool: its tip is at x + 0.03, the hand begins at x = 0."""
    return (-x_m - BODY.semi_axis_x_m - float(TRACKING.error_m(0.01))) / SET.v_hand_mps


@settings(max_examples=40, deadline=None)
@given(x_m=st.floats(-0.2, -0.05), share=st.floats(0.0, 3.0))
def test_a_pose_is_never_accepted_longer_than_the_hand_needs(x_m: float, share: float) -> None:
    until_s = share * allowed_s(x_m)
    refused = SET.refusal(*held(x_m, max(until_s, 1e-3)), TRACKING, 0.01) is not None
    if until_s > allowed_s(x_m):
        assert refused
    if max(until_s, 1e-3) < allowed_s(x_m) - VOXEL_M / SET.v_hand_mps:  # the bound loses at most a voxel
        assert not refused


def test_margin_adds_to_the_distance() -> None:
    until_s = allowed_s(-0.15) - 0.06
    assert SET.refusal(*held(-0.15, until_s), TRACKING, 0.01) is None
    assert block(0.03).refusal(*held(-0.15, until_s), TRACKING, 0.01) is not None


def test_the_table_does_not_grow_but_is_kept() -> None:
    low = held(-0.25, 0.3, 0.0059)
    assert SET.refusal(*held(-0.25, 0.3, 0.0066), TRACKING, 0.01) is None
    refusal = SET.refusal(*low, TRACKING, 0.01)
    assert refusal is not None
    assert refusal.missing_m == pytest.approx(0.0006, abs=1e-6)


def test_space_beside_the_view_grows() -> None:
    times, _, speeds = held(0.0, 0.9)
    at_border = np.array([[0.0, 0.40, 0.05, 0.0]] * 2)
    assert SET.refusal(times, at_border, speeds, TRACKING, 0.01) is not None
    assert SET.refusal(times / 10, at_border, speeds, TRACKING, 0.01) is None


@settings(max_examples=40, deadline=None)
@given(
    start=st.tuples(st.floats(-0.2, 0.2), st.floats(-0.2, 0.2), st.floats(0.02, 0.15), st.floats(-1.5, 1.5)),
    step=st.tuples(st.floats(-0.1, 0.1), st.floats(-0.1, 0.1), st.floats(-0.01, 0.05), st.floats(-1, 1)),
    duration_s=st.floats(0.05, 0.5),
)
def test_an_accepted_piece_is_clear_between_its_samples(
    start: tuple[float, ...], step: tuple[float, ...], duration_s: float
) -> None:
    poses = np.array([start, np.add(start, step)])
    moved = float(np.linalg.norm(step[:3]) + BODY.rho_max_m * abs(step[3]))
    speeds = np.full(2, moved / duration_s)
    if SET.refusal(np.array([0.0, duration_s]), poses, speeds, TRACKING, 0.01) is not None:
        return
    angle = np.linspace(0, 2 * np.pi, 90)
    rim = np.column_stack([0.03 * np.cos(angle), 0.015 * np.sin(angle), np.zeros(90)])
    for share in np.linspace(0, 1, 21):
        pose = poses[0] + share * (poses[1] - poses[0])
        cos, sin = np.cos(pose[3]), np.sin(pose[3])
        points = rim @ np.array([[cos, sin, 0], [-sin, cos, 0], [0, 0, 1]]) + pose[:3]
        gap = np.maximum(np.maximum([0, 0, 0] - points, points - [0.01, 0.01, 0.1]), 0)
        needed = SET.v_hand_mps * share * duration_s + float(TRACKING.error_m(max(moved / duration_s, 0.01)))
        assert np.linalg.norm(gap, axis=1).min() >= needed


def test_grown_field_is_the_set_dilated() -> None:
    grown = SET.grown(0.3)  # 6 cm
    clear_m = float(grown.clearance_m(np.array([[-0.1, 0.005, 0.05]]))[0])
    assert 0.04 - 2.5 * VOXEL_M <= clear_m <= 0.04
    assert grown.clearance_m(np.array([[-0.05, 0.005, 0.05]]))[0] <= 0
    assert grown.clearance_m(np.array([[0.005, 0.005, 0.14]]))[0] <= 0
    assert grown.clearance_m(np.array([[-0.085, 0.005, 0.05]]))[0] > 0
