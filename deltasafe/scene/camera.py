"""The pinhole camera that looks at the table: world points to pixels, and back at a known height."""

import dataclasses
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from deltasafe.errors import SettingsError

__all__ = ["Camera"]

Array = NDArray[np.float64]
MOST_PIXELS = 1e6


@dataclasses.dataclass(frozen=True)
class Camera:
    """A pinhole without distortion. Pixel (row i, column j) covers v in [i, i + 1) and u in [j, j + 1).

    Attributes:
        width: columns of the image.
        height: rows of the image.
        fx, fy, cx, cy: focal lengths and principal point in pixels.
        position_m: (3,) optical center in the world frame.
        world_from_camera_rotation: (3, 3); columns are the camera's x (right), y (down), z (forward) in world axes.

    Raises:
        SettingsError: a size or focal length is not positive, or the matrix is not a rotation.
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
            if not (type(getattr(self, name)) is int and getattr(self, name) > 0):
                raise SettingsError(f"{name} must be a positive number of pixels, got {getattr(self, name)!r}")
        for name in ("fx", "fy", "cx", "cy"):
            if not abs(getattr(self, name)) <= MOST_PIXELS:
                raise SettingsError(
                    f"{name} must be finite and at most {MOST_PIXELS:g} pixels, got {getattr(self, name)!r}"
                )
        if self.fx <= 0 or self.fy <= 0:
            raise SettingsError(f"focal lengths must be positive, got fx {self.fx}, fy {self.fy}")
        for name, shape in (("position_m", (3,)), ("world_from_camera_rotation", (3, 3))):
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
        """Camera from the ``camera`` object of a ``scene.json``.

        Raises:
            SettingsError: a field is missing, unknown or outside its domain.
        """
        fields = [field.name for field in dataclasses.fields(cls)]
        if not isinstance(value, Mapping) or set(value) != set(fields):
            found = sorted(value) if isinstance(value, Mapping) else type(value).__name__
            raise SettingsError(f"camera needs exactly the fields {fields}, got {found}")
        try:
            if any(isinstance(value[name], bool) for name in ("fx", "fy", "cx", "cy")):
                raise TypeError("true or false")
            numbers: dict[str, Any] = {name: float(value[name]) for name in ("fx", "fy", "cx", "cy")}
            arrays: dict[str, Any] = {
                name: np.asarray(value[name], dtype=np.float64) for name in ("position_m", "world_from_camera_rotation")
            }
        except (TypeError, ValueError) as error:
            raise SettingsError(f"camera must hold numbers, in pixels and meters ({error})") from error
        return cls(width=value["width"], height=value["height"], **numbers, **arrays)

    def project(self, points_m: Array) -> tuple[Array, Array]:
        """Pixel coordinates (N, 2) as (u, v) and depth (N,) along the optical axis of world points (N, 3).

        Points that are not in front of the camera have depth <= 0 and pixel coordinates NaN.
        """
        local = (np.asarray(points_m, dtype=np.float64) - self.position_m) @ self.world_from_camera_rotation
        depth_m = local[:, 2]
        uv = np.full((len(local), 2), np.nan)
        front = depth_m > 0
        uv[front] = local[front, :2] / depth_m[front, None] * (self.fx, self.fy) + (self.cx, self.cy)
        return uv, depth_m

    def pixel_to_plane(self, uv: Array, z_m: float) -> Array:
        """World points (N, 3) where the rays through pixel coordinates (N, 2) meet the plane z = ``z_m``.

        Raises:
            SettingsError: a ray does not meet the plane in front of the camera.
        """
        uv = np.asarray(uv, dtype=np.float64)
        local = np.column_stack([(uv - (self.cx, self.cy)) / (self.fx, self.fy), np.ones(len(uv))])
        rays = local @ self.world_from_camera_rotation.T
        with np.errstate(divide="ignore", invalid="ignore"):
            reach = (z_m - self.position_m[2]) / rays[:, 2]
        if not (np.isfinite(reach) & (reach > 0)).all():
            raise SettingsError(
                f"the camera's rays do not all meet the plane z = {z_m} m; the whole image must show the table"
            )
        return np.asarray(self.position_m + rays * reach[:, None])
