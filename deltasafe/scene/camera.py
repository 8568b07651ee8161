"""The pinhole camera above the table: projection of world points, and back-projection to a known height."""

import dataclasses
import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from deltasafe.errors import SettingsError

Array = NDArray[np.float64]

MAX_NUMBER = 1e6
"""Largest number in pixels or meters, and inverse of the smallest focal length: others suggest wrong units."""

CENTRAL = (0.1, 0.9)
"""Where the principal point may be, as a fraction of the image's size. A moderately cropped image has it off center."""

SCALARS = ("fx", "fy", "cx", "cy")
SHAPES = {"position_m": (3,), "world_from_camera_rotation": (3, 3)}


@dataclasses.dataclass(frozen=True)
class Camera:
    """A pinhole camera without distortion. Pixel (row i, column j) covers v in [i, i + 1) and u in [j, j + 1).

    Attributes:
        width: columns of the image.
        height: rows of the image.
        fx, fy: focal lengths in pixels.
        cx, cy: principal point in pixels.
        position_m: (3,) optical center in the world frame.
        world_from_camera_rotation: (3, 3); the columns are the camera's x (right), y (down) and z (forward) axes.

    Raises:
        SettingsError: a size or focal length is not positive, a number is beyond 1e6 (a focal length also below
            1e-6), or the matrix is not a rotation.
    """

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    position_m: Array
    world_from_camera_rotation: Array

    def __post_init__(self) -> None:
        for name in ("width", "height"):
            if not (type(getattr(self, name)) is int and 0 < getattr(self, name) <= MAX_NUMBER):
                raise SettingsError(f"{name} must be a positive number of pixels, got {getattr(self, name)!r}")
        for name in SCALARS:
            if not abs(getattr(self, name)) <= MAX_NUMBER:
                raise SettingsError(f"{name} must be finite, up to {MAX_NUMBER:g}, got {getattr(self, name)!r:.80}")
        if min(self.fx, self.fy) < 1 / MAX_NUMBER:
            raise SettingsError(f"focal lengths must be positive, got fx {self.fx}, fy {self.fy}")
        for name, shape in SHAPES.items():
            value = np.array(getattr(self, name), dtype=np.float64)
            if value.shape != shape or not np.isfinite(value).all():
                raise SettingsError(f"{name} must be a finite array of shape {shape}, got {value.tolist()}")
            value.setflags(write=False)
            object.__setattr__(self, name, value)
        rotation = self.world_from_camera_rotation
        if np.abs(rotation.T @ rotation - np.eye(3)).max() > 1e-6 or np.linalg.det(rotation) < 0:
            raise SettingsError("world_from_camera_rotation must be a rotation (orthonormal, right-handed)")

    @classmethod
    def from_json(cls, value: Mapping[str, Any]) -> "Camera":
        """Read the object ``camera`` of a ``scene.json``.

        Raises:
            SettingsError: a field is missing, unknown or outside its domain, or the principal point is near the border.
        """
        fields = [field.name for field in dataclasses.fields(cls)]
        if not isinstance(value, Mapping) or set(value) != set(fields):
            found = sorted(value) if isinstance(value, Mapping) else type(value).__name__
            raise SettingsError(f"camera needs exactly the fields {fields}, got {found}")
        for name in (*SCALARS, *SHAPES):
            if not _holds_numbers(value[name], SHAPES.get(name, ())):
                raise SettingsError(f"camera must hold numbers, in pixels and meters, got {name} {value[name]!r:.80}")
        camera = cls(**{**value, **{name: float(value[name]) for name in SCALARS}})
        for name, size in (("cx", camera.width), ("cy", camera.height)):
            if not CENTRAL[0] * size <= getattr(camera, name) <= CENTRAL[1] * size:
                raise SettingsError(
                    f"the principal point {name} = {getattr(camera, name):g} must be away from the border of {size} "
                    "pixels; the intrinsics seem to be of another resolution, scale them to the image"
                )
        return camera

    def project(self, points_m: Array) -> tuple[Array, Array]:
        """Project world points (N, 3): pixel coordinates (u, v) as (N, 2), and depths (N,) along the optical axis.

        Points that are not in front of the camera have a depth <= 0 and pixel coordinates NaN.
        """
        local = (np.asarray(points_m, dtype=np.float64) - self.position_m) @ self.world_from_camera_rotation
        depth_m = local[:, 2]
        uv = np.full((len(local), 2), np.nan)
        front = depth_m > 0
        uv[front] = local[front, :2] / depth_m[front, None] * (self.fx, self.fy) + (self.cx, self.cy)
        return uv, depth_m

    def pixel_to_plane(self, uv: Array, z_m: float) -> Array:
        """Intersect the rays through pixel coordinates (N, 2) with the plane z = ``z_m``: world points (N, 3).

        Raises:
            SettingsError: a ray does not meet the plane in front of the camera.
        """
        uv = np.asarray(uv, dtype=np.float64)
        local = np.column_stack([(uv - (self.cx, self.cy)) / (self.fx, self.fy), np.ones(len(uv))])
        rays = local @ self.world_from_camera_rotation.T
        with np.errstate(divide="ignore", invalid="ignore"):
            depth_m = (z_m - self.position_m[2]) / rays[:, 2]
        if not (np.isfinite(depth_m) & (depth_m > 0)).all():
            raise SettingsError(
                f"the camera's rays do not all meet the plane z = {z_m} m; the whole image must show the table"
            )
        return np.asarray(self.position_m + rays * depth_m[:, None])

    def ground_sampling_distance_m(self, points_m: Array) -> float:
        """Return the largest length in a horizontal plane that one pixel covers, in any direction, at points (N, 3).

        It is the inverse of the smallest singular value of the derivative of (u, v) by (x, y).

        Raises:
            SettingsError: a point is not in front of the camera.
        """
        local = (np.asarray(points_m, dtype=np.float64) - self.position_m) @ self.world_from_camera_rotation
        if not (local[:, 2] > 0).all():
            raise SettingsError("the ground sampling distance exists only at points in front of the camera")
        by_x, by_y = self.world_from_camera_rotation[:2]  # of the camera's coordinates
        jacobian = [
            [(by[i] - local[:, i] / local[:, 2] * by[2]) * f / local[:, 2] for by in (by_x, by_y)]
            for i, f in enumerate((self.fx, self.fy))
        ]
        smallest = np.linalg.svd(np.moveaxis(np.array(jacobian), 2, 0), compute_uv=False)[:, -1]
        return float(1.0 / smallest.min())

    def view_on_plane(self, z_m: float, lower_m: Array, upper_m: Array) -> Array:
        """Return what the camera sees of a rectangle in the plane z = ``z_m``: a polygon (N, 2), N = 0 if nothing.

        The horizon may be in the image. A view that lies inside the rectangle has the corners of ``pixel_to_plane``.

        Args:
            z_m: a height below the camera.
            lower_m, upper_m: (2,) corners of the rectangle.
        """
        below_m = float(self.position_m[2]) - z_m
        sides = np.maximum(np.abs(lower_m - self.position_m[:2]), np.abs(upper_m - self.position_m[:2]))
        farthest_m = 1.0 + math.hypot(below_m, *sides)  # of all points of the rectangle, hence also of their depths
        corners = np.array([(0, 0), (self.width, 0), (self.width, self.height), (0, self.height)], dtype=np.float64)
        x, y, z = self.world_from_camera_rotation[2]  # height of the camera's axes; a ray sinks by 1 / depth
        sinks = np.array([-x / self.fx, -y / self.fy])
        uv = _clip(corners, sinks, x * self.cx / self.fx + y * self.cy / self.fy - z - below_m / farthest_m)
        polygon = self.pixel_to_plane(uv, z_m)[:, :2]
        for axis in np.eye(2):
            polygon = _clip(_clip(polygon, axis, -float(axis @ lower_m)), -axis, float(axis @ upper_m))
        return polygon


def _clip(polygon: Array, normal: Array, offset: float) -> Array:
    """Cut a convex polygon (N, 2) to the half-plane normal @ point + offset >= 0 (Sutherland and Hodgman 1974)."""
    kept: list[Array] = []
    values = polygon @ normal + offset
    for n in range(len(polygon)):
        point, value, last, before = polygon[n], values[n], polygon[n - 1], values[n - 1]
        if (value >= 0) != (before >= 0):
            kept.append(last + (point - last) * (before / (before - value)))
        if value >= 0:
            kept.append(point)
    return np.array(kept).reshape(-1, 2)


def _holds_numbers(value: Any, shape: tuple[int, ...]) -> bool:
    """Return whether a JSON value is an array of numbers; NumPy would also convert text and booleans."""
    if shape:
        is_array = isinstance(value, list | tuple | np.ndarray) and len(value) == shape[0]
        return is_array and all(_holds_numbers(one, shape[1:]) for one in value)
    return isinstance(value, int | float) and not isinstance(value, bool) and abs(value) <= MAX_NUMBER
