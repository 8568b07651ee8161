"""The camera: projection, its inverse, and the validation of its JSON."""

import json

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from deltasafe.errors import SettingsError
from deltasafe.scene import Camera

DOWN = np.diag([1.0, -1.0, -1.0])


def record(**changes: object) -> dict:
    value = {"width": 640, "height": 480, "fx": 768.75, "fy": 768.75, "cx": 320.0, "cy": 240.0}
    value |= {"position_m": [0.0, 0.0, 0.5], "world_from_camera_rotation": DOWN.tolist()}
    return value | changes


def test_projection_of_a_camera_facing_down_equals_closed_form() -> None:
    uv, depth_m = Camera.from_json(record()).project(np.array([[0.1, 0.05, 0.0], [0.0, 0.0, 0.1]]))
    np.testing.assert_allclose(uv, [[320 + 768.75 * 0.2, 240 - 768.75 * 0.1], [320, 240]])
    np.testing.assert_allclose(depth_m, [0.5, 0.4])


@given(st.floats(-0.3, 0.3), st.floats(-0.3, 0.3), st.floats(0.0, 0.2), st.floats(-0.5, 0.5))
def test_pixel_to_plane_inverts_project(x: float, y: float, z: float, tilt: float) -> None:
    cos, sin = np.cos(tilt), np.sin(tilt)
    rotation = np.array([[1, 0, 0], [0, cos, -sin], [0, sin, cos]]) @ DOWN
    camera = Camera.from_json(record(world_from_camera_rotation=rotation.tolist()))
    uv, depth_m = camera.project(np.array([[x, y, z]]))
    assert depth_m[0] > 0
    np.testing.assert_allclose(camera.pixel_to_plane(uv, z), [[x, y, z]], atol=1e-12)


def test_ground_sampling_distance_of_a_camera_facing_down_is_height_over_focal_length() -> None:
    camera = Camera.from_json(record())
    assert camera.ground_sampling_distance_m(np.array([[0.0, 0.0, 0.0], [0.2, 0.1, 0.0]])) == pytest.approx(
        0.5 / 768.75
    )
    assert camera.ground_sampling_distance_m(np.array([[0.0, 0.0, 0.1]])) == pytest.approx(0.4 / 768.75)
    with pytest.raises(SettingsError, match="in front"):
        camera.ground_sampling_distance_m(np.array([[0.0, 0.0, 0.6]]))


@given(st.floats(-0.6, 0.6), st.floats(0, 639), st.floats(0, 479), st.floats(0, 2 * np.pi))
def test_no_step_of_a_pixel_is_longer_than_the_ground_sampling_distance(
    tilt: float, u: float, v: float, angle: float
) -> None:
    cos, sin = np.cos(tilt), np.sin(tilt)
    rotation = np.array([[1, 0, 0], [0, cos, -sin], [0, sin, cos]]) @ DOWN
    camera = Camera.from_json(record(world_from_camera_rotation=rotation.tolist()))
    step = 1e-3 * np.array([np.cos(angle), np.sin(angle)])
    ends = camera.pixel_to_plane(np.array([[u, v], np.array([u, v]) + step]), 0.0)
    longest_m = camera.ground_sampling_distance_m(ends)
    assert np.linalg.norm(ends[1] - ends[0]) / 1e-3 <= longest_m * (1 + 1e-2)  # the distance is one of a chord


def test_points_behind_the_camera_have_no_pixel() -> None:
    uv, depth_m = Camera.from_json(record()).project(np.array([[0.0, 0.0, 0.6]]))
    assert np.isnan(uv).all()
    assert depth_m[0] < 0


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"fx": -1.0}, "focal"),
        ({"width": 0}, "width"),
        ({"cx": "a"}, "must hold numbers"),
        ({"fx": "768.75"}, "must hold numbers"),
        ({"fy": 10**400}, "must hold numbers"),
        ({"fx": 1e-308}, "focal"),
        ({"cx": True}, "must hold numbers"),
        ({"width": 10**400}, "width"),
        ({"position_m": ["0", "0", "0.5"]}, "must hold numbers"),
        ({"position_m": [0, 0, 10**400]}, "must hold numbers"),
        ({"position_m": [[0], 0, 0.5]}, "must hold numbers"),
        ({"fx": []}, "must hold numbers"),
        ({"position_m": json.loads("[" * 900 + "]" * 900)}, "must hold numbers"),
        ({"world_from_camera_rotation": [[True, 0, 0], [0, -1, 0], [0, 0, -1]]}, "must hold numbers"),
        ({"position_m": [0, 0]}, "position_m"),
        ({"world_from_camera_rotation": np.eye(3).tolist()[::-1]}, "rotation"),
        ({"extra": 1}, "extra"),
        ({"cx": 640.0, "cy": 480.0}, "another resolution"),
        ({"cy": 0.0}, "another resolution"),
    ],
)
def test_invalid_fields_are_named(changes: dict, words: str) -> None:
    with pytest.raises(SettingsError, match=words):
        Camera.from_json(record(**changes))


