"""A picture in words and numbers, all that was drawn at random, in JSON-friendly values."""

import dataclasses

from generator.person import Person
from generator.pose import Pose
from generator.webcam import Webcam

__all__ = [
    "Ground",
    "Held",
    "InAir",
    "LampPlace",
    "Light",
    "OnTable",
    "Orbit",
    "Overhead",
    "Recipe",
    "Sleeve",
    "Wall",
    "Worn",
]

Rgb = tuple[float, float, float]


@dataclasses.dataclass(frozen=True)
class OnTable:
    """The hand lies on the table, or hovers: turned about the vertical by ``yaw_rad`` (0: fingers along x)."""

    yaw_rad: float
    roll_rad: float = 0.0
    pitch_rad: float = 0.0
    palm_up: bool = False
    hover_m: float = 0.001
    offset_m: tuple[float, float] = (0.0, 0.0)


@dataclasses.dataclass(frozen=True)
class InAir:
    """The hand is held up: leaning sideways, turned about its axis, tilted towards the camera."""

    lean_rad: float
    facing_rad: float
    tilt_rad: float


@dataclasses.dataclass(frozen=True)
class Orbit:
    """A camera around the hand, so far away that the hand fills the picture's height ``fill`` times."""

    elevation_rad: float
    azimuth_rad: float
    fill: float
    aim_m: tuple[float, float, float]
    roll: float = 0.0
    horizontal_fov_deg: float = 48.0


@dataclasses.dataclass(frozen=True)
class Overhead:
    """The camera of the scenes: straight above the middle of the table."""

    height_m: float = 0.5
    horizontal_fov_deg: float = 45.2


@dataclasses.dataclass(frozen=True)
class Sleeve:
    """Cloth that begins ``starts_m`` behind the wrist; colour linear."""

    starts_m: float
    colour: Rgb
    seed: int


@dataclasses.dataclass(frozen=True)
class Worn:
    """What the hand wears. Straps and rings count as hand, sleeves do not."""

    sleeve: Sleeve | None = None
    strap: Rgb | None = None
    ring: bool = False


@dataclasses.dataclass(frozen=True)
class Held:
    """A rod in the hand."""

    radius_m: float
    colour: Rgb
    roughness: float


@dataclasses.dataclass(frozen=True)
class LampPlace:
    """A square lamp at ``offset_m`` from the hand's middle."""

    offset_m: tuple[float, float, float]
    half_m: float
    radiance: Rgb


@dataclasses.dataclass(frozen=True)
class Light:
    """An environment map scaled to a mean radiance of ``level`` (None: even light of ``colour``), and a lamp."""

    map: str | None
    map_seed: int
    turn_deg: float
    level: float
    lamp: LampPlace
    colour: Rgb = (1.0, 1.0, 1.0)


@dataclasses.dataclass(frozen=True)
class Ground:
    """The table: its surface, and how many things lie about."""

    surface: str
    colour: Rgb
    seed: int
    repeats_per_m: float = 2.0
    turn_deg: float = 0.0
    shift: tuple[float, float] = (0.0, 0.0)
    roughness: float = 0.55
    specular: float = 0.25
    clutter: int = 0
    clutter_seed: int = 0


@dataclasses.dataclass(frozen=True)
class Wall:
    """A wall behind a hand in the air."""

    surface: str
    colour: Rgb
    seed: int
    distance_m: float
    turn_deg: float
    repeats: float
    pattern_turn_deg: float
    shift: tuple[float, float]


@dataclasses.dataclass(frozen=True)
class Recipe:
    """One picture.

    Attributes:
        seed, index: from which it was drawn.
        place: "above", "desk", "room", "wall" or "scene".
        right_hand: mirrored, the model is a left arm.
    """

    seed: int
    index: int
    place: str
    person: Person
    pose: Pose
    right_hand: bool
    placement: OnTable | InAir
    view: Orbit | Overhead
    worn: Worn
    held: Held | None
    light: Light
    ground: Ground | None
    wall: Wall | None
    webcam: Webcam
