"""Images of logs as RGB arrays: compressed files, and the raw encodings of ROS."""

import pathlib
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from deltasafe.errors import DataError
from deltasafe.interchange.messages import bytes_of

CONVERSIONS: dict[str, tuple[int, int | None]] = {
    "rgb8": (3, None),
    "bgr8": (3, cv2.COLOR_BGR2RGB),
    "8uc3": (3, cv2.COLOR_BGR2RGB),
    "rgba8": (4, cv2.COLOR_RGBA2RGB),
    "bgra8": (4, cv2.COLOR_BGRA2RGB),
    "8uc4": (4, cv2.COLOR_BGRA2RGB),
    "mono8": (1, cv2.COLOR_GRAY2RGB),
    "8uc1": (1, cv2.COLOR_GRAY2RGB),
    "yuv422": (2, cv2.COLOR_YUV2RGB_UYVY),
    "uyvy": (2, cv2.COLOR_YUV2RGB_UYVY),
    "yuv422_yuy2": (2, cv2.COLOR_YUV2RGB_YUYV),
    "yuyv": (2, cv2.COLOR_YUV2RGB_YUYV),
}
"""Bytes per pixel of an encoding, and OpenCV's conversion to RGB. ROS stores 8UC3 and 8UC4 as OpenCV does."""

MAX_PIXELS = 80_000_000


def compressed_image(path: pathlib.Path, topic: str, message: dict[str, Any]) -> tuple[bytes, str] | None:
    """Return the file of a compressed image and its suffix; None for a raw image.

    Raises:
        DataError: it is neither JPEG nor PNG.
    """
    if "encoding" in message and "format" not in message:
        return None
    # Foxglove writes jpeg, ROS also "rgb8; jpeg compressed bgr8"
    words = str(message.get("format")).lower().replace("jpg", "jpeg").replace(";", " ").split()
    suffix = next((word for word in words if word in ("jpeg", "png")), None)
    if suffix is None or "compresseddepth" in words:
        raise DataError(
            path, f"{topic} has the format {message.get('format')!r:.80}; only jpeg and png can be read, convert it"
        )
    try:
        return bytes_of(message["data"]), suffix
    except (KeyError, TypeError, ValueError) as error:
        raise DataError(path, f"{topic} holds no compressed image ({error!r}); record or export it again") from error


def raw_image(path: pathlib.Path, topic: str, message: dict[str, Any]) -> NDArray[np.uint8]:
    """Convert a raw image to (H, W, 3) uint8 in RGB.

    Raises:
        DataError: the encoding cannot be read, or the data does not fit the size.
    """
    encoding = str(message["encoding"]).lower()
    if encoding not in CONVERSIONS:
        remedy = "record the topic after image_proc, such as image_color" if "bayer" in encoding else "convert it"
        raise DataError(
            path, f"{topic} has the encoding {encoding!r:.40}; only {', '.join(CONVERSIONS)} can be read, {remedy}"
        )
    depth, conversion = CONVERSIONS[encoding]
    try:
        width, height, data = message["width"], message["height"], bytes_of(message["data"])
        step = message.get("step") or width * depth
        if not (width > 0 < height and width * height <= MAX_PIXELS and step >= width * depth):
            raise ValueError(f"{width} x {height} pixels in rows of {step} bytes")
        if len(data) != step * height:
            raise ValueError(f"{len(data)} bytes instead of {step * height}")
        rows = np.frombuffer(data, np.uint8).reshape(height, step)[:, : width * depth]
        pixels = np.ascontiguousarray(rows).reshape((height, width, depth) if depth > 1 else (height, width))
        return pixels if conversion is None else np.asarray(cv2.cvtColor(pixels, conversion), np.uint8)
    except (KeyError, TypeError, ValueError, cv2.error) as error:
        raise DataError(
            path, f"{topic} holds no {encoding} image ({error!s:.99}); record or export it again"
        ) from error
