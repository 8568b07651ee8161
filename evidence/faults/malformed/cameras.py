"""Corruptions of calibrations, camera files and ROS 2 bags."""

import json
import pathlib
from typing import Any

import cv2
import numpy as np
from rosbags.rosbag2 import StoragePlugin

from deltasafe.cameras import read_camera, write_camera
from deltasafe.cameras.board import Board
from deltasafe.geometry import Pose
from deltasafe.interchange import ImportOptions, import_scene
from evidence.board_images import Lens, look_at, render_board
from evidence.faults.malformed.documents import document_changes, field_changes
from evidence.faults.malformed.files import at, blaming_folder, cases_of, file_cases, file_changes, filled
from evidence.faults.rejection import Case, Change, InputKind
from evidence.ros_bags import write_bag

BOARD = "charuco:7x5:0.030:0.022"
MATRIX = np.array([[450.0, 0.0, 323.6], [0.0, 448.0, 237.1], [0.0, 0.0, 1.0]])
DISTORTION = [-0.3, 0.1, 1e-3, 0.0, 0.0]
CALIBRATION = {
    "image_width": 640,
    "image_height": 480,
    "camera_matrix": {"rows": 3, "cols": 3, "data": MATRIX.ravel().tolist()},
    "distortion_model": "plumb_bob",
    "distortion_coefficients": {"rows": 1, "cols": 5, "data": DISTORTION},
}


def camera_cases(home: pathlib.Path) -> list[Case]:
    """Calibrations and camera files, as `read_camera` and ``deltasafe camera locate`` read them."""
    view = look_at(np.array([0.1, 0.07, 0.0]), 0.4, 0.4, 0.3, 0.2)
    lens = Lens((640, 480), MATRIX, np.array(DISTORTION))
    image = render_board(Board.parse(BOARD), lens, view, (0.0, 0.0, 0.0, 0.0), np.random.default_rng(0))
    cv2.imwrite(str(home / "board.png"), image)

    def kind(name: str, valid: pathlib.Path) -> InputKind:
        return InputKind(
            name,
            valid,
            lambda given, out: read_camera(given),
            lambda given, out: [
                *("camera", "locate", str(home / "board.png"), "--camera", str(given)),
                *("--board", BOARD, "-o", str(out / "pose.json")),
            ],
        )

    calibration, own = home / "calibration.yaml", home / "camera.json"
    calibration.write_text(json.dumps(CALIBRATION))
    write_camera(own, read_camera(calibration).placed(view.position_m, view.rotation))
    required = ["image_width", "image_height", "camera_matrix", "distortion_coefficients"]
    # YAML: text is converted to numbers, keys may repeat, and the first document counts
    changes = {**file_changes(), **_texts(), **dict(field_changes(CALIBRATION, required))}
    for empty in ("[]", "[[]]"):  # as simulators write it
        changes.pop(f"distortion_coefficients is {empty}")
    fields = json.loads(own.read_text())
    placed = [name for name in fields if name not in ("facts", "format")]
    own_changes = {**document_changes(), **dict(field_changes(fields, placed))}
    for name in ("position_m", "world_from_camera_rotation"):
        own_changes.pop(f"{name} is None", None)
    return [*file_cases(kind("calibration", calibration), changes), *file_cases(kind("camera file", own), own_changes)]


def _texts() -> dict[str, Change]:
    def with_value(name: str, value: object) -> Change:
        return filled(json.dumps({**CALIBRATION, name: value}).encode())

    skewed, corner = MATRIX.copy(), MATRIX.copy()
    skewed[0, 1], corner[:2, 2] = 0.7, 0.0
    return {
        "with a skew": with_value("camera_matrix", skewed.tolist()),
        "with the principal point in the corner": with_value("camera_matrix", corner.tolist()),
        "of half the resolution": with_value("camera_matrix", (MATRIX / 2 + np.diag([0, 0, 0.5])).tolist()),
        "with a matrix of four numbers": with_value("camera_matrix", [1, 2, 3, 4]),
        "with three coefficients": with_value("distortion_coefficients", [0.1, 0.2, 0.3]),
        "with a distortion that folds": with_value("distortion_coefficients", [-9.0, 0, 0, 0, 0]),
        "of an unknown model": with_value("distortion_model", "double_sphere"),
        "with a rotated R": with_value("R", [[0, -1, 0], [1, 0, 0], [0, 0, 1]]),
        "with another P": with_value("P", np.column_stack([0.9 * MATRIX, np.zeros(3)]).tolist()),
        "with binning": with_value("binning_x", 2),
    }


def bag_cases(home: pathlib.Path) -> list[Case]:
    """ROS 2 bags in both storages, as `import_scene` and ``deltasafe import`` read them."""
    start, goal = Pose(0.0, 0.0, 0.05), Pose(0.05, 0.0, 0.05)
    options = ImportOptions(table_z_m=0.0, hand_height_m=0.05, start=start, goal=goal)
    flags = ["--table-z", "0", "--hand-height", "0.05"]
    flags += ["--start", "0", "0", "0.05", "0", "--goal", "0.05", "0", "0.05", "0"]
    found = []
    for storage in StoragePlugin:
        valid = write_bag(home / f"bag-{storage.name.lower()}", _messages(), BAG_TYPES, storage)
        kind = InputKind(
            valid.name,
            valid,
            lambda given, out: import_scene(given, out / "scene", options),
            lambda given, out: ["import", str(given), str(out / "scene"), *flags],
        )
        (data,) = [path.name for path in valid.iterdir() if path.suffix != ".yaml"]
        # MCAP is read without metadata.yaml
        names = [data, "metadata.yaml"] if storage is StoragePlugin.SQLITE3 else [data]
        for name in names:
            changes = {f"{name}: {key}": blaming_folder(at(name, change)) for key, change in file_changes().items()}
            found += cases_of(kind, changes)
    return found


BAG_TYPES = {
    "/image_raw": "sensor_msgs/msg/Image",
    "/camera_info": "sensor_msgs/msg/CameraInfo",
    "/tf_static": "tf2_msgs/msg/TFMessage",
}


def _messages() -> dict[str, list[tuple[float, dict[str, Any]]]]:
    header = {"stamp": {"sec": 1, "nanosec": 0}, "frame_id": "eye"}
    image = {"header": header, "height": 48, "width": 64, "encoding": "mono8", "is_bigendian": 0, "step": 64}
    roi = {"x_offset": 0, "y_offset": 0, "height": 0, "width": 0, "do_rectify": False}
    info = {"header": header, "height": 48, "width": 64, "distortion_model": "plumb_bob", "d": [0.0] * 5, "roi": roi}
    info |= {"k": [60.0, 0, 31.5, 0, 60, 23.5, 0, 0, 1], "r": np.eye(3).ravel().tolist(), "p": [0.0] * 12}
    link = {"translation": {"x": 0.0, "y": 0.0, "z": 0.5}, "rotation": {"x": 1.0, "y": 0.0, "z": 0.0, "w": 0.0}}
    transform = {"header": header | {"frame_id": "world"}, "child_frame_id": "eye", "transform": link}
    return {
        "/image_raw": [(1.0, image | {"data": bytes(range(64)) * 48})],
        "/camera_info": [(1.0, info | {"binning_x": 0, "binning_y": 0})],
        "/tf_static": [(0.0, {"transforms": [transform]})],
    }
