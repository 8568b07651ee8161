"""Calibration files of OpenCV and ROS, written by OpenCV or in the documented format, and files that are refused."""

import json
import os

import cv2
import numpy as np
import pytest

from deltasafe.cameras import read_camera, write_camera
from deltasafe.errors import DataError

K = np.array([[914.2, 0, 641.7], [0, 911.9, 355.4], [0, 0, 1]])
D = np.array([-0.31, 0.11, 0.0011, -0.0007, -0.02])

CAMERA_INFO = """\
image_width: 1280
image_height: 720
camera_name: narrow_stereo
camera_matrix:
  rows: 3
  cols: 3
  data: [914.2, 0, 641.7, 0, 911.9, 355.4, 0, 0, 1]
distortion_model: plumb_bob
distortion_coefficients:
  rows: 1
  cols: 5
  data: [-0.31, 0.11, 0.0011, -7e-4, -2e-2]
rectification_matrix:
  rows: 3
  cols: 3
  data: [1, 0, 0, 0, 1, 0, 0, 0, 1]
projection_matrix:
  rows: 3
  cols: 4
  data: [914.2, 0, 641.7, 0, 0, 911.9, 355.4, 0, 0, 0, 1, 0]
"""
"""As the package camera_calibration_parsers of ROS writes it."""

ECHOED = """\
header:
  stamp: {sec: 3, nanosec: 7}
  frame_id: camera
height: 720
width: 1280
distortion_model: plumb_bob
d:
- -0.31
- 0.11
- 0.0011
- -0.0007
- -0.02
k: [914.2, 0.0, 641.7, 0.0, 911.9, 355.4, 0.0, 0.0, 1.0]
r: [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]
p: [914.2, 0.0, 641.7, 0.0, 0.0, 911.9, 355.4, 0.0, 0.0, 0.0, 1.0, 0.0]
binning_x: 0
binning_y: 0
roi: {x_offset: 0, y_offset: 0, height: 0, width: 0, do_rectify: false}
---
height: 1
"""
"""As `ros2 topic echo /camera/camera_info` prints it, message after message."""

OPENCV_4 = """\
%YAML:1.0
---
image_Width: 1280
image_Height: 720
Camera_Matrix: !!opencv-matrix
   rows: 3
   cols: 3
   dt: d
   data: [ 9.1420000000000005e+02, 0., 6.4170000000000005e+02, 0.,
       9.1189999999999998e+02, 3.5539999999999998e+02, 0., 0., 1. ]
Distortion_Coefficients: !!opencv-matrix
   rows: 5
   cols: 1
   dt: d
   data: [ -3.1e-01, 1.1e-01, 1.1e-03, -7.0e-04, -2.0e-02 ]
"""
"""With the names and the header of OpenCV 2 to 4."""

OPENCV_4_JSON = '{"image_width": 1280, "image_height": 720, "camera_matrix": {"type_id": "opencv-matrix", "rows": 3, \
"cols": 3, "dt": "d", "data": [ 914.2, 0., 641.7, 0., 911.9, 355.4, 0., 0., 1. ]}, "distortion_coefficients": \
{"type_id": "opencv-matrix", "rows": 1, "cols": 5, "dt": "d", "data": [ -0.31, 0.11, 0.0011, -0.0007, -0.02 ]}}'

LISTS = json.dumps({"image_width": 1280, "image_height": 720, "mtx": K.tolist(), "dist": [D.tolist()]})


def assert_expected(camera, cx=642.2, cy=355.9):
    assert (camera.width, camera.height, camera.fx, camera.fy) == (1280, 720, 914.2, 911.9)
    assert camera.cx == pytest.approx(cx, abs=1e-12)  # half a pixel more than in the file
    assert camera.cy == pytest.approx(cy, abs=1e-12)
    assert camera.distortion_model == "plumb_bob"
    np.testing.assert_allclose(camera.distortion, D)
    assert camera.position_m is None


