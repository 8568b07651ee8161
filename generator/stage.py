"""The content of a picture as plain values: meshes, shapes, materials, lights, camera. Meters, z up, linear colors."""

import dataclasses
import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from deltasafe.scene import Camera
from generator.aliases import Array, Point, Quads, Rgb
from generator.surface_mesh import normalized


@dataclasses.dataclass(frozen=True)
class Material:
    """A surface of one color, or with a texture (H, W, 3) that is repeated, rotated and shifted."""

    color: Rgb = (0.5, 0.5, 0.5)
    texture: Array | None = None
    repeats: float = 1.0
    uv_rotation_deg: float = 0.0
    uv_offset: tuple[float, float] = (0.0, 0.0)
    roughness: float = 0.6
    specular: float = 0.3


@dataclasses.dataclass(frozen=True)
class SkinMesh:
    """A mesh that is part of the mask: vertices (V, 3), faces (F, 4), albedo (V, 3), roughness (V,)."""

    vertices_m: Array
    quads: Quads
    albedo: Array
    roughness: Array


@dataclasses.dataclass(frozen=True)
class ClothMesh:
    """A thin mesh that occludes the hand, such as a sleeve."""

    vertices_m: Array
    quads: Quads
    material: Material


@dataclasses.dataclass(frozen=True)
class Box:
    """A box, rotated about the vertical."""

    center_m: Point
    half_size_m: Point
    rotation_deg: float
    material: Material


@dataclasses.dataclass(frozen=True)
class Cylinder:
    """A cylinder without end caps."""

    start_m: Point
    end_m: Point
    radius_m: float
    material: Material


@dataclasses.dataclass(frozen=True)
class Disk:
    """A horizontal disk."""

    center_m: Point
    radius_m: float
    material: Material


@dataclasses.dataclass(frozen=True)
class Sphere:
    """A sphere."""

    center_m: Point
    radius_m: float
    material: Material


@dataclasses.dataclass(frozen=True)
class Panel:
    """A square, horizontal or vertical, rotated about the vertical."""

    center_m: Point
    half_size_m: float
    vertical: bool
    rotation_deg: float
    material: Material


Shape = Box | Cylinder | Disk | Sphere | Panel


@dataclasses.dataclass(frozen=True)
class Lamp:
    """A square area light that faces ``target_m``."""

    position_m: Point
    target_m: Point
    half_size_m: float
    radiance: Rgb


@dataclasses.dataclass(frozen=True)
class Environment:
    """An equirectangular environment map (H, W, 3) of radiance; row 0 is the zenith."""

    radiance: NDArray[np.float32]
    rotation_deg: float = 0.0


@dataclasses.dataclass(frozen=True)
class Stage:
    """Everything that a picture shows."""

    camera: Camera
    hand: tuple[SkinMesh, ...]
    sleeve: ClothMesh | None
    shapes: tuple[Shape, ...]
    lamp: Lamp
    environment: Environment


def camera_looking_at(
    position_m: ArrayLike, target_m: ArrayLike, up: ArrayLike, horizontal_fov_deg: float, width: int, height: int
) -> Camera:
    """Return a pinhole camera with square pixels and a centered principal point."""
    position = np.asarray(position_m, dtype=float)
    forward = normalized(np.asarray(target_m, dtype=float) - position)
    right = normalized(np.cross(forward, np.asarray(up, dtype=float)))
    focal = width / 2 / math.tan(math.radians(horizontal_fov_deg) / 2)
    axes = np.stack([right, np.cross(forward, right), forward], axis=1)
    return Camera(width, height, focal, focal, width / 2, height / 2, position, axes)
