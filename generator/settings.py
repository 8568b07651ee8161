"""Settings of a set of hands or scenes."""

import dataclasses

from deltasafe.errors import SettingsError
from deltasafe.setting_ranges import check_choice, check_range
from generator.backend import VARIANTS
from generator.pose import POSES

TABLE_PLACES, AIR_PLACES = ("above", "desk"), ("room", "wall")
PLACES = TABLE_PLACES + AIR_PLACES
TABLE_POSES = ("flat", "together", "relaxed", "spread", "point", "fist", "pinch", "grip")


@dataclasses.dataclass(frozen=True)
class PictureSettings:
    """Settings that hands and scenes share.

    Attributes:
        seed: random seed of the set; picture i is a function of seed and i.
        width, height: pixels.
        samples_per_pixel: paths per pixel of the path tracer; 64 suffices because subsurface scattering removes noise.
        tones: range of skin tones, 0 (lightest) to 9 (darkest).
        poses: names out of ``POSES``; if empty, the default poses of each place.
        variant: variant of Mitsuba; ``scalar_rgb`` gives the same bytes on every run.

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
        check_range(self, "[0, inf)", "seed")
        check_range(self, "[1, inf)", "width", "height", "samples_per_pixel")
        if len(self.tones) != 2 or not 0 <= self.tones[0] <= self.tones[1] <= 9:
            raise SettingsError(f"tones must be a range within 0 and 9, got {self.tones}")
        if unknown := sorted(set(self.poses) - POSES.keys()):
            raise SettingsError(f"poses must be names out of {sorted(POSES)}, got {unknown}")
        check_choice(self, VARIANTS, "variant")


@dataclasses.dataclass(frozen=True)
class HandSetSettings(PictureSettings):
    """Settings of a set of labeled hands; see ``TRAIN_LIKE`` and ``TEST_LIKE``.

    Attributes:
        similar_people: use two similar light-skinned people instead of random people.
        places: where the hand is, out of ``PLACES``: on a desk seen from above ("above"), on a desk seen obliquely
            ("desk"), raised in a room or outdoors ("room"), raised in front of a wall ("wall").
        place_weights: relative frequency of each place.
        elevation_deg: range of the camera's elevation for the place "above".
        controlled_conditions: use two similar plain desks, one light and a good camera instead of random ones.
        accessories: add sleeves, watches, rings and held objects.
    """

    similar_people: bool = False
    places: tuple[str, ...] = PLACES
    place_weights: tuple[float, ...] = (0.2, 0.3, 0.27, 0.23)
    elevation_deg: tuple[float, float] = (72.0, 90.0)
    controlled_conditions: bool = False
    accessories: bool = True

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.places or set(self.places) - set(PLACES):
            raise SettingsError(f"places must be some of {PLACES}, got {self.places}")
        weights = self.place_weights
        if len(weights) != len(self.places) or min(weights) < 0 or sum(weights) <= 0:
            raise SettingsError(f"place_weights must be one number for each of {self.places}, got {weights}")
        if not 0 < self.elevation_deg[0] <= self.elevation_deg[1] <= 90:
            raise SettingsError(f"elevation_deg must be a range within 0 and 90, got {self.elevation_deg}")
        if self.controlled_conditions and set(self.places) - set(TABLE_PLACES):
            raise SettingsError(f"controlled_conditions needs places out of {TABLE_PLACES}, got {self.places}")

    def poses_at(self, place: str) -> tuple[str, ...]:
        """Return the names of the poses that may occur at a place."""
        return self.poses or (TABLE_POSES if place in TABLE_PLACES else tuple(POSES))


@dataclasses.dataclass(frozen=True)
class SceneSettings(PictureSettings):
    """Settings of scenes: a webcam above a table, the task, and the true mesh.

    Attributes:
        camera_height_m: height of the camera above the table.
        tool_x_m: the start is at x = -tool_x_m and the goal at x = +tool_x_m.
        tool_z_m: height of start and goal.
        clearance_m: minimum horizontal distance from start and goal to the hand.
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
        check_range(self, "(0, inf)", "camera_height_m", "tool_x_m", "tool_z_m", "clearance_m")
        if not self.poses:
            raise SettingsError("poses must name at least one pose for scenes")


TEST_LIKE = HandSetSettings()
TRAIN_LIKE = HandSetSettings(
    similar_people=True, places=("above",), place_weights=(1.0,), controlled_conditions=True, accessories=False
)
