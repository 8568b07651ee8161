"""What stands before the camera, as plain values: shapes, materials, lights. Metres, z up; colours are linear."""

import dataclasses
import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from deltasafe.scene import Camera
from generator.surface_mesh import unit

__all__ = [
    "Ball",
    "Box",
    "Cloth",
    "Cylinder",
    "Disk",
    "Environment",
    "Lamp",
    "Material",
    "Panel",
    "Shape",
    "SkinMesh",
    "Stage",
    "camera_looking_at",
]

Array = NDArray[np.float64]
Rgb = tuple[float, float, float]
Point = tuple[float, float, float]


@dataclasses.dataclass(frozen=True)
class Material:
    """A surface of one colour, or with a texture (H, W, 3) that repeats ``tiles`` times, turned and shifted."""

    colour: Rgb = (0.5, 0.5, 0.5)
    texture: Array | None = None
    tiles: float = 1.0
    turn_deg: float = 0.0
    shift: tuple[float, float] = (0.0, 0.0)
    roughness: float = 0.6
    specular: float = 0.3


@dataclasses.dataclass(frozen=True)
class SkinMesh:
    """Counts as hand: vertices (V, 3), faces (F, 4), albedo (V, 3), roughness (V,)."""

    vertices_m: Array
    quads: NDArray[np.int64]
    albedo: Array
    roughness: Array


@dataclasses.dataclass(frozen=True)
class Cloth:
    """A thin mesh that hides the hand: a sleeve."""

    vertices_m: Array
    quads: NDArray[np.int64]
    material: Material


@dataclasses.dataclass(frozen=True)
class Box:
    """Half sizes along its own axes, turned about the vertical."""

    centre_m: Point
    half_m: Point
    turn_deg: float
    material: Material


@dataclasses.dataclass(frozen=True)
class Cylinder:
    """Open at both ends."""

    start_m: Point
    end_m: Point
    radius_m: float
    material: Material


@dataclasses.dataclass(frozen=True)
class Disk:
    """Horizontal."""

    centre_m: Point
    radius_m: float
    material: Material


@dataclasses.dataclass(frozen=True)
class Ball:
    """A sphere."""

    centre_m: Point
    radius_m: float
    material: Material


@dataclasses.dataclass(frozen=True)
class Panel:
    """A square, horizontal, or upright and turned about the vertical."""

    centre_m: Point
    half_m: float
    upright: bool
    turn_deg: float
    material: Material


Shape = Box | Cylinder | Disk | Ball | Panel


@dataclasses.dataclass(frozen=True)
class Lamp:
    """A square that shines towards ``target_m``."""

    position_m: Point
    target_m: Point
    half_m: float
    radiance: Rgb


@dataclasses.dataclass(frozen=True)
class Environment:
    """Light from all around: (H, W, 3) radiance by latitude (row 0 is the zenith) and longitude."""

    radiance: NDArray[np.float32]
    turn_deg: float = 0.0


@dataclasses.dataclass(frozen=True)
class Stage:
    """All that a picture shows."""

    camera: Camera
    hand: tuple[SkinMesh, ...]
    cloths: tuple[Cloth, ...]
    shapes: tuple[Shape, ...]
    lamps: tuple[Lamp, ...]
    environment: Environment


def camera_looking_at(
    position_m: ArrayLike, target_m: ArrayLike, up: ArrayLike, horizontal_fov_deg: float, width: int, height: int
) -> Camera:
    """A pinhole camera with square pixels and its principal point in the middle."""
    position = np.asarray(position_m, dtype=float)
    forward = unit(np.asarray(target_m, dtype=float) - position)
    right = unit(np.cross(forward, np.asarray(up, dtype=float)))
    focal = width / 2 / math.tan(math.radians(horizontal_fov_deg) / 2)
    axes = np.stack([right, np.cross(forward, right), forward], axis=1)
    return Camera(width, height, focal, focal, width / 2, height / 2, position, axes)
