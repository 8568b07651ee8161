"""Export of a logged scene as an MCAP log: image, calibration, camera pose, task, ground truth."""

import base64
import math
import pathlib
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from deltasafe.cameras.model import HALF_PIXEL
from deltasafe.errors import DataError
from deltasafe.geometry import Pose
from deltasafe.interchange.frames import WORLD
from deltasafe.interchange.log_content import stamp
from deltasafe.interchange.mcap_log import LogWriter, open_log
from deltasafe.scene import LoggedScene

IMAGE, CALIBRATION, TRANSFORM = "/camera/image", "/camera/calibration", "/tf"
START, GOAL, HAND = "/task/start", "/task/goal", "/truth/hand"
FACTS = "deltasafe.scene"
CAMERA = "camera"
FORMATS = {"jpeg": "image.jpg", "png": "image.png"}
MASK, MESH = "hand_mask.png", "hand_mesh.npz"


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
    cx, cy = camera.cx - HALF_PIXEL, camera.cy - HALF_PIXEL  # viewers count pixels as OpenCV and ROS do
    intrinsic = [camera.fx, 0.0, cx, 0.0, camera.fy, cy, 0.0, 0.0, 1.0]
    projection = [camera.fx, 0.0, cx, 0.0, 0.0, camera.fy, cy, 0.0, 0.0, 0.0, 1.0, 0.0]
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
            "first_pixel_center": 0.0,
            "camera_rotation": camera.world_from_camera_rotation.tolist(),
        },
    )


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
