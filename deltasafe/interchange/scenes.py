"""Export of a logged scene as an MCAP log, and its import: image, calibration, camera pose, task, ground truth."""

import base64
import math
import pathlib
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from deltasafe.errors import DataError
from deltasafe.geometry import Pose
from deltasafe.interchange.frames import WORLD, Frames, frame_of, pose_of, same_pose
from deltasafe.interchange.mcap_log import LogContent, LogWriter, open_log, read_log, stamp, time_ns_of
from deltasafe.io.images import read_rgb
from deltasafe.io.storage import atomic_folder, write_json
from deltasafe.perception.data.masks import read_mask
from deltasafe.scene import LoggedScene

IMAGE, CALIBRATION, TRANSFORM = "/camera/image", "/camera/calibration", "/tf"
START, GOAL, HAND = "/task/start", "/task/goal", "/truth/hand"
FACTS = "deltasafe.scene"
CAMERA = "camera"
FORMATS = {"jpeg": "image.jpg", "png": "image.png"}
MASK, MESH = "hand_mask.png", "hand_mesh.npz"
MAX_TILT_RAD = math.radians(0.1)
"""Of a start or goal, which are upright for the planner: 0.07 mm at the rim of a disc of 40 mm."""


def export_scene(scene: LoggedScene, destination: str | pathlib.Path) -> None:
    """Write a scene as an MCAP log.

    Raises:
        DataError: the image is neither JPEG nor PNG, or a file cannot be read.
        SettingsError: the destination does not end in .mcap, or the package mcap is not installed.
    """
    with open_log(destination) as log:
        write_scene_topics(log, scene)
        for name, media_type, path in (
            (MASK, "image/png", scene.mask_path),
            (MESH, "application/x-npz", scene.mesh_path),
        ):
            if path is not None:
                log.attach(name, media_type, path.read_bytes())