def test_image_above_the_horizon_is_refused() -> None:
    camera = Camera.from_json(record(world_from_camera_rotation=np.diag([1.0, 1.0, 1.0]).tolist()))
    with pytest.raises(SettingsError, match="do not all meet"):
        camera.pixel_to_plane(np.array([[320.0, 240.0]]), 0.0)


def tilted(tilt_rad: float, turn_rad: float = 0.0, height_m: float = 0.5) -> Camera:
    """A camera above the origin, tilted from straight down by an angle and turned about the vertical."""
    cos, sin = np.cos(tilt_rad), np.sin(tilt_rad)
    turn = np.array([[np.cos(turn_rad), -np.sin(turn_rad), 0], [np.sin(turn_rad), np.cos(turn_rad), 0], [0, 0, 1]])
    rotation = turn @ np.array([[1, 0, 0], [0, cos, -sin], [0, sin, cos]]) @ DOWN
    changes = {"world_from_camera_rotation": rotation.tolist(), "position_m": [0.0, 0.0, height_m]}
    return Camera.from_json(record(**changes))


def test_view_inside_the_rectangle_is_the_four_corners_exactly() -> None:
    camera, far = tilted(0.3, 1.1), np.full(2, 5.0)
    corners = np.array([[0.0, 0], [640, 0], [640, 480], [0, 480]])
    assert (camera.view_on_plane(0.02, -far, far) == camera.pixel_to_plane(corners, 0.02)[:, :2]).all()


def test_view_of_a_camera_that_looks_horizontally_equals_closed_form() -> None:
    """The lower half of the image shows the table from y = h f / (H / 2) on, as wide as x = y W / 2 / f."""
    near_m, slope = 0.5 * 768.75 / 240, 320 / 768.75
    view = tilted(np.pi / 2).view_on_plane(0.0, np.array([-5.0, -1.0]), np.array([5.0, 3.0]))
    wanted = [[-near_m * slope, near_m], [near_m * slope, near_m], [3 * slope, 3.0], [-3 * slope, 3.0]]
    order = np.lexsort(view.T)
    np.testing.assert_allclose(view[order], np.array(wanted)[np.lexsort(np.array(wanted).T)], atol=1e-9)


@given(st.floats(0.0, 2.0), st.floats(-3.2, 3.2), st.floats(0.2, 3.0), st.integers(0, 2**31))
def test_a_point_lies_in_the_view_if_it_projects_into_the_image(
    tilt_rad: float, turn_rad: float, height_m: float, seed: int
) -> None:
    camera, rng = tilted(tilt_rad, turn_rad, height_m), np.random.default_rng(seed)
    lower_m = rng.uniform(-2, 1, 2)
    upper_m = lower_m + rng.uniform(0.1, 2, 2)
    polygon = camera.view_on_plane(0.0, lower_m, upper_m)
    points = rng.uniform(lower_m, upper_m, (200, 2))
    uv, _ = camera.project(np.column_stack([points, np.zeros(200)]))
    off_border_px = np.minimum(uv, (640, 480) - uv).min(axis=1)  # negative outside
    off_border_px[np.isnan(off_border_px)] = -1e9
    if len(polygon) < 3:
        assert (off_border_px < 1e-3).all()
        return
    edges = np.roll(polygon, -1, axis=0) - polygon
    to_points = points[:, None] - polygon
    sides = edges[:, 0] * to_points[..., 1] - edges[:, 1] * to_points[..., 0]
    area = 0.5 * float((polygon[:, 0] * np.roll(polygon[:, 1], -1) - polygon[:, 1] * np.roll(polygon[:, 0], -1)).sum())
    inside = (sides * np.sign(area) > 0).all(axis=1)
    clear = np.abs(off_border_px) > 1e-3
    assert (inside[clear] == (off_border_px[clear] > 0)).all()
