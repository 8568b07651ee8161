"""What a set of pictures is to hold: how many, how diverse, whose hands, from where."""

import dataclasses

from deltasafe.errors import SettingsError
from generator.backend import VARIANTS
from generator.pose import POSES

__all__ = ["PLACES", "TEST_LIKE", "TRAIN_LIKE", "HandSetSettings", "PictureSettings", "SceneSettings"]

PLACES = ("above", "desk", "room", "wall")
LYING = ("flat", "together", "relaxed", "spread", "point", "fist", "pinch", "grip")
FREE = tuple(POSES)


@dataclasses.dataclass(frozen=True)
class PictureSettings:
    """What every picture needs.

    Attributes:
        seed: of the whole set; picture i is a function of seed and i.
        width, height: pixels.
        samples_per_pixel: paths of the path tracer; 64 is enough with the scattering that smooths skin.
        tones: range of skin tones, 0 (lightest) to 9 (darkest).
        poses: names out of ``POSES``; empty: those that suit the place.
        variant: of Mitsuba; ``scalar_rgb`` gives the same bytes on every run.

    Raises:
        SettingsError: a setting is outside its domain.
    """

    seed: int = 0
    width: int = 384
    height: int = 288
    samples_per_pixel: int = 64
    tones: tuple[float, float] = (0.0, 9.0)
    poses: tuple[str, ...] = ()
    variant: str = "scalar_rgb"

    def __post_init__(self) -> None:
        if self.seed < 0:
            raise SettingsError(f"seed must not be negative, got {self.seed}")
        for name in ("width", "height", "samples_per_pixel"):
            if getattr(self, name) < 1:
                raise SettingsError(f"{name} must be at least 1, got {getattr(self, name)}")
        if len(self.tones) != 2 or not 0 <= self.tones[0] <= self.tones[1] <= 9:
            raise SettingsError(f"tones must be a range within 0 and 9, got {self.tones}")
        if unknown := sorted(set(self.poses) - POSES.keys()):
            raise SettingsError(f"poses must be names out of {sorted(POSES)}, got {unknown}")
        if self.variant not in VARIANTS:
            raise SettingsError(f"variant must be one of {VARIANTS}, got {self.variant!r}")


@dataclasses.dataclass(frozen=True)
class HandSetSettings(PictureSettings):
    """A set of labelled pictures of hands; see ``TRAIN_LIKE`` and ``TEST_LIKE``.

    Attributes:
        two_alike: two similar light-skinned people instead of anyone.
        places: where hands are seen, out of ``PLACES``: from above on a desk, obliquely on a desk, held up in a room or
            in the open, held up before a wall.
        shares: share of each place.
        elevation_deg: range of the camera's elevation for pictures from above.
        plain: two nearly equal plain desks, one light and a good camera instead of everything that occurs.
        worn: sleeves, watches, rings and things held in the hand occur.
    """

    two_alike: bool = False
    places: tuple[str, ...] = PLACES
    shares: tuple[float, ...] = (0.2, 0.3, 0.27, 0.23)
    elevation_deg: tuple[float, float] = (72.0, 90.0)
    plain: bool = False
    worn: bool = True

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.places or set(self.places) - set(PLACES):
            raise SettingsError(f"places must be some of {PLACES}, got {self.places}")
        if len(self.shares) != len(self.places) or min(self.shares) < 0 or sum(self.shares) <= 0:
            raise SettingsError(f"shares must be one number for each of {self.places}, got {self.shares}")
        if not 0 < self.elevation_deg[0] <= self.elevation_deg[1] <= 90:
            raise SettingsError(f"elevation_deg must be a range within 0 and 90, got {self.elevation_deg}")
        if self.plain and set(self.places) - {"above", "desk"}:
            raise SettingsError(f"plain pictures need a desk: places 'above' or 'desk', got {self.places}")

    def poses_at(self, place: str) -> tuple[str, ...]:
        """Poses that occur at a place."""
        return self.poses or (LYING if place in ("above", "desk") else FREE)


@dataclasses.dataclass(frozen=True)
class SceneSettings(PictureSettings):
    """Scenes as a webcam above the table logs them, with the true mesh.

    Attributes:
        camera_height_m: above the table.
        tool_x_m: start and goal lie at -x and +x.
        tool_z_m: their height.
        clearance_m: smallest distance of start and goal to the hand, seen from above.
    """

    width: int = 640
    height: int = 480
    poses: tuple[str, ...] = ("flat", "together", "relaxed", "spread", "point", "fist", "vsign")
    camera_height_m: float = 0.5
    tool_x_m: float = 0.15
    tool_z_m: float = 0.03
    clearance_m: float = 0.06

    def __post_init__(self) -> None:
        super().__post_init__()
        for name in ("camera_height_m", "tool_x_m", "tool_z_m", "clearance_m"):
            if not getattr(self, name) > 0:
                raise SettingsError(f"{name} must be positive, got {getattr(self, name)}")
        if not self.poses:
            raise SettingsError("scenes need at least one pose")


TEST_LIKE = HandSetSettings()
TRAIN_LIKE = HandSetSettings(two_alike=True, places=("above",), shares=(1.0,), plain=True, worn=False)
