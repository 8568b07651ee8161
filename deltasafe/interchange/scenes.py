"""A logged scene as an MCAP log and back: image, calibration, camera pose, task; truth as attachments."""

import base64
import pathlib
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from deltasafe.errors import DataError
from deltasafe.geometry import Pose
from deltasafe.interchange.mcap_log import LogContent, LogWriter, read_log, stamp
from deltasafe.io.storage import atomic_folder, write_json
from deltasafe.scene import LoggedScene

__all__ = ["export_scene", "import_scene", "write_scene_topics"]

IMAGE, CALIBRATION, TRANSFORM = "/camera/image", "/camera/calibration", "/tf"
START, GOAL, HAND = "/task/start", "/task/goal", "/truth/hand"
FACTS = "deltasafe.scene"
WORLD, CAMERA = "world", "camera"
FORMATS = {"jpeg": "image.jpg", "png": "image.png"}
MASK, MESH = "hand_mask.png", "hand_mesh.npz"


def export_scene(scene: LoggedScene, destination: str | pathlib.Path) -> None:
    """Write a scene as an MCAP log.

    Raises:
        DataError: the image is neither JPEG nor PNG, or a file cannot be read.
        SettingsError: the destination does not end in .mcap, or the package mcap is not installed.
    """
    with LogWriter(destination) as log:
        write_scene_topics(log, scene)
        log.attach(MASK, "image/png", scene.mask_path.read_bytes())
        log.attach(MESH, "application/x-npz", scene.mesh_path.read_bytes())


def write_scene_topics(log: LogWriter, scene: LoggedScene) -> None:
    """The messages of a scene, all at time 0; the true hand is for looking at."""
    camera = scene.camera
    suffix = scene.image_path.suffix.lower().lstrip(".").replace("jpg", "jpeg")
    if suffix not in FORMATS:
        raise DataError(scene.image_path, "is neither JPEG nor PNG; a log holds one of these")
    data = base64.b64encode(scene.image_path.read_bytes()).decode()
    log.say(IMAGE, "foxglove.CompressedImage", 0, {"frame_id": CAMERA, "data": data, "format": suffix})
    intrinsic = [camera.fx, 0.0, camera.cx, 0.0, camera.fy, camera.cy, 0.0, 0.0, 1.0]
    projection = [camera.fx, 0.0, camera.cx, 0.0, 0.0, camera.fy, camera.cy, 0.0, 0.0, 0.0, 1.0, 0.0]
    log.say(
        CALIBRATION,
        "foxglove.CameraCalibration",
        0,
        {
            "frame_id": CAMERA,
            "width": camera.width,
            "height": camera.height,
            "distortion_model": "plumb_bob",
            "D": [0.0] * 5,
            "K": intrinsic,
            "R": [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0],
            "P": projection,
        },
    )
    rotation = Rotation.from_matrix(camera.world_from_camera_rotation).as_quat()
    log.say(
        TRANSFORM,
        "foxglove.FrameTransform",
        0,
        {
            "parent_frame_id": WORLD,
            "child_frame_id": CAMERA,
            "translation": vector(camera.position_m),
            "rotation": quaternion(rotation),
        },
    )
    for topic, pose in ((START, scene.start), (GOAL, scene.goal)):
        log.say(topic, "foxglove.PoseInFrame", 0, {"frame_id": WORLD, "pose": upright(pose)})
    log.say(HAND, "foxglove.SceneUpdate", 0, {"deletions": [], "entities": [_hand(scene)]})
    log.note(
        FACTS,
        {
            "id": scene.id,
            "table_z_m": scene.table_z_m,
            "hand_height_m": scene.hand_height_m,
            "camera_rotation": camera.world_from_camera_rotation.tolist(),
        },
    )