def by_opencv(path, distortion=D, **numbers):
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
    for name, value in {"image_width": 1280, "image_height": 720, **numbers}.items():
        storage.write(name, value)
    storage.write("camera_matrix", K)
    storage.write("distortion_coefficients", distortion)
    storage.release()
    return path


@pytest.mark.parametrize("suffix", ["yaml", "yml", "xml", "json"])
@pytest.mark.parametrize("shape", [(5,), (1, 5), (5, 1)])
def test_files_of_opencv(tmp_path, suffix, shape):
    assert_expected(read_camera(by_opencv(tmp_path / f"c.{suffix}", D.reshape(shape))))


@pytest.mark.parametrize("text", [CAMERA_INFO, ECHOED, OPENCV_4, OPENCV_4_JSON, LISTS, "\ufeff" + CAMERA_INFO])
def test_documented_formats(tmp_path, text):
    (tmp_path / "c.yaml").write_text(text, encoding="utf-8")
    assert_expected(read_camera(tmp_path / "c.yaml"))


@pytest.mark.parametrize("suffix", ["yaml", "xml", "json"])
@pytest.mark.parametrize(
    ("count", "flags", "name"),
    [
        (8, {}, "rational_polynomial"),
        (12, {}, "rational_polynomial"),
        (14, {}, "rational_polynomial"),
        (4, {"fisheye_model": 1}, "equidistant"),
        (4, {"distortion_model": "fisheye"}, "equidistant"),
        (4, {"distortion_model": "plumb_bob"}, "plumb_bob"),
    ],
)
def test_distortion_models(tmp_path, suffix, count, flags, name):
    numbers = np.array([[0.01] + [0.0] * (count - 1)])
    camera = read_camera(by_opencv(tmp_path / f"c.{suffix}", numbers, **flags))
    assert camera.distortion_model == name
    np.testing.assert_array_equal(camera.distortion, numbers[0])


def test_four_coefficients_without_a_model_are_ambiguous(tmp_path):
    with pytest.raises(DataError, match="may be plumb_bob or equidistant; add the field distortion_model"):
        read_camera(by_opencv(tmp_path / "c.yaml", np.zeros(4)))


P_OF_ROS = "data: [820.5, 0, 639.1, 0, 0, 850.2, 352.3, 0, 0, 0, 1, 0]"
P_OF_K = "data: [914.2, 0, 641.7, 0, 0, 911.9, 355.4, 0, 0, 0, 1, 0]"
R_LINE = "data: [1, 0, 0, 0, 1, 0, 0, 0, 1]"


