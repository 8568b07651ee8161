"""A camera with lens distortion: the images that it takes, and the pinhole camera of their undistorted version."""

import dataclasses
import functools
import math
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from deltasafe.errors import SettingsError
from deltasafe.scene import Camera

Array = NDArray[np.float64]

HALF_PIXEL = 0.5
"""OpenCV and ROS put the center of the first pixel at (0, 0); this library, at (0.5, 0.5): u = u_opencv + 0.5."""

MODELS = {"plumb_bob": (4, 5), "rational_polynomial": (8, 12, 14), "equidistant": (4,)}
"""Names of distortion models as in ROS, and how many coefficients each may have, in OpenCV's order."""

CENTRAL = (0.3, 0.7)
"""Where the principal point of a whole image lies, as a fraction of its size; half the resolution would be at 0.25."""

MAX_VIEW = math.tan(math.radians(60))
"""Largest slope of a ray against the optical axis, per direction, in an undistorted image of a wide lens."""

MAX_ZOOM, ZOOM_TOLERANCE = 2.0, 1e-6
N_BORDER, N_GRID = 201, 41
ROWS_AT_ONCE = 256


@dataclasses.dataclass(frozen=True)
class CameraModel:
    """Intrinsics of a camera, its lens distortion, and its pose if it is known. Pixels are counted as in `Camera`.

    Attributes:
        width, height: size in pixels of the images that were calibrated.
        fx, fy: focal lengths in pixels.
        cx, cy: principal point in pixels, where the first pixel covers [0, 1).
        distortion_model: one of ``MODELS``.
        distortion: coefficients in OpenCV's order: k1, k2, p1, p2, k3, ... or k1 to k4 (equidistant).
        position_m: (3,) optical center in the world frame, or None.
        world_from_camera_rotation: (3, 3) as in `Camera`, or None.

    Raises:
        SettingsError: a value is outside its domain, the principal point is far from the image's center, or the
            distortion cannot be undone inside the image.
    """

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    distortion_model: str = "plumb_bob"
    distortion: tuple[float, ...] = (0.0,) * 5
    position_m: Array | None = None
    world_from_camera_rotation: Array | None = None

    def __post_init__(self) -> None:
        if (self.position_m is None) != (self.world_from_camera_rotation is None):
            raise SettingsError("a pose needs position_m and world_from_camera_rotation; give both or none")
        if not isinstance(self.distortion_model, str) or self.distortion_model not in MODELS:
            raise SettingsError(f"distortion_model must be one of {list(MODELS)}, got {self.distortion_model!r:.80}")
        object.__setattr__(self, "distortion", tuple(map(float, self.distortion)))
        allowed = MODELS[self.distortion_model]
        if len(self.distortion) not in allowed:
            raise SettingsError(
                f"{self.distortion_model} needs {' or '.join(map(str, allowed))} distortion coefficients, "
                f"got {len(self.distortion)}"
            )
        if not all(math.isfinite(one) for one in self.distortion):
            raise SettingsError(f"distortion coefficients must be finite, got {list(self.distortion)}")
        pinhole = self._pinhole(1.0)  # checks the other fields
        for name in ("position_m", "world_from_camera_rotation"):
            if getattr(self, name) is not None:
                object.__setattr__(self, name, getattr(pinhole, name))
        for name, value, size in (("cx", self.cx, self.width), ("cy", self.cy, self.height)):
            if not CENTRAL[0] * size <= value <= CENTRAL[1] * size:
                raise SettingsError(
                    f"the principal point {name} = {value:g} is far from the center of {size} pixels; the intrinsics "
                    "seem to be of another resolution or of a cropped image, give those of the whole image"
                )
        self.zoom  # noqa: B018 - refuses a distortion that cannot be undone

    @property
    def has_distortion(self) -> bool:
        """Whether undistorted images differ from those that the camera takes."""
        return self.distortion_model == "equidistant" or any(self.distortion)

    @functools.cached_property
    def zoom(self) -> float:
        """The focal lengths of undistorted images, as a multiple of ``fx`` and ``fy``.

        It is the smallest one with which each undistorted pixel shows a pixel of the image, so that no empty pixel
        can be taken for a free table. The principal point stays.
        """
        if not self.has_distortion:
            return 1.0
        low = max(
            max(self.cx, self.width - self.cx) / (self.fx * MAX_VIEW),
            max(self.cy, self.height - self.cy) / (self.fy * MAX_VIEW),
        )
        high = max(MAX_ZOOM, 2 * low)
        if self._is_covered(low):
            return low
        if not self._is_covered(high):
            raise SettingsError(
                f"undoing the distortion would leave less than {1 / MAX_ZOOM:.0%} of the view; "
                "calibrate again with boards up to the image's corners"
            )
        while high / low > 1 + ZOOM_TOLERANCE:  # views of larger zooms lie inside those of smaller ones
            middle = math.sqrt(low * high)
            low, high = (low, middle) if self._is_covered(middle) else (middle, high)
        return high

    def resized(self, width: int, height: int) -> "CameraModel":
        """Return the model for images of the same view with another resolution.

        Raises:
            SettingsError: the size has another aspect ratio.
        """
        if (width, height) == (self.width, self.height):
            return self
        if abs(width * self.height / self.width - height) > 1 and abs(height * self.width / self.height - width) > 1:
            raise SettingsError(
                f"the image has {width} x {height} pixels, the calibration {self.width} x {self.height}, another "
                "aspect ratio; calibrate at that size, or give the image as the camera took it (neither cropped nor "
                "turned)"
            )
        horizontal, vertical = width / self.width, height / self.height
        return dataclasses.replace(
            self,
            width=width,
            height=height,
            fx=self.fx * horizontal,
            cx=self.cx * horizontal,
            fy=self.fy * vertical,
            cy=self.cy * vertical,
        )

    def placed(self, position_m: Array, world_from_camera_rotation: Array) -> "CameraModel":
        """Return the model with a pose."""
        return dataclasses.replace(self, position_m=position_m, world_from_camera_rotation=world_from_camera_rotation)

    def pinhole(self) -> Camera:
        """Return the pinhole camera of undistorted images.

        Raises:
            SettingsError: the pose is unknown.
        """
        if self.position_m is None:
            raise SettingsError("the camera's pose is unknown; determine it with `deltasafe camera locate`")
        return self._pinhole(self.zoom)

    def undistorted(self, image: NDArray[Any], is_mask: bool = False) -> NDArray[Any]:
        """Undistort an image (H, W) or (H, W, channels) of this size, in strips that bound the memory.

        Args:
            is_mask: take the nearest pixel instead of interpolating.
        """
        if image.shape[:2] != (self.height, self.width):
            raise SettingsError(
                f"the image has {image.shape[1]} x {image.shape[0]} pixels, the camera {self.width} x {self.height}; "
                "resize the model first"
            )
        if not self.has_distortion:
            return image
        result = np.empty_like(image)
        make_map = cv2.fisheye.initUndistortRectifyMap if self._is_fisheye else cv2.initUndistortRectifyMap
        how = cv2.INTER_NEAREST if is_mask else cv2.INTER_LINEAR
        for row in range(0, self.height, ROWS_AT_ONCE):
            rows = min(ROWS_AT_ONCE, self.height - row)
            wanted = _matrix(self._pinhole(self.zoom))
            wanted[1, 2] -= row
            size = (self.width, rows)
            maps = make_map(self.matrix, self.coefficients, np.eye(3), wanted, size, cv2.CV_32FC1)
            result[row : row + rows] = cv2.remap(image, *maps, how, borderMode=cv2.BORDER_REPLICATE)
        return result

    @property
    def matrix(self) -> Array:
        """(3, 3) camera matrix of the images in OpenCV's convention."""
        return _matrix(self._pinhole(1.0))

    @property
    def coefficients(self) -> Array:
        """Distortion coefficients for OpenCV's functions."""
        return np.array(self.distortion)

    def distort(self, uv: Array) -> Array:
        """Map pixel coordinates (N, 2) of undistorted images to those of the images that the camera takes."""
        return self._distorted(uv, self.zoom)

    def pixels(self, points_m: Array) -> Array:
        """Project points (N, 3) in the camera's frame to pixel coordinates (N, 2) of the images that it takes.

        Points that are not in front of the camera have NaN.
        """
        points_m = np.asarray(points_m, np.float64)
        uv = np.full((len(points_m), 2), np.nan)
        front = points_m[:, 2] > 0
        if front.any():
            project = cv2.fisheye.projectPoints if self._is_fisheye else cv2.projectPoints
            seen = np.ascontiguousarray(points_m[front, None] / points_m[front, None, 2:])
            found, _ = project(seen, np.zeros(3), np.zeros(3), self.matrix, self.coefficients)
            uv[front] = found.reshape(-1, 2) + HALF_PIXEL
        return uv

    def project(self, points_m: Array) -> Array:
        """Project world points (N, 3) as `pixels` does.

        Raises:
            SettingsError: the pose is unknown.
        """
        camera = self.pinhole()
        return self.pixels((np.asarray(points_m, np.float64) - camera.position_m) @ camera.world_from_camera_rotation)

    @property
    def _is_fisheye(self) -> bool:
        return self.distortion_model == "equidistant"

    def _pinhole(self, zoom: float) -> Camera:
        known = self.position_m is not None and self.world_from_camera_rotation is not None
        return Camera(
            self.width,
            self.height,
            self.fx * zoom,
            self.fy * zoom,
            self.cx,
            self.cy,
            self.position_m if known else np.zeros(3),  # type: ignore[arg-type]
            self.world_from_camera_rotation if known else np.eye(3),  # type: ignore[arg-type]
        )

    def _distorted(self, uv: Array, zoom: float) -> Array:
        slopes = (np.asarray(uv, np.float64) - (self.cx, self.cy)) / (self.fx * zoom, self.fy * zoom)
        return self.pixels(np.column_stack([slopes, np.ones(len(slopes))]))

    def _is_covered(self, zoom: float) -> bool:
        """Whether each pixel of the undistorted image lies in the image, and the distortion does not fold between."""
        along, size = np.linspace(0, 1, N_BORDER), np.array([self.width, self.height])
        start, end = np.zeros(N_BORDER), np.ones(N_BORDER)
        sides = [(along, start), (along, end), (start, along), (end, along)]
        border = np.concatenate([np.column_stack(side) for side in sides]) * size
        grid = np.stack(np.meshgrid(*[np.linspace(0, 1, N_GRID)] * 2), axis=-1) * size
        inner = self._distorted(grid.reshape(-1, 2), zoom).reshape(grid.shape)
        right, down = np.diff(inner, axis=1)[:-1], np.diff(inner, axis=0)[:, :-1]
        turns = right[..., 0] * down[..., 1] - right[..., 1] * down[..., 0]
        outer = self._distorted(border, zoom)
        return bool((turns > 0).all() and (outer >= 0).all() and (outer <= size).all())


def _matrix(camera: Camera) -> Array:
    """(3, 3) camera matrix in OpenCV's convention."""
    cx, cy = camera.cx - HALF_PIXEL, camera.cy - HALF_PIXEL
    return np.array([[camera.fx, 0.0, cx], [0.0, camera.fy, cy], [0.0, 0.0, 1.0]])