def write_scene_topics(log: LogWriter, scene: LoggedScene) -> None:
    """Write the messages of a scene, all at time 0. The mesh of the true hand, if there is one, is for display."""
    camera = scene.camera
    suffix = scene.image_path.suffix.lower().lstrip(".").replace("jpg", "jpeg")
    if suffix not in FORMATS:
        raise DataError(scene.image_path, "is neither JPEG nor PNG; convert it to one of these")
    data = base64.b64encode(scene.image_path.read_bytes()).decode()
    log.write_message(IMAGE, "foxglove.CompressedImage", 0, {"frame_id": CAMERA, "data": data, "format": suffix})
    intrinsic = [camera.fx, 0.0, camera.cx, 0.0, camera.fy, camera.cy, 0.0, 0.0, 1.0]
    projection = [camera.fx, 0.0, camera.cx, 0.0, 0.0, camera.fy, camera.cy, 0.0, 0.0, 0.0, 1.0, 0.0]
    log.write_message(
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
    log.write_message(
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
        log.write_message(topic, "foxglove.PoseInFrame", 0, {"frame_id": WORLD, "pose": upright(pose)})
    mesh = scene.mesh_if_known()
    if mesh is not None:
        log.write_message(HAND, "foxglove.SceneUpdate", 0, {"deletions": [], "entities": [_hand(*mesh)]})
    log.write_facts(
        FACTS,
        {
            "id": scene.id,
            "table_z_m": scene.table_z_m,
            "hand_height_m": scene.hand_height_m,
            "camera_rotation": camera.world_from_camera_rotation.tolist(),
        },
    )


def import_scene(source: str | pathlib.Path, folder: str | pathlib.Path) -> LoggedScene:
    """Convert an MCAP log to a scene folder (docs/reference/formats.md) atomically, and load it.

    The first image is used. Poses are transformed into the frame ``world`` at the time of that image. True mask and
    mesh are taken from the attachments, if there are any.

    Raises:
        DataError: the log is damaged; it lacks a topic or a fact; its frames, sizes or rotations contradict each other;
            or a task pose is not upright.
        SettingsError: the package mcap is not installed.
    """
    log = read_log(source)
    facts = log.facts_named(FACTS)
    data, form = log.image(IMAGE)
    if form not in FORMATS:
        raise DataError(log.path, f"{IMAGE} is {form!r}; only {sorted(FORMATS)} can be read, convert it")
    frames = Frames(log, TRANSFORM)
    truth = {key: name for key, name in (("mask", MASK), ("mesh", MESH)) if name in log.attachments}
    try:
        record = {
            "id": facts["id"],
            "image": FORMATS[form],
            "camera": _camera(log, facts, frames),
            "table_z_m": facts["table_z_m"],
            "hand_height_m": facts["hand_height_m"],
            "start": _task(log, START, frames),
            "goal": _task(log, GOAL, frames),
            **({"ground_truth": truth} if truth else {}),
        }
    except DataError:
        raise
    except (AttributeError, KeyError, TypeError, ValueError, IndexError, OverflowError) as error:
        raise DataError(log.path, f"describes no scene ({error!r}); export it again") from error
    with atomic_folder(folder) as temporary:
        (temporary / FORMATS[form]).write_bytes(data)
        for name in truth.values():
            (temporary / name).write_bytes(log.attachment(name))
        write_json(temporary / "scene.json", record)
        try:
            scene = LoggedScene.load(temporary)
            pixels = {IMAGE: read_rgb(scene.image_path)}
            if scene.mask_path is not None:
                pixels[MASK] = read_mask(scene.mask_path)
        except DataError as error:  # it names a temporary folder
            raise DataError(log.path, f"holds a scene whose {error.path.name} {error.reason}") from error
        for topic, image in pixels.items():
            if image.shape[:2] != (scene.camera.height, scene.camera.width):
                raise DataError(
                    log.path,
                    f"{topic} is {image.shape[1]} x {image.shape[0]} pixels, {CALIBRATION} is for "
                    f"{scene.camera.width} x {scene.camera.height}; give the calibration of that image",
                )
    return LoggedScene.load(folder)


def vector(values: Any) -> dict[str, float]:
    """Convert x, y, z to the fields of a message."""
    return dict(zip("xyz", map(float, values), strict=True))


def quaternion(values: Any) -> dict[str, float]:
    """Convert x, y, z, w to the fields of a message."""
    return dict(zip("xyzw", map(float, values), strict=True))


def upright(pose: Pose) -> dict[str, Any]:
    """Convert a pose with a vertical shaft to a message. ``yaw_about_z`` inverts a yaw in [-pi, pi] exactly."""
    z, w = math.sin(pose.yaw_rad / 2), math.cos(pose.yaw_rad / 2)
    # search the neighboring floats: of one angle in twelve, (z, w) gives a yaw that differs in the last bit
    near = [(z, w)]
    for toward in (-2.0, 2.0):
        near += [(math.nextafter(z, toward), w), (z, math.nextafter(w, toward))]
    z, w = next((pair for pair in near if yaw_about_z(*pair) == pose.yaw_rad), near[0])
    return {"position": vector((pose.x_m, pose.y_m, pose.z_m)), "orientation": quaternion((0.0, 0.0, z, w))}


def yaw_about_z(z: float, w: float) -> float:
    """Return the yaw in [-pi, pi] of a quaternion whose x and y are (nearly) zero."""
    yaw_rad = 2 * math.atan2(z, w)
    return yaw_rad - math.copysign(2 * math.pi, yaw_rad) if abs(yaw_rad) > math.pi else yaw_rad


def _camera(log: LogContent, facts: dict[str, Any], frames: Frames) -> dict[str, Any]:
    calibration = _calibration(log)
    if any(value != 0 for value in calibration["D"]):
        raise DataError(log.path, f"{CALIBRATION} has a distortion; rectify the image")
    intrinsic = calibration["K"]
    frame = frame_of(log, IMAGE, log.messages_on(IMAGE)[0])
    if frame == WORLD:
        raise DataError(log.path, f"{IMAGE} is in the frame {WORLD!r}; give the camera a frame of its own")
    pose = frames.pose_in_world(frame, _image_time_ns(log))
    turned = pose.rotation.as_matrix()
    exact = np.array(facts.get("camera_rotation", turned.tolist()), np.float64)
    if exact.shape != (3, 3) or not np.abs(exact - turned).max() <= 1e-6:
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
        "position_m": pose.position_m.tolist(),
        "world_from_camera_rotation": exact.tolist(),
    }


def _image_time_ns(log: LogContent) -> int:
    return time_ns_of(log.path, IMAGE, log.messages_on(IMAGE)[0])


def _calibration(log: LogContent) -> dict[str, Any]:
    """The calibration in the image's frame; if they differ, the newest one that is not later than the image."""
    frame, messages = frame_of(log, IMAGE, log.messages_on(IMAGE)[0]), log.messages_on(CALIBRATION)
    found = [one for one in messages if frame_of(log, CALIBRATION, one) == frame]
    if not found:
        names = sorted({frame_of(log, CALIBRATION, one) for one in messages})
        raise DataError(
            log.path,
            f"{CALIBRATION} is of the frame {', '.join(map(repr, names))}, {IMAGE} of {frame!r}; "
            "give the calibration of that camera",
        )
    if _agree(found):
        return found[0]
    earlier = [one for one in found if time_ns_of(log.path, CALIBRATION, one) <= _image_time_ns(log)]
    if not earlier:
        raise DataError(log.path, f"{CALIBRATION} varies, and all are later than {IMAGE}; give the one of that image")
    return max(earlier, key=lambda one: time_ns_of(log.path, CALIBRATION, one))


def _task(log: LogContent, topic: str, frames: Frames) -> dict[str, Any]:
    """Start or goal in the world frame, upright."""
    messages = log.messages_on(topic)
    if not _agree(messages):
        raise DataError(log.path, f"{topic} holds {len(messages)} poses that differ; keep the one of the task")
    message, image_ns = messages[0], _image_time_ns(log)
    given = pose_of(log, topic, message["pose"]["position"], message["pose"]["orientation"])
    frame, own_ns = frame_of(log, topic, message), time_ns_of(log.path, topic, message)
    outer = frames.pose_in_world(frame, image_ns)
    if frames.is_connected(frame, own_ns) and not same_pose(outer, frames.pose_in_world(frame, own_ns)):
        raise DataError(
            log.path,
            f"{topic} is given in the frame {frame!r}, which moved between {IMAGE} and that pose; "
            f"give the pose in the frame {WORLD!r}",
        )
    pose = given.within(outer)
    tilt_rad = math.acos(min(max(float(pose.rotation.as_matrix()[2, 2]), -1.0), 1.0))
    if tilt_rad > MAX_TILT_RAD:
        raise DataError(
            log.path,
            f"{topic} is tilted by {math.degrees(tilt_rad):.4g} degrees in the frame {WORLD!r}; give a pose that is "
            f"upright (z up) within {math.degrees(MAX_TILT_RAD):g} degrees, the tool rotates about the vertical only",
        )
    return {"position_m": pose.position_m.tolist(), "yaw_rad": yaw_about_z(*map(float, pose.quaternion[2:]))}


def _agree(messages: list[dict[str, Any]]) -> bool:
    """Whether messages are equal except for their timestamps."""
    return all({**one, "timestamp": None} == {**messages[0], "timestamp": None} for one in messages)


def _hand(vertices: NDArray[np.float32], triangles: NDArray[np.int32]) -> dict[str, Any]:
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