def test_raw_and_rectified_images_have_different_intrinsics(tmp_path):
    path = tmp_path / "ost.yaml"
    path.write_text(CAMERA_INFO.replace(P_OF_K, P_OF_ROS))
    with pytest.raises(DataError, match="P differs from K; give --image-kind"):
        read_camera(path)
    assert_expected(read_camera(path, "raw"))
    rectified = read_camera(path, "rectified")
    assert (rectified.fx, rectified.fy, rectified.cy) == (820.5, 850.2, 352.8)
    assert not rectified.has_distortion


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        (P_OF_K, P_OF_K.replace("641.7, 0, 0", "641.7, -91.4, 0"), "R is not the identity, or P has an offset"),
        (R_LINE, "data: [0, -1, 0, 1, 0, 0, 0, 0, 1]", "R is not the identity"),
        ("[914.2, 0, 641.7", "[914.2, 0.8, 641.7", "skew"),
        ("0, 0, 1]\ndist", "0, 0, 2]\ndist", "skew"),
        ("641.7, 0, 911.9", "1283.4, 0, 911.9", "P differs from K|far from the center"),
        ("image_width: 1280", "image_width: 640", "far from the center"),
        ("image_width: 1280", "image_width: wide", "field width must hold numbers"),
        ("image_width: 1280", "image_width: 1280.5", "whole number"),
        ("image_width: 1280\n", "", "has no image_width"),
        ("plumb_bob", "double_sphere", "double_sphere"),
        ("-0.31,", "", "for the sizes"),
        ("cols: 5\n  data: [-0.31, 0.11,", "cols: 3\n  data: [", "plumb_bob needs 4 or 5"),
        ("-0.31", ".nan", "field D"),
        ("-0.31", "1e400", "field D"),
        ("-0.31", "true", "field D"),
        ("-0.31", "[1, [2]]", "field D"),
        ("-0.31", "-31", "would leave less"),
        ("camera_name: narrow_stereo", "binning_x: 2", "binning"),
        ("camera_name: narrow_stereo", "roi: {x_offset: 8, width: 640, height: 480}", "region of interest"),
        ("camera_name: narrow_stereo", "roi: 7\nxi: 1.2", "omnidirectional"),
        ("camera_name: narrow_stereo", "Image-Width: 1280", "two spellings"),
        ("camera_matrix:", "camera_matrix: &a [*a]\nx:", "YAML|field K"),
    ],
)
def test_other_cameras_and_damaged_files_are_refused(tmp_path, old, new, words):
    assert old in CAMERA_INFO
    (tmp_path / "c.yaml").write_text(CAMERA_INFO.replace(old, new, 1))
    with pytest.raises(DataError, match=words):
        read_camera(tmp_path / "c.yaml")


@pytest.mark.parametrize(
    "data", [b"", b"\xff\xfe", b"[1, 2]", b"<a>", b"a: [", b"{" * 10**5, b"a: !!python/name:os.system"]
)
def test_other_files_are_refused(tmp_path, data):
    (tmp_path / "c.yaml").write_bytes(data)
    with pytest.raises(DataError, match=r"YAML, JSON or XML|no named values"):
        read_camera(tmp_path / "c.yaml")
    with pytest.raises(DataError, match="is missing"):
        read_camera(tmp_path / "absent.yaml")
    with pytest.raises(DataError, match="is not a file"):
        read_camera(tmp_path)
    os.truncate(tmp_path / "c.yaml", 10**7)
    with pytest.raises(DataError, match="larger than"):
        read_camera(tmp_path / "c.yaml")


def test_camera_files_are_read_back_identical(tmp_path):
    camera = read_camera(by_opencv(tmp_path / "c.yaml"))
    write_camera(tmp_path / "intrinsics.json", camera, board="none")
    assert read_camera(tmp_path / "intrinsics.json") == camera
    angle = np.radians(170)
    turn = np.array([[1, 0, 0], [0, np.cos(angle), -np.sin(angle)], [0, np.sin(angle), np.cos(angle)]])
    placed = camera.placed(np.array([0.1, 0.2, 0.7]), turn)
    write_camera(tmp_path / "pose.json", placed)
    back = read_camera(tmp_path / "pose.json")
    np.testing.assert_array_equal(back.position_m, placed.position_m)
    np.testing.assert_array_equal(back.world_from_camera_rotation, placed.world_from_camera_rotation)
    assert back.pinhole().fx == placed.pinhole().fx


@pytest.mark.parametrize(
    ("key", "value"),
    [("fx", "wide"), ("fx", None), ("position_m", [0, 0]), ("distortion", 3), ("extra", 1), ("distortion_model", [])],
)
def test_altered_camera_files_are_refused(tmp_path, key, value):
    write_camera(tmp_path / "pose.json", read_camera(by_opencv(tmp_path / "c.yaml")).placed(np.zeros(3), np.eye(3)))
    record = json.loads((tmp_path / "pose.json").read_text()) | {key: value}
    (tmp_path / "pose.json").write_text(json.dumps(record))
    with pytest.raises(DataError, match=f"{key}|exactly the fields"):
        read_camera(tmp_path / "pose.json")
