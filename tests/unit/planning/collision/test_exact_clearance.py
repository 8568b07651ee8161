"""Exact distances of parts to voxels: closed forms, an optimizer, and tools of any kind and size."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import minimize

from deltasafe.errors import SettingsError
from deltasafe.planning import CheckSettings, DistanceField, ToolBody, ToolPart, is_segment_safe, segment_test
from deltasafe.planning.collision.segment_tests import body_clearance_m, verification_test
from deltasafe.scene import OccupancyGrid

VOXEL_M = 0.005
PARTS = [
    ToolPart("sphere", radius_m=0.004),
    ToolPart("capsule", 0.01, 0, 0.01, 0.03, -0.01, 0.02, 0.006),
    ToolPart("box", -0.01, 0.005, 0, 0.02, 0.004, 0.01, yaw_rad=0.4),
    ToolPart("disc", 0, 0.01, 0.02, 0.03, 0.01, 0.004, radius_m=0.002, yaw_rad=-1.0),
    ToolPart("box", 0, 0, 0.06, 0.15, 0.02, 0.05),
]


def one_voxel() -> OccupancyGrid:
    p_occupied = np.zeros((100, 100, 50), np.float32)
    p_occupied[50, 50, 20] = 1.0
    return OccupancyGrid(p_occupied, np.array([-0.25, -0.25, 0.0]), VOXEL_M)


FIELD = DistanceField.build(one_voxel(), 0.05)
LOW, HIGH = np.array([0.0, 0.0, 0.1]), np.array([0.005, 0.005, 0.105])


def by_optimizer(part: ToolPart, pose: np.ndarray) -> float:
    """Distance of a part to the voxel: minimum over the voxel of the distance to the part, a convex function."""
    cos, sin = math.cos(pose[3]), math.sin(pose[3])
    turn = np.array([[cos, -sin, 0], [sin, cos, 0], [0, 0, 1]])

    def distance_m(point: np.ndarray) -> float:
        return float(part.distance_m(((point - pose[:3]) @ turn)[None])[0])

    starts = [LOW, HIGH, (LOW + HIGH) / 2]
    options = {"xatol": 1e-9, "fatol": 1e-9, "maxiter": 600}
    bounds = list(zip(LOW, HIGH, strict=True))
    return min(minimize(distance_m, s, bounds=bounds, method="Nelder-Mead", options=options).fun for s in starts)


@settings(max_examples=12, deadline=None)
@given(st.sampled_from(PARTS), st.tuples(*[st.floats(-0.05, 0.05)] * 3), st.floats(-3, 3))
def test_distance_of_a_part_to_a_voxel_is_exact(part: ToolPart, shift: tuple[float, ...], yaw_rad: float) -> None:
    pose = np.array([*(np.add(shift, [0.0, 0.0, 0.12])), yaw_rad])
    body = ToolBody(shaft_length_m=0.0, parts=(part,))
    test = verification_test(FIELD, body, 0.0)
    table_m = pose[2] + part.bottom_m
    expected_m = min(by_optimizer(part, pose), table_m)
    measured_m = float(body_clearance_m(test, pose[None], 0.02)[0])
    if expected_m <= 0:
        assert measured_m <= 1e-6
    else:
        assert measured_m <= expected_m + 1e-6
        assert min(measured_m, 0.02) >= min(expected_m, 0.02) - 1e-5


@pytest.mark.parametrize("part", PARTS)
def test_balls_and_distances_agree_with_the_part(part: ToolPart) -> None:
    rng = np.random.default_rng(0)
    points = part.surface_points()
    assert part.distance_m(points).max() < 1e-9
    weights = rng.dirichlet(np.ones(len(points)) / 8, 400)
    inside, balls = np.concatenate([points, weights @ points]), part.balls()
    assert part.distance_m(inside).max() < 1e-9  # convex
    gap = np.linalg.norm(inside[:, None] - balls[:, :3], axis=2) - balls[:, 3]
    assert gap.min(axis=1).max() < 1e-9
    assert np.hypot(*inside[:, :2].T).max() <= part.rho_max_m + 1e-12
    assert np.linalg.norm(inside, axis=1).max() <= part.reach_m + 1e-12
    assert inside[:, 2].min() == pytest.approx(part.bottom_m)


def test_disc_given_as_a_part_has_the_clearance_of_the_disc() -> None:
    disc = ToolBody()
    part = ToolBody(parts=(ToolPart("disc", half_x_m=0.03, half_y_m=0.015, half_z_m=0.005),))
    poses = np.random.default_rng(1).uniform([-0.06, -0.06, 0.05, -2], [0.06, 0.06, 0.15, 2], (200, 4))
    exact = [
        np.clip(body_clearance_m(verification_test(FIELD, body, 0.0), poses, 0.02), 0, 0.02) for body in (disc, part)
    ]
    np.testing.assert_allclose(*exact, atol=3e-6)
    loose_m = body_clearance_m(segment_test(FIELD, disc, 0.0), poses)
    assert (exact[0] >= np.minimum(loose_m, 0.02) - 1e-9).all()


def slot(width: int) -> DistanceField:
    p_occupied = np.ones((60, 60, 20), np.float32)
    p_occupied[:, 30 : 30 + width] = 0.0
    return DistanceField.build(OccupancyGrid(p_occupied, np.zeros(3), 0.0025), 0.05)


@pytest.mark.parametrize("width", [14, 15, 16, 20])
def test_slot_as_wide_as_tool_and_margin_is_passed(width: int) -> None:
    """The disc is 30 mm wide; a slot of 14 voxels leaves 2.5 mm on each side, exactly the margin and the rounding."""
    middle_m = (30 + width / 2) * 0.0025
    ends = np.array([[0.045, middle_m, 0.02, 0.0], [0.105, middle_m, 0.03, 0.0]])
    side_m = width * 0.0025 / 2 - 0.015
    for margin_m, passes in ((side_m - 0.0003, True), (side_m + 1e-5, False)):
        assert is_segment_safe(verification_test(slot(width), ToolBody(), margin_m), *ends) == passes


@pytest.mark.parametrize("semi_axis_m", [0.0025, 0.035, 0.06, 0.12, 0.15])
def test_discs_of_any_size_move_through_an_empty_field_and_15_mm_above_a_box(semi_axis_m: float) -> None:
    body = ToolBody(semi_axis_m, semi_axis_m / 2, 0.01, shaft_radius_m=0.001)
    p_occupied = np.zeros((240, 240, 16), np.float32)
    free = DistanceField.build(OccupancyGrid(p_occupied, np.array([-0.6, -0.6, 0]), VOXEL_M), 0.05)
    p_occupied = p_occupied.copy()
    p_occupied[110:130, 110:130, :8] = 1.0
    box = DistanceField.build(OccupancyGrid(p_occupied, np.array([-0.6, -0.6, 0]), VOXEL_M), 0.05)
    ends = np.array([[-0.2, 0, 0.06, 0.0], [0.2, 0, 0.06, 1.0]])
    for field in (free, box):
        assert is_segment_safe(verification_test(field, body, 0.005), *ends)
    assert not is_segment_safe(verification_test(box, body, 0.0155), *ends)


def test_other_methods_refuse_parts_and_dimensions_are_checked() -> None:
    for method in ("sampled", "exact"):
        with pytest.raises(SettingsError, match="continuous"):
            segment_test(FIELD, ToolBody(parts=(PARTS[0],)), 0.001, CheckSettings(method))
    for wrong in (
        {"kind": "cone"},
        {"kind": "box", "half_x_m": 0.01},
        {"kind": "sphere", "radius_m": -0.1},
        {"kind": "sphere", "radius_m": 0.1, "half_z_m": 0.1},
        {"kind": "capsule", "radius_m": math.nan},
        {"kind": "sphere", "radius_m": 0.1, "x_m": 2.0},
    ):
        with pytest.raises(SettingsError):
            ToolPart(**wrong)  # type: ignore[arg-type]
