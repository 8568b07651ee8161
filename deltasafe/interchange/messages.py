"""Messages of ROS and Foxglove in one form: images, calibrations, transforms and poses with Foxglove's field names."""

import base64
from collections.abc import Callable, Mapping
from typing import Any

KINDS = {
    "foxglove.CompressedImage": "image",
    "foxglove.RawImage": "image",
    "foxglove.CameraCalibration": "calibration",
    "foxglove.FrameTransform": "transform",
    "foxglove.FrameTransforms": "transform",
    "foxglove.PoseInFrame": "pose",
    "sensor_msgs/CompressedImage": "image",
    "sensor_msgs/Image": "image",
    "sensor_msgs/CameraInfo": "calibration",
    "tf2_msgs/TFMessage": "transform",
    "geometry_msgs/TransformStamped": "transform",
    "geometry_msgs/PoseStamped": "pose",
}
"""What a type of messages holds. Types of ROS are named without ``msg/``."""


def type_name_of(schema: str) -> str:
    """Return the name of a type as in ``KINDS``: ``sensor_msgs/msg/Image`` is ``sensor_msgs/Image``."""
    return schema.replace("/msg/", "/")


def normalized(type_name: str, message: dict[str, Any]) -> list[dict[str, Any]]:
    """Convert a message to Foxglove's form; other types are returned as they are.

    Raises:
        KeyError, TypeError, AttributeError, ValueError: it lacks a field, or is not of that type.
    """
    if type_name == "foxglove.FrameTransforms":
        return list(message["transforms"])
    if type_name == "tf2_msgs/TFMessage":
        return [_transform(one) for one in message["transforms"]]
    return [_CONVERSIONS[type_name](message)] if type_name in _CONVERSIONS else [message]


def bytes_of(value: Any) -> bytes:
    """Return the bytes of a field: bytes, text in base64, or a list of numbers.

    Raises:
        TypeError, ValueError: it is none of these.
    """
    if isinstance(value, str):
        return base64.b64decode(value, validate=True)
    if isinstance(value, list):
        return bytes(value)
    if isinstance(value, bytes):
        return value
    raise TypeError(f"{type(value).__name__} holds no bytes")


def _header(message: Mapping[str, Any]) -> dict[str, Any]:
    header = message["header"]
    frame = header["frame_id"]
    stamp = header["stamp"]
    nsec = next((stamp[name] for name in ("nanosec", "nsec", "nsecs") if name in stamp), None)
    return {
        "timestamp": {"sec": stamp["sec"] if "sec" in stamp else stamp.get("secs"), "nsec": nsec},
        "frame_id": frame.lstrip("/") if isinstance(frame, str) else frame,  # ROS 1 wrote /camera for camera
    }


def _with_header(message: Mapping[str, Any]) -> dict[str, Any]:
    return {**message, **_header(message)}


def _transform(message: Mapping[str, Any]) -> dict[str, Any]:
    header, child = _header(message), message["child_frame_id"]
    return {
        "timestamp": header["timestamp"],
        "parent_frame_id": header["frame_id"],
        "child_frame_id": child.lstrip("/") if isinstance(child, str) else child,
        "translation": message["transform"]["translation"],
        "rotation": message["transform"]["rotation"],
    }


def _calibration(message: Mapping[str, Any]) -> dict[str, Any]:
    names = {"D": "d", "K": "k", "R": "r", "P": "p"}
    return {
        **{name: message[name] for name in ("width", "height", "distortion_model")},
        **{upper: message[lower if lower in message else upper] for upper, lower in names.items()},
        **{name: message[name] for name in ("binning_x", "binning_y", "roi") if name in message},
        **_header(message),
    }


_CONVERSIONS: dict[str, Callable[[Mapping[str, Any]], dict[str, Any]]] = {
    "geometry_msgs/TransformStamped": _transform,
    "geometry_msgs/PoseStamped": _with_header,
    "sensor_msgs/CameraInfo": _calibration,
    "sensor_msgs/Image": _with_header,
    "sensor_msgs/CompressedImage": _with_header,
}
