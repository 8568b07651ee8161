"""Lens distortion: pixels against OpenCV's projection, scaling in closed form, and images without empty pixels."""

import dataclasses

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from deltasafe.cameras import CameraModel
from deltasafe.errors import SettingsError

DOWN = np.diag([1.0, -1.0, -1.0])
LENSES = {
    "none": ("plumb_bob", (0.0,) * 5),
    "plumb_bob": ("plumb_bob", (-0.31, 0.11, 0.0011, -0.0007, -0.02)),
    "pincushion": ("plumb_bob", (0.12, 0.03, 0.0, 0.0, 0.0)),
    "four coefficients": ("plumb_bob", (-0.2, 0.03, 0.0005, 0.0)),
    "rational_polynomial": ("rational_polynomial", (0.9, 0.12, 0.0004, -0.0003, 0.005, 1.24, 0.31, 0.02)),
    "thin prism": ("rational_polynomial", (-0.2, 0.05, 0.0, 0.0, 0.0, 0.01, 0.0, 0.0, 0.001, 0.0, 0.002, 0.0)),
    "tilted": ("rational_polynomial", (-0.1, *[0.0] * 11, 0.01, -0.02)),
    "equidistant": ("equidistant", (-0.02, 0.004, -0.001, 0.0002)),
    "ideal fisheye": ("equidistant", (0.0,) * 4),
}


def model(lens="plumb_bob", rotation=DOWN, **changes):
    name, coefficients = LENSES[lens]
    values = dict(width=640, height=480, fx=520.0, fy=515.0, cx=322.75, cy=236.5)
    return CameraModel(**values | changes, distortion_model=name, distortion=coefficients,
                       position_m=np.array([0.1, -0.05, 0.6]), world_from_camera_rotation=rotation)  # fmt: skip


def opencv_projection(camera, points_m):
    """Pixels of the camera's images by OpenCV alone: camera matrix with pixel centers at whole numbers."""
    matrix = np.array([[camera.fx, 0, camera.cx - 0.5], [0, camera.fy, camera.cy - 0.5], [0, 0, 1]])
    to_camera = camera.world_from_camera_rotation.T
    turn, shift = cv2.Rodrigues(to_camera)[0], -to_camera @ camera.position_m
    project = cv2.fisheye.projectPoints if camera.distortion_model == "equidistant" else cv2.projectPoints
    uv, _ = project(points_m[:, None], turn, shift, matrix, np.array(camera.distortion))
    return uv[:, 0]


@pytest.mark.parametrize("lens", LENSES)
def test_projection_after_undistortion_equals_that_of_opencv(lens):
    camera = model(lens, Rotation.from_euler("xyz", (0.2, -0.1, 0.7)).as_matrix() @ DOWN)
    uv = np.random.default_rng(0).uniform((0, 0), (640, 480), (300, 2))
    points_m = camera.pinhole().pixel_to_plane(uv, 0.02)
    np.testing.assert_allclose(camera.distort(uv), opencv_projection(camera, points_m) + 0.5, atol=1e-6)
    np.testing.assert_allclose(camera.project(points_m), camera.distort(uv), atol=1e-6)


@pytest.mark.parametrize("lens", LENSES)
def test_every_undistorted_pixel_shows_a_pixel_of_the_image(lens):
    camera = model(lens)
    edge = np.linspace(0, 1, 1000)
    border = [(edge, 0 * edge), (edge, 0 * edge + 1), (0 * edge, edge), (0 * edge + 1, edge)]
    uv = camera.distort(np.concatenate([np.column_stack(side) for side in border]) * (640, 480))
    assert (uv >= -1e-3).all()
    assert (uv <= np.array([640, 480]) + 1e-3).all()
    if camera.has_distortion and lens != "ideal fisheye":  # and no more of the view is lost than that needs
        assert min(uv.min(), *(np.array([640, 480]) - uv.max(axis=0))) < 0.1


@pytest.mark.parametrize("lens", LENSES)
def test_undistorted_images_show_the_pixels_that_the_map_names(lens):
    camera = model(lens, height=480)
    v, u = np.mgrid[:480, :640].astype(np.float32) + 0.5
    seen = camera.undistorted(np.dstack([u, v]))  # an image of its own pixel coordinates
    rows, columns = np.random.default_rng(1).integers((5, 5), (475, 635), (200, 2)).T
    wanted = camera.distort(np.column_stack([columns, rows]) + 0.5)
    np.testing.assert_allclose(seen[rows, columns], wanted, atol=0.03)  # remap interpolates in steps of 1/32 pixel


def test_masks_keep_their_values():
    mask = np.zeros((480, 640), np.uint8)
    mask[100:300, 200:500] = 255
    assert set(np.unique(model().undistorted(mask, is_mask=True))) == {0, 255}


def test_images_without_distortion_stay_as_they_are():
    image = np.random.default_rng(0).integers(0, 256, (480, 640, 3), np.uint8)
    assert model("none").undistorted(image) is image
    assert model("none").zoom == 1.0


@given(st.sampled_from(sorted(LENSES)), st.sampled_from([0.25, 0.5, 2.0, 3.0]))
@settings(deadline=None, max_examples=12)
def test_a_resized_camera_sees_each_point_at_the_same_place_of_its_image(lens, scale):
    camera = model(lens)
    other = camera.resized(round(640 * scale), round(480 * scale))
    points_m = camera.pinhole().pixel_to_plane(np.array([[10.0, 20.0], [320.0, 240.0], [600.0, 470.0]]), 0.0)
    np.testing.assert_allclose(other.project(points_m), camera.project(points_m) * scale, rtol=0, atol=1e-6 * scale)
    assert other.cx == camera.cx * scale  # OpenCV's number would scale as (cx + 0.5) * scale - 0.5


@pytest.mark.parametrize("size", [(480, 640), (640, 360), (1280, 720), (640, 477)])
def test_images_of_another_aspect_are_refused(size):
    with pytest.raises(SettingsError, match="another aspect ratio"):
        model().resized(*size)


def test_a_size_that_was_rounded_is_accepted():
    camera = dataclasses.replace(model("none"), width=1920, height=1080, cx=960.0, cy=540.0)
    assert camera.resized(1366, 768).height == 768


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"cx": 640.0}, "far from the center"),
        ({"cy": 120.0}, "far from the center"),
        ({"fx": -1.0}, "focal lengths"),
        ({"width": 0}, "width"),
        ({"distortion": (0.0,) * 6}, "needs 4 or 5"),
        ({"distortion": (float("nan"),) * 5}, "finite"),
        ({"distortion_model": "double_sphere"}, "must be one of"),
        ({"position_m": None}, "both or none"),
        ({"distortion": (-5.0, 0.0, 0.0, 0.0, 0.0)}, "would leave less than 50%"),
    ],
)
def test_unusable_models_are_refused(changes, words):
    with pytest.raises(SettingsError, match=words):
        dataclasses.replace(model(), **changes)


def test_an_unknown_pose_and_another_size_are_refused():
    camera = dataclasses.replace(model(), position_m=None, world_from_camera_rotation=None)
    with pytest.raises(SettingsError, match="pose is unknown"):
        camera.pinhole()
    with pytest.raises(SettingsError, match="320 x 240"):
        camera.undistorted(np.zeros((240, 320, 3), np.uint8))
