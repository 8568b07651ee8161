"""Calibration files: of OpenCV (YAML, XML, JSON), of ROS (camera_info), and camera files of this library."""

import dataclasses
import math
import pathlib
import re
from collections.abc import Mapping
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from deltasafe.cameras.calibration_text import integer_of, numbers_of, parse_calibration
from deltasafe.cameras.model import HALF_PIXEL, MODELS, CameraModel
from deltasafe.errors import DataError, SettingsError
from deltasafe.io.storage import read_json, write_json

ImageKind = Literal["raw", "rectified"]
Array = NDArray[np.float64]

FORMAT = "deltasafe.camera/1"
KEYS = {
    "width": ("imagewidth", "width"),
    "height": ("imageheight", "height"),
    "K": ("cameramatrix", "k", "mtx", "intrinsicmatrix"),
    "D": ("distortioncoefficients", "distcoeffs", "distcoeff", "dist", "d"),
    "model": ("distortionmodel",),
    "R": ("rectificationmatrix", "r"),
    "P": ("projectionmatrix", "p"),
    "fisheye": ("fisheyemodel",),
    "binning_x": ("binningx",),
    "binning_y": ("binningy",),
    "roi": ("roi",),
    "xi": ("xi",),
}
"""Field names of OpenCV's samples, of ROS 1 and 2, and of common scripts, in lower case without separators."""

MODEL_NAMES = {"fisheye": "equidistant", "": "plumb_bob", "none": "plumb_bob"}
TOLERANCE_PX = 1e-3
"""Between K and P of the same camera; files are rounded to this or more digits."""


def read_camera(path: str | pathlib.Path, image_kind: ImageKind | None = None) -> CameraModel:
    """Read a camera file or a calibration file; the latter holds no pose.

    Intrinsics of OpenCV and ROS are converted: they count pixels from the center of the first one.

    Args:
        image_kind: ``raw`` for images as the camera takes them, ``rectified`` for images that ROS has undistorted.
            Needed if the file describes both and they differ.

    Raises:
        DataError: the file is missing or unreadable, a field is missing or outside its domain, or it describes another
            camera than one lens with perpendicular axes: skew, a region of interest, or an unknown distortion model.
    """
    path = pathlib.Path(path)
    record = parse_calibration(path)
    if record.get("format") == FORMAT:
        return _own(path, read_json(path))
    return camera_from_intrinsics(path, _known_fields(path, record), image_kind)


def write_camera(path: str | pathlib.Path, camera: CameraModel, **facts: Any) -> None:
    """Write a camera file, atomically; ``facts`` are stored with it, and ignored when it is read.

    Raises:
        WriteError: no space or no permission.
    """
    record = {field.name: getattr(camera, field.name) for field in dataclasses.fields(camera)}
    write_json(path, {"format": FORMAT, **record, "facts": facts})


def camera_from_intrinsics(
    path: pathlib.Path, fields: Mapping[str, Any], image_kind: ImageKind | None = None
) -> CameraModel:
    """Make a camera of the fields of a ROS ``CameraInfo``: width, height, model, D, K, and if present R and P.

    Args:
        path: named in errors.
        fields: by the keys of ``KEYS``; matrices as nested lists, or as OpenCV stores them.
        image_kind: as in `read_camera`.

    Raises:
        DataError: as `read_camera`.
    """
    fields = {name: value for name, value in fields.items() if value != []} | {"D": fields.get("D")}
    missing = [name for name in ("width", "height", "K", "D") if fields.get(name) is None]
    if missing:
        names = {"width": "image_width", "height": "image_height", "K": "camera_matrix", "D": "distortion_coefficients"}
        raise DataError(path, f"has no {', '.join(names[name] for name in missing)}; add what the calibration gave")
    _refuse_cropped(path, fields)
    size = [integer_of(path, name, fields[name]) for name in ("width", "height")]
    matrix, distortion = numbers_of(path, "K", fields["K"], 9), numbers_of(path, "D", fields["D"])
    if matrix[1] != 0 or matrix[[3, 6, 7, 8]].tolist() != [0, 0, 0, 1]:
        raise DataError(
            path,
            f"has the camera matrix {matrix.tolist()}; only fx, fy, cx, cy can differ from 0 0 0 1 "
            "(a skew cannot be read), calibrate without it",
        )
    model = _model(path, fields, distortion)
    if not len(distortion) and model == "plumb_bob":  # simulators leave it empty
        distortion = np.zeros(5)
    if image_kind != "raw" and _is_rectified(path, fields, matrix, image_kind):
        matrix = np.delete(numbers_of(path, "P", fields["P"], 12), (3, 7, 11))
        model, distortion = "plumb_bob", np.zeros(5)
    return _checked(path, size, matrix, model, distortion)


