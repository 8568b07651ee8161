"""The recipe of a picture: all sampled parameters, as values that JSON can represent. Colors are linear RGB."""

import dataclasses

from generator.aliases import Point, Rgb
from generator.person import Person
from generator.pose import Pose
from generator.webcam import Webcam


@dataclasses.dataclass(frozen=True)
class TablePlacement:
    """A hand on or above the table; at yaw 0 the fingers point along x."""

    yaw_rad: float
    roll_rad: float = 0.0
    pitch_rad: float = 0.0
    palm_up: bool = False
    hover_m: float = 0.001
    offset_m: tuple[float, float] = (0.0, 0.0)


@dataclasses.dataclass(frozen=True)
class AirPlacement:
    """A raised hand with vertical fingers: sideways lean, rotation about the fingers, tilt towards the camera."""

    roll_rad: float
    yaw_rad: float
    pitch_rad: float


@dataclasses.dataclass(frozen=True)
class OrbitView:
    """A camera on a sphere around the hand.

    Attributes:
        magnification: diameter of the hand's bounding sphere divided by the image height at the hand.
        aim_m: offset of the aim point from the middle of the hand.
        roll_slope: x component of the up vector (roll_slope, 0, 1), for raised hands.
    """

    elevation_rad: float
    azimuth_rad: float
    magnification: float
    aim_m: Point
    roll_slope: float = 0.0
    horizontal_fov_deg: float = 48.0


@dataclasses.dataclass(frozen=True)
class OverheadView:
    """The camera of scenes, vertically above the middle of the table."""

    height_m: float = 0.5
    horizontal_fov_deg: float = 45.2


@dataclasses.dataclass(frozen=True)
class Sleeve:
    """A cloth sleeve that starts ``wrist_distance_m`` behind the wrist."""

    wrist_distance_m: float
    color: Rgb
    seed: int


@dataclasses.dataclass(frozen=True)
class Accessories:
    """Worn accessories. The mask includes watch strap and ring, but not the sleeve."""

    sleeve: Sleeve | None = None
    strap_color: Rgb | None = None
    ring: bool = False


@dataclasses.dataclass(frozen=True)
class Rod:
    """A rod held in the hand."""

    radius_m: float
    color: Rgb
    roughness: float


@dataclasses.dataclass(frozen=True)
class LampSettings:
    """A square lamp, ``offset_m`` from the middle of the hand."""

    offset_m: Point
    half_size_m: float
    radiance: Rgb


@dataclasses.dataclass(frozen=True)
class Lighting:
    """An environment map scaled to ``mean_radiance``, and a lamp; without a map, uniform light of ``color``."""

    map: str | None
    map_seed: int
    rotation_deg: float
    mean_radiance: float
    lamp: LampSettings
    color: Rgb = (1.0, 1.0, 1.0)


@dataclasses.dataclass(frozen=True)
class SurfaceTexture:
    """Texture and finish of a table or wall; ``repeats`` and ``uv_*`` transform the texture.

    Attributes:
        name: one of `Surroundings.surface_names`.
        color, seed: of a procedural texture.
    """

    name: str
    color: Rgb
    seed: int
    repeats: float
    uv_rotation_deg: float = 0.0
    uv_offset: tuple[float, float] = (0.0, 0.0)
    roughness: float = 0.55
    specular: float = 0.25


@dataclasses.dataclass(frozen=True)
class Table:
    """The table and the number of objects on it."""

    surface: SurfaceTexture
    clutter_count: int = 0
    clutter_seed: int = 0


@dataclasses.dataclass(frozen=True)
class Wall:
    """A wall behind a raised hand, rotated about the vertical."""

    surface: SurfaceTexture
    distance_m: float
    rotation_deg: float


@dataclasses.dataclass(frozen=True)
class Recipe:
    """All parameters of one picture.

    Attributes:
        seed, index: random seed of the set and index in the set.
        place: one of ``PLACES``, or "scene".
        right_hand: mirror the model, which is a left arm.
    """

    seed: int
    index: int
    place: str
    person: Person
    pose: Pose
    right_hand: bool
    placement: TablePlacement | AirPlacement
    view: OrbitView | OverheadView
    accessories: Accessories
    rod: Rod | None
    light: Lighting
    table: Table | None
    wall: Wall | None
    webcam: Webcam
