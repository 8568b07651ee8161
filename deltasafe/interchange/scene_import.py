"""Import of a scene from a log: an image, its camera in the world frame, and the task."""

import dataclasses
import math
import pathlib
from collections.abc import Callable
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from deltasafe.cameras import CameraModel
from deltasafe.cameras.calibration_files import ImageKind, camera_from_intrinsics
from deltasafe.cameras.model import HALF_PIXEL
from deltasafe.errors import DataError, SettingsError
from deltasafe.geometry import Pose
from deltasafe.interchange.frames import WORLD, Frames, frame_of, pose_of, same_pose
from deltasafe.interchange.log_content import LogContent, time_ns_of
from deltasafe.interchange.raw_images import compressed_image, raw_image
from deltasafe.interchange.reading import read_log
from deltasafe.interchange.scenes import (
    CALIBRATION,
    FACTS,
    FORMATS,
    GOAL,
    IMAGE,
    MASK,
    MESH,
    START,
    yaw_about_z,
)
from deltasafe.io.images import read_rgb
from deltasafe.io.storage import atomic_folder, write_json
from deltasafe.perception.data.masks import read_mask
from deltasafe.scene import LoggedScene

Message = dict[str, Any]

MAX_TILT_RAD = math.radians(0.1)
"""Of a start or goal, which are upright for the planner: 0.07 mm at the rim of a disc of 40 mm."""


@dataclasses.dataclass(frozen=True)
class ImportOptions:
    """What a log does not hold, or holds several of. None: take it from the log.

    Attributes:
        image_topic: of the image.
        calibration_topic: of the camera's calibration.
        camera: calibration to use instead of the log's; if it has a pose, that as well instead of transforms.
        image_kind: whether the image is ``raw`` or ``rectified``, if the calibration describes both.
        camera_frame: optical frame of the camera (z forward, x right) instead of the image's ``frame_id``.
        world_frame: name of the world frame (z up).
        image_after_s: use the first image at least this long after the first one of its topic.
        table_z_m, hand_height_m: as in a scene.
        start, goal: pose in the world frame, or the topic of one.
        scene_id: name of the scene.
    """

    image_topic: str | None = None
    calibration_topic: str | None = None
    camera: CameraModel | None = None
    image_kind: ImageKind | None = None
    camera_frame: str | None = None
    world_frame: str = WORLD
    image_after_s: float = 0.0
    table_z_m: float | None = None
    hand_height_m: float | None = None
    start: Pose | str | None = None
    goal: Pose | str | None = None
    scene_id: str | None = None


def import_scene(
    source: str | pathlib.Path, folder: str | pathlib.Path, options: ImportOptions | None = None
) -> LoggedScene:
    """Convert a log to a scene folder (docs/reference/formats.md) atomically, and load it.

    The image is undistorted. Poses are transformed into the world frame at the time of the image. True mask and mesh
    are taken from the attachments, if there are any.

    Args:
        source: MCAP file, or ROS 2 bag.

    Raises:
        DataError: the log is damaged; it lacks something that no option gives; its frames, sizes or rotations
            contradict each other; or a task pose is not upright. Or ``folder`` exists and is no scene.
        SettingsError: the package mcap or rosbags is not installed.
    """
    options, folder = options or ImportOptions(), pathlib.Path(folder)
    is_scene, is_empty = (folder / "scene.json").is_file(), folder.is_dir() and not any(folder.iterdir())
    if folder.exists() and not (is_scene or is_empty):
        raise DataError(folder, "exists and is no scene, which would be replaced; give another folder")
    log = read_log(source, options.image_after_s)
    try:
        return _Import(log, options).write(folder)
    except DataError:
        raise
    except (AttributeError, KeyError, TypeError, ValueError, IndexError, OverflowError) as error:
        raise DataError(log.path, f"describes no scene ({error!r}); record or export it again") from error