def _checked(path: pathlib.Path, size: list[int], matrix: Array, model: str, distortion: Array) -> CameraModel:
    fx, cx, fy, cy = matrix[[0, 2, 4, 5]].tolist()
    try:
        return CameraModel(
            size[0], size[1], fx, fy, cx + HALF_PIXEL, cy + HALF_PIXEL, model, tuple(distortion.tolist())
        )
    except SettingsError as error:
        raise DataError(path, str(error)) from error


def _own(path: pathlib.Path, record: Any) -> CameraModel:
    names = [field.name for field in dataclasses.fields(CameraModel)]
    if not isinstance(record, dict) or set(record) - {"facts"} != {"format", *names}:
        raise DataError(path, f"a camera file needs exactly the fields {['format', *names]}; write it again")
    values = {name: record[name] for name in names}
    try:
        for name in ("fx", "fy", "cx", "cy"):
            (values[name],) = numbers_of(path, name, [record[name]], 1).tolist()
        values["distortion"] = numbers_of(path, "distortion", record["distortion"]).tolist()
        for name, shape in (("position_m", (3,)), ("world_from_camera_rotation", (3, 3))):
            if record[name] is not None:
                values[name] = numbers_of(path, name, record[name], math.prod(shape)).reshape(shape)
        return CameraModel(**values)
    except (SettingsError, TypeError) as error:
        if isinstance(error, DataError):
            raise
        raise DataError(path, str(error)) from error


def _known_fields(path: pathlib.Path, record: Mapping[str, Any]) -> dict[str, Any]:
    found: dict[str, Any] = {}
    for key, value in record.items():
        plain = re.sub(r"[-_\s]", "", str(key)).lower()
        for name, spellings in KEYS.items():
            if plain in spellings:
                if name in found:
                    raise DataError(path, f"holds {key!r} twice, in two spellings; keep the right one")
                found[name] = value
    return found


def _refuse_cropped(path: pathlib.Path, fields: Mapping[str, Any]) -> None:
    given = fields.get("roi")
    roi = given if isinstance(given, Mapping) else {}
    offsets = [roi.get(name, 0) for name in ("x_offset", "y_offset")]
    sizes = [roi.get(name, 0) not in (0, fields[name]) for name in ("width", "height")]
    if any(offsets) or any(sizes) or any(fields.get(f"binning_{axis}") not in (None, 0, 1) for axis in "xy"):
        raise DataError(
            path, "describes images with a region of interest or binning; switch both off in the driver, and calibrate"
        )
    if fields.get("xi") is not None:
        raise DataError(path, "is of an omnidirectional camera (xi); calibrate as plumb_bob or equidistant")


def _model(path: pathlib.Path, fields: Mapping[str, Any], distortion: Array) -> str:
    name = fields.get("model")
    if name is not None:
        name = MODEL_NAMES.get(str(name).lower(), str(name).lower())
        if name not in MODELS:
            raise DataError(path, f"has the distortion model {name!r:.80}; calibrate with one of {list(MODELS)}")
        return name
    if not len(distortion):
        return "plumb_bob"
    if fields.get("fisheye") not in (None, 0, "0", False):
        return "equidistant"
    matches = [name for name, numbers in MODELS.items() if len(distortion) in numbers]
    if len(matches) != 1:
        which = f"may be {' or '.join(matches)}" if matches else "fit no distortion model"
        raise DataError(
            path, f"has {len(distortion)} distortion coefficients, which {which}; add the field distortion_model"
        )
    return matches[0]


def _is_rectified(path: pathlib.Path, fields: Mapping[str, Any], matrix: Array, image_kind: ImageKind | None) -> bool:
    """Whether to use P; refuse a file whose P or R differ from the camera itself if nothing says which is meant."""
    projection = np.zeros((3, 4)) if fields.get("P") is None else numbers_of(path, "P", fields["P"], 12).reshape(3, 4)
    rotation = np.eye(3) if fields.get("R") is None else numbers_of(path, "R", fields["R"], 9).reshape(3, 3)
    is_filled = bool(projection.any())  # simulators and uncalibrated drivers leave it at zero
    is_stereo = np.abs(rotation - np.eye(3)).max() > 1e-6 or bool(np.abs(projection[:, 3]).max() > TOLERANCE_PX)
    if image_kind == "rectified":
        if is_stereo or not is_filled:
            what = "rectifies a stereo pair (R or P)" if is_stereo else "has no projection_matrix for rectified images"
            raise DataError(path, f"{what}; give raw images and --image-kind raw")
        return True
    differs = is_filled and np.abs(projection[:, :3] - matrix.reshape(3, 3)).max() > TOLERANCE_PX
    if differs or is_stereo:
        what = "R is not the identity, or P has an offset" if is_stereo else "P differs from K"
        raise DataError(
            path,
            f"describes raw and rectified images, and {what}; give --image-kind raw or rectified, as the image is",
        )
    return False
