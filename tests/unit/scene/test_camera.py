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