class _Import:
    """One import: the log, the options, and the image that decides about frames and times."""

    def __init__(self, log: LogContent, options: ImportOptions) -> None:
        self.log, self.options = log, options
        self.facts: dict[str, Any] = log.facts.get(FACTS, {})
        self.topic = _topic(log, "image", options.image_topic, IMAGE, "--image-topic")
        (self.image,) = log.messages_on(self.topic)[:1]
        self.frame = frame_of(log, self.topic, self.image)
        self.time_ns = time_ns_of(log.path, self.topic, self.image)
        transforms = log.topics("transform")
        self.frames = Frames(log, transforms, options.world_frame) if transforms else None

    def write(self, folder: pathlib.Path) -> LoggedScene:
        """Write the folder, and load the scene from it."""
        log, given = self.log, self._given(folder)
        with atomic_folder(folder) as temporary:
            name = self._write_image(temporary)
            rgb = self._read(read_rgb, temporary / name)
            model = self._model(rgb)
            truth = {key: file for key, file in (("mask", MASK), ("mesh", MESH)) if file in log.attachments}
            for file in truth.values():
                (temporary / file).write_bytes(log.attachment(file))
            mask = self._read(read_mask, temporary / MASK) if "mask" in truth else None
            if mask is not None:
                self._require_size(MASK, mask, self.topic, model.width, model.height)
            if model.has_distortion:
                (temporary / name).unlink()
                name = "image.png"
                _write_png(temporary / name, model.undistorted(rgb)[..., ::-1])
                if mask is not None:
                    _write_png(temporary / MASK, model.undistorted(mask, is_mask=True))
            camera = model.pinhole()
            record = {**given, "image": name, "camera": dataclasses.asdict(camera)}
            write_json(temporary / "scene.json", record | ({"ground_truth": truth} if truth else {}))
            self._read(LoggedScene.load, temporary)
        return LoggedScene.load(folder)

    def _given(self, folder: pathlib.Path) -> dict[str, Any]:
        """What the facts of our logs hold, or options give."""
        options, log = self.options, self.log
        found: dict[str, Any] = {"id": options.scene_id or (self.facts["id"] if self.facts else folder.resolve().name)}
        flags = {"table_z_m": "--table-z", "hand_height_m": "--hand-height", "start": "--start", "goal": "--goal"}
        for name in ("table_z_m", "hand_height_m"):
            value = getattr(options, name)
            found[name] = self.facts.get(name) if value is None else value
        for name, usual in (("start", START), ("goal", GOAL)):
            value = getattr(options, name) or (usual if usual in log.messages else None)
            if isinstance(value, Pose):
                found[name] = {"position_m": [value.x_m, value.y_m, value.z_m], "yaw_rad": value.yaw_rad}
            else:
                found[name] = None if value is None else self._task(value)
        missing = [flag for name, flag in flags.items() if found[name] is None]
        if missing:
            raise DataError(log.path, f"does not hold everything of a scene; give {', '.join(missing)}")
        return found

    def _write_image(self, folder: pathlib.Path) -> str:
        file = compressed_image(self.log.path, self.topic, self.image)
        if file is None:
            _write_png(folder / "image.png", raw_image(self.log.path, self.topic, self.image)[..., ::-1])
            return "image.png"
        data, suffix = file
        (folder / FORMATS[suffix]).write_bytes(data)
        return FORMATS[suffix]

    def _read(self, read: Callable[[pathlib.Path], Any], path: pathlib.Path) -> Any:
        """Read what was just written; errors name the log instead of the temporary folder."""
        try:
            return read(path)
        except DataError as error:
            what = "that" if error.path == path else f"whose {error.path.name}"
            reason = error.reason.replace(f"{path if path.is_dir() else path.parent}/", "")
            raise DataError(self.log.path, f"holds a scene {what} {reason}") from error

    def _model(self, rgb: NDArray[np.uint8]) -> CameraModel:
        """The camera with its pose in the world frame."""
        log, options = self.log, self.options
        if options.camera is not None:
            try:
                model = options.camera.resized(rgb.shape[1], rgb.shape[0])
            except SettingsError as error:
                raise DataError(log.path, f"{self.topic}: {error}") from error
            if model.position_m is not None:
                return model
        else:
            model = self._logged_model(rgb)
        if self.frames is None:
            raise DataError(
                log.path,
                "has no transforms to place the camera; give --camera with a file of `deltasafe camera locate`",
            )
        frame = options.camera_frame or self.frame
        if frame == options.world_frame:
            raise DataError(log.path, f"{self.topic} is in the frame {frame!r}; give the camera a frame of its own")
        pose = self.frames.pose_in_world(frame, self.time_ns)
        turned = pose.rotation.as_matrix()
        exact = np.array(self.facts.get("camera_rotation", turned.tolist()), np.float64)
        if exact.shape != (3, 3) or not np.abs(exact - turned).max() <= 1e-6:
            raise DataError(log.path, "transforms and metadata disagree about where the camera looks; export it again")
        return model.placed(pose.position_m, exact)

    def _require_size(self, topic: str, image: NDArray[np.uint8], other: str, width: Any, height: Any) -> None:
        if image.shape[:2] != (height, width):
            raise DataError(
                self.log.path,
                f"{topic} is {image.shape[1]} x {image.shape[0]} pixels, {other} is for {width!r:.9} x {height!r:.9}; "
                "give those that belong together",
            )

    def _logged_model(self, rgb: NDArray[np.uint8]) -> CameraModel:
        calibration = self._calibration()
        self._require_size(self.topic, rgb, self._calibration_topic(), calibration["width"], calibration["height"])
        fields = {"model" if name == "distortion_model" else name: value for name, value in calibration.items()}
        # our logs of version 0.1 before its release counted as the library does
        first = self.facts.get("first_pixel_center", HALF_PIXEL) if self.facts else 0.0
        if first not in (0.0, HALF_PIXEL):
            raise DataError(self.log.path, f"first_pixel_center must be 0 or {HALF_PIXEL}, got {first!r:.80}")
        for name, places in (("K", (2, 5)), ("P", (2, 6))):
            if first and fields.get(name):
                fields[name] = [value - first * (n in places) for n, value in enumerate(fields[name])]
        words = self._base_topic().rsplit("/", 1)[-1].split("_")
        kind: ImageKind | None = "rectified" if "rect" in words else "raw" if "raw" in words else None
        return camera_from_intrinsics(self.log.path, fields, self.options.image_kind or kind)

    def _base_topic(self) -> str:
        return self.topic.removesuffix("/compressed")  # image_transport names the compressed topic after the raw one

    def _calibration_topic(self) -> str:
        beside = f"{self._base_topic().rsplit('/', 1)[0]}/camera_info"
        usual = beside if beside in self.log.messages else CALIBRATION
        return _topic(self.log, "calibration", self.options.calibration_topic, usual, "--calibration-topic or --camera")

    def _calibration(self) -> Message:
        """The calibration in the image's frame; if they differ, the newest one that is not later than the image."""
        log, topic = self.log, self._calibration_topic()
        messages = log.messages_on(topic)
        found = [one for one in messages if frame_of(log, topic, one) == self.frame]
        if not found:
            names = sorted({frame_of(log, topic, one) for one in messages})
            raise DataError(
                log.path,
                f"{topic} is of the frame {', '.join(map(repr, names))}, {self.topic} of {self.frame!r}; "
                "give the calibration of that camera",
            )
        if _agree(found):
            return found[0]
        earlier = [one for one in found if time_ns_of(log.path, topic, one) <= self.time_ns]
        if not earlier:
            raise DataError(
                log.path, f"{topic} varies, and all are later than {self.topic}; give the one of that image"
            )
        return max(earlier, key=lambda one: time_ns_of(log.path, topic, one))

    def _task(self, topic: str) -> dict[str, Any]:
        """Start or goal in the world frame, upright."""
        log, world = self.log, self.options.world_frame
        messages = log.messages_on(topic)
        if not _agree(messages):
            raise DataError(log.path, f"{topic} holds {len(messages)} poses that differ; keep the one of the task")
        message = messages[0]
        pose = pose_of(log, topic, message["pose"]["position"], message["pose"]["orientation"])
        frame, own_ns = frame_of(log, topic, message), time_ns_of(log.path, topic, message)
        if self.frames is not None:
            outer = self.frames.pose_in_world(frame, self.time_ns)
            if self.frames.is_connected(frame, own_ns) and not same_pose(
                outer, self.frames.pose_in_world(frame, own_ns)
            ):
                raise DataError(
                    log.path,
                    f"{topic} is given in the frame {frame!r}, which moved between {self.topic} and that pose; "
                    f"give the pose in the frame {world!r}",
                )
            pose = pose.within(outer)
        elif frame != world:
            raise DataError(log.path, f"{topic} is in the frame {frame!r}; without transforms give it in {world!r}")
        tilt_rad = math.acos(min(max(float(pose.rotation.as_matrix()[2, 2]), -1.0), 1.0))
        if tilt_rad > MAX_TILT_RAD:
            raise DataError(
                log.path,
                f"{topic} is tilted by {math.degrees(tilt_rad):.4g} degrees in the frame {world!r}; give a pose that "
                f"is upright (z up) within {math.degrees(MAX_TILT_RAD):g} degrees, as the tool always is",
            )
        return {"position_m": pose.position_m.tolist(), "yaw_rad": yaw_about_z(*map(float, pose.quaternion[2:]))}


def _topic(log: LogContent, kind: str, named: str | None, usual: str, flag: str) -> str:
    """The topic that an option names, else the usual one, else the only one of its kind."""
    topics = log.topics(kind)
    if named is not None or usual in topics:
        topic = named or usual
        if topic in log.messages and topic not in topics:
            raise DataError(log.path, f"{topic} holds no {kind}; these do: {topics}")
        return topic
    if len(topics) == 1:
        return topics[0]
    if topics:
        raise DataError(log.path, f"has several {kind} topics, {topics}; choose one with {flag}")
    unread = f", only {log.unread}, which cannot be read" if log.unread else ""
    raise DataError(log.path, f"has no {kind} topic{unread}; record it, or give {flag}")


def _agree(messages: list[Message]) -> bool:
    """Whether messages are equal except for their timestamps."""
    return all({**one, "timestamp": None} == {**messages[0], "timestamp": None} for one in messages)


def _write_png(path: pathlib.Path, pixels: NDArray[np.uint8]) -> None:
    path.write_bytes(cv2.imencode(".png", np.ascontiguousarray(pixels))[1].tobytes())