def import_scene(source: str | pathlib.Path, folder: str | pathlib.Path) -> LoggedScene:
    """Turn an MCAP log into a scene folder (see docs/reference/formats.md), which appears as a whole, and read it.

    Raises:
        DataError: the log is damaged, or lacks a topic, a fact or the truth that scenes are judged by.
        SettingsError: the package mcap is not installed.
    """
    log = read_log(source)
    facts = log.about(FACTS)
    data, form = log.image(IMAGE)
    if form not in FORMATS:
        raise DataError(log.path, f"{IMAGE} is {form!r}; only {sorted(FORMATS)} can be read, convert it")
    try:
        record = {
            "id": facts["id"],
            "image": FORMATS[form],
            "camera": _camera(log, facts),
            "table_z_m": facts["table_z_m"],
            "hand_height_m": facts["hand_height_m"],
            "start": _task(log, START),
            "goal": _task(log, GOAL),
            "ground_truth": {"mask": MASK, "mesh": MESH},
        }
    except DataError:
        raise
    except (AttributeError, KeyError, TypeError, ValueError, IndexError) as error:
        raise DataError(log.path, f"describes no scene ({error!r}); export it again") from error
    with atomic_folder(folder) as temporary:
        (temporary / FORMATS[form]).write_bytes(data)
        for name in (MASK, MESH):
            (temporary / name).write_bytes(log.attachment(name))
        write_json(temporary / "scene.json", record)
        try:
            LoggedScene.load(temporary)
        except DataError as error:  # the folder that it names is about to go
            raise DataError(log.path, f"holds a scene whose {error.path.name} {error.reason}") from error
    return LoggedScene.load(folder)


def vector(values: Any) -> dict[str, float]:
    """x, y, z as messages hold them."""
    return dict(zip("xyz", map(float, values), strict=True))


def quaternion(values: Any) -> dict[str, float]:
    """x, y, z, w as messages hold them."""
    return dict(zip("xyzw", map(float, values), strict=True))


def upright(pose: Pose) -> dict[str, Any]:
    """A pose of the tool, its shaft vertical."""
    turn = Rotation.from_euler("z", pose.yaw_rad).as_quat()
    return {"position": vector((pose.x_m, pose.y_m, pose.z_m)), "orientation": quaternion(turn)}


def _camera(log: LogContent, facts: dict[str, Any]) -> dict[str, Any]:
    calibration, transform = log.on(CALIBRATION)[0], log.on(TRANSFORM)[0]
    if any(value != 0 for value in calibration["D"]):
        raise DataError(log.path, f"{CALIBRATION} has a distortion; rectify the image first")
    intrinsic = calibration["K"]
    turned = Rotation.from_quat([transform["rotation"][axis] for axis in "xyzw"]).as_matrix()
    exact = np.array(facts.get("camera_rotation", turned.tolist()))
    if exact.shape != (3, 3) or np.abs(exact - turned).max() > 1e-6:
        raise DataError(
            log.path, f"{TRANSFORM} and the metadata disagree about where the camera looks; export it again"
        )
    return {
        "width": calibration["width"],
        "height": calibration["height"],
        "fx": intrinsic[0],
        "fy": intrinsic[4],
        "cx": intrinsic[2],
        "cy": intrinsic[5],
        "position_m": [transform["translation"][axis] for axis in "xyz"],
        "world_from_camera_rotation": exact.tolist(),
    }


def _task(log: LogContent, topic: str) -> dict[str, Any]:
    pose = log.on(topic)[0]["pose"]
    turn = Rotation.from_quat([pose["orientation"][axis] for axis in "xyzw"])
    return {
        "position_m": [pose["position"][axis] for axis in "xyz"],
        "yaw_rad": float(turn.as_euler("zyx")[0]),
    }


def _hand(scene: LoggedScene) -> dict[str, Any]:
    vertices, triangles = scene.true_mesh()
    return {
        "timestamp": stamp(0),
        "frame_id": WORLD,
        "id": "hand",
        "lifetime": stamp(0),
        "frame_locked": False,
        "triangles": [
            {
                "pose": {"position": vector((0, 0, 0)), "orientation": quaternion((0, 0, 0, 1))},
                "points": [vector(np.round(point.astype(float), 5)) for point in vertices],
                "color": {"r": 0.85, "g": 0.62, "b": 0.5, "a": 1.0},
                "colors": [],
                "indices": triangles.ravel().tolist(),
            }
        ],
    }
