"""The argument: whatever images arrive, a hand that keeps v_hand is not touched while the tool moves."""

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from deltasafe.online.committed import Committed
from deltasafe.online.moving_set import MovingSet
from deltasafe.online.settings import OnlineSettings
from deltasafe.online.supervisor import Supervisor
from deltasafe.planning import ToolBody, TrackingBound
from deltasafe.scene import OccupancyGrid
from evidence.online_audit import Tool, touches
from tests.unit.online.test_committed import LENGTH_M, V_MPS, straight_path

V_HAND_MPS = 0.25
SETTINGS = OnlineSettings(v_hand_mps=V_HAND_MPS)
TRACKING = TrackingBound(0.001, 0.05)
VOXEL_M, EXTENT_M, HAND_M, HEIGHT_M = 0.02, 0.6, 0.04, 0.12
Z_M = 0.05


def hand_points(center: np.ndarray) -> np.ndarray:
    """Points of a box around a center (2,)."""
    flat = np.linspace(-HAND_M / 2, HAND_M / 2, 9)
    x, y, z = np.meshgrid(flat, flat, np.linspace(0, HEIGHT_M, 13), indexing="ij")
    return np.column_stack([x.ravel() + center[0], y.ravel() + center[1], z.ravel()])


def seen(center: np.ndarray, captured_s: float) -> MovingSet:
    """The set of a perfect image of the box; all other space is free, so that only the hand can stop the tool."""
    count = round(2 * EXTENT_M / VOXEL_M)
    edges = -EXTENT_M + VOXEL_M * np.arange(count + 1)
    inside = [(edges[1:] > c - HAND_M / 2) & (edges[:-1] < c + HAND_M / 2) for c in center]
    p_occupied = np.repeat((inside[0][:, None] & inside[1])[:, :, None], round(HEIGHT_M / VOXEL_M), axis=2)
    grid = OccupancyGrid(p_occupied.astype(np.float32), np.array([-EXTENT_M, -EXTENT_M, 0.0]), VOXEL_M)
    return MovingSet(grid, 0.05, captured_s, V_HAND_MPS, 0.0, ToolBody(), 0.3)


def drive(seed: int, chase: float, lost: float, latency_s: float) -> tuple[list[Committed], bool, float]:
    """Drive the straight path beside a hand that partly chases the tool; return references, contact, way driven."""
    rng = np.random.default_rng(seed)
    path = straight_path(Z_M)
    supervisor = Supervisor(path.trajectory.poses[0], 0.0, TRACKING, 0.01, SETTINGS)
    hand = np.array([rng.uniform(0.1, 0.4), rng.uniform(-0.3, 0.3)])
    images: list[tuple[float, np.ndarray]] = []
    references, touched, newest = [], False, None
    for cycle in range(40):
        now_s = cycle * SETTINGS.cycle_s
        if cycle % 2 == 0 and rng.random() >= lost:
            images.append((now_s, hand.copy()))
        arrived = [image for image in images if image[0] + latency_s <= now_s]
        before = supervisor.committed
        if arrived:
            if newest is None or arrived[-1][0] != newest.captured_s:
                newest = seen(arrived[-1][1], arrived[-1][0])
            supervisor.advance(now_s, newest, path)
        references.append(supervisor.committed)
        for time_s in now_s + np.linspace(0, SETTINGS.cycle_s, 5, endpoint=False):
            reference, speed = before.at(time_s)
            off = rng.normal(size=3)
            off *= float(TRACKING.error_m(max(speed, 0.01))) / np.linalg.norm(off)
            tool = np.append(reference[:3] + off, reference[3])
            touched |= before.is_moving_at(time_s) and speed > 0 and touches(Tool(), tool, hand_points(hand))
            way = tool[:2] - hand if rng.random() < chase else rng.normal(size=2)
            hand = hand + way / max(np.linalg.norm(way), 1e-9) * V_HAND_MPS * SETTINGS.cycle_s / 5
    return references, touched, float(references[-1].at(2.0)[0][0])


@settings(max_examples=8, deadline=None)
@given(
    seed=st.integers(0, 10**6),
    chase=st.floats(0, 1),
    lost=st.sampled_from([0.0, 0.3, 0.9]),
    latency_s=st.sampled_from([0.0, 0.1, 0.2]),
)
def test_a_hand_that_keeps_its_speed_is_not_touched_by_a_moving_tool(
    seed: int, chase: float, lost: float, latency_s: float
) -> None:
    references, touched, _ = drive(seed, chase, lost, latency_s)
    assert not touched
    for cycle, reference in enumerate(references):  # there is always a verified way to stop
        rest_s = cycle * SETTINGS.cycle_s + SETTINGS.stopping_time_s(V_MPS)
        assert not reference.is_moving_at(rest_s)
    for one, other in itertools.pairwise(references):  # the reference never jumps
        later_s = float(other.time_s[-1])
        for time_s in np.linspace(later_s - 0.3, later_s, 20):
            assert np.linalg.norm(other.at(time_s + 0.0025)[0] - other.at(time_s)[0]) <= V_MPS * 0.0025 + 1e-6
        assert one.time_s[0] <= other.time_s[0]


def test_a_hand_far_off_does_not_keep_the_tool_from_moving() -> None:
    assert drive(seed=3, chase=0.0, lost=0.0, latency_s=0.1)[2] > 0.02


def test_without_a_hand_in_reach_the_path_is_driven_to_its_end_without_delay() -> None:
    path = straight_path(Z_M)
    supervisor = Supervisor(path.trajectory.poses[0], 0.0, TRACKING, 0.01, SETTINGS)
    count = round((path.trajectory.duration_s + 2 * SETTINGS.cycle_s) / SETTINGS.cycle_s)
    moving_set = seen(np.array([-0.5, 0.5]), 0.0)
    for cycle in range(count):
        moving_set.captured_s = cycle * SETTINGS.cycle_s
        supervisor.advance(cycle * SETTINGS.cycle_s, moving_set, path)
    assert supervisor.committed.at(count * SETTINGS.cycle_s)[0][0] == pytest.approx(LENGTH_M, abs=1e-6)


def test_the_loop_that_ends_leaves_the_arm_to_its_verified_braking() -> None:
    path = straight_path(Z_M)
    supervisor = Supervisor(path.trajectory.poses[0], 0.0, TRACKING, 0.01, SETTINGS)
    moving_set = seen(np.array([-0.5, 0.5]), 0.0)
    for cycle in range(12):
        moving_set.captured_s = cycle * SETTINGS.cycle_s
        supervisor.advance(cycle * SETTINGS.cycle_s, moving_set, path)
    last_s = 11 * SETTINGS.cycle_s
    assert supervisor.committed.is_moving_at(last_s)
    assert not supervisor.committed.is_moving_at(last_s + SETTINGS.stopping_time_s(V_MPS))
