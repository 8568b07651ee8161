"""Random recipes. Each part has its own random stream, so that a change of one part leaves the others unchanged."""

import dataclasses

import numpy as np

from generator.aliases import Rgb
from generator.person import SIMILAR_PEOPLE, Person, sample_person
from generator.pose import Pose, sample_pose
from generator.recipe import (
    Accessories,
    AirPlacement,
    LampSettings,
    Lighting,
    OrbitView,
    OverheadView,
    Recipe,
    Rod,
    Sleeve,
    SurfaceTexture,
    Table,
    TablePlacement,
    Wall,
)
from generator.settings import AIR_PLACES, TABLE_PLACES, HandSetSettings, PictureSettings, SceneSettings
from generator.skin.palette import random_albedo
from generator.surface_mesh import normalized
from generator.surroundings import Surroundings
from generator.webcam import Webcam

# the position of a part is the last number of its stream's seed
PARTS = ("person", "pose", "placement", "view", "accessories", "light", "surface", "camera")
MAX_ALBEDO = 0.85
PLAIN_DESK_COLORS: tuple[Rgb, ...] = ((0.70, 0.70, 0.68), (0.68, 0.63, 0.56))
STRAP_COLORS: tuple[Rgb, ...] = ((0.02, 0.02, 0.02), (0.25, 0.12, 0.05), (0.4, 0.4, 0.42))
# half size in meters, radiance, color
LAMPS: dict[str, tuple[float, float, Rgb]] = {
    "soft": (0.45, 3.0, (1.0, 0.98, 0.95)),
    "key": (0.2, 16.0, (1.0, 0.95, 0.88)),
    "hard": (0.05, 330.0, (1.0, 0.97, 0.92)),
    "warm": (0.12, 45.0, (1.0, 0.72, 0.45)),
    "dim": (0.3, 2.0, (0.8, 0.9, 1.0)),
}


def sample_hand_recipe(settings: HandSetSettings, surroundings: Surroundings, index: int) -> Recipe:
    """Sample the recipe of picture ``index`` of a set of hands."""
    rng, controlled = _streams(settings, index), settings.controlled_conditions
    probabilities = np.array(settings.place_weights) / sum(settings.place_weights)
    place = str(rng["placement"].choice(settings.places, p=probabilities))
    on_table = place in TABLE_PLACES
    person = _similar_person(rng["person"]) if settings.similar_people else sample_person(rng["person"], settings.tones)
    pose = sample_pose(rng["pose"], settings.poses_at(place))
    palm_up = on_table and rng["pose"].random() < 0.3
    if on_table:
        extension = -rng["pose"].uniform(0, 8) if palm_up else rng["pose"].uniform(8, 20)
        pose = dataclasses.replace(pose, wrist_extension=float(np.radians(extension)))
        placement: TablePlacement | AirPlacement = _on_table(rng["placement"], palm_up, controlled)
    else:
        placement = _in_air(rng["placement"])
    return Recipe(
        seed=settings.seed,
        index=index,
        place=place,
        person=person,
        pose=pose,
        right_hand=bool(rng["placement"].random() < 0.5),
        placement=placement,
        view=_orbit_view(rng["view"], place, settings),
        accessories=_accessories(rng["accessories"]) if settings.accessories else Accessories(),
        rod=_rod(rng["accessories"], pose) if settings.accessories else None,
        light=_controlled_light(rng["light"]) if controlled else _random_light(rng["light"], surroundings, place),
        table=_table(rng["surface"], surroundings, controlled, max_clutter=8) if on_table else None,
        wall=_wall(rng["surface"], surroundings) if place == "wall" else None,
        webcam=_good_webcam(rng["camera"]) if controlled else _random_webcam(rng["camera"]),
    )


def sample_scene_recipe(settings: SceneSettings, surroundings: Surroundings, index: int, attempt: int = 0) -> Recipe:
    """Sample the recipe of scene ``index``; each ``attempt`` gives another recipe."""
    rng = _streams(settings, index, attempt)
    pose = sample_pose(rng["pose"], settings.poses)
    pose = dataclasses.replace(pose, wrist_extension=float(np.radians(rng["pose"].uniform(4, 8))))
    offset = rng["placement"].uniform([-0.06, -0.07], [0.06, 0.0])
    placement = _on_table(rng["placement"], palm_up=False, controlled_conditions=True)
    return Recipe(
        seed=settings.seed,
        index=index,
        place="scene",
        person=sample_person(rng["person"], settings.tones),
        pose=pose,
        right_hand=bool(rng["placement"].random() < 0.5),
        placement=dataclasses.replace(placement, offset_m=tuple(offset.tolist())),
        view=OverheadView(height_m=settings.camera_height_m),
        accessories=Accessories(),
        rod=None,
        light=_random_light(rng["light"], surroundings, "scene"),
        table=_table(rng["surface"], surroundings, controlled_conditions=False, max_clutter=2),
        wall=None,
        webcam=_random_webcam(rng["camera"]),
    )


def _streams(settings: PictureSettings, index: int, attempt: int = 0) -> dict[str, np.random.Generator]:
    return {part: np.random.default_rng([settings.seed, index, attempt, i]) for i, part in enumerate(PARTS)}


def _similar_person(rng: np.random.Generator) -> Person:
    person = SIMILAR_PEOPLE[int(rng.random() < 0.4)]
    return dataclasses.replace(person, skin=dataclasses.replace(person.skin, seed=int(rng.integers(1 << 20))))


def _on_table(rng: np.random.Generator, palm_up: bool, controlled_conditions: bool) -> TablePlacement:
    yaw_deg = rng.normal(90, 35) if controlled_conditions else rng.uniform(0, 360)
    hovers = not controlled_conditions and rng.random() >= 0.6
    return TablePlacement(
        yaw_rad=float(np.radians(yaw_deg)),
        roll_rad=float(np.radians(rng.normal(0, 6))),
        pitch_rad=float(np.radians(rng.normal(0, 4))),
        palm_up=bool(palm_up),
        hover_m=float(rng.uniform(0.01, 0.08)) if hovers else 0.001,
    )


def _in_air(rng: np.random.Generator) -> AirPlacement:
    roll, yaw, pitch = np.radians(rng.normal(0, [40, 35, 25]))
    return AirPlacement(float(roll), float(yaw + np.pi * (rng.random() < 0.5)), float(pitch))


def _orbit_view(rng: np.random.Generator, place: str, settings: HandSetSettings) -> OrbitView:
    magnification, aim = float(rng.uniform(1.25, 2.0)), rng.normal(0, 0.014, 3)
    if place in AIR_PLACES:
        elevation, azimuth, roll_slope = rng.normal(0, 12), -90.0, np.radians(rng.normal(0, 6))
    else:
        elevation = rng.uniform(*(settings.elevation_deg if place == "above" else (38, 75)))
        azimuth = rng.normal(-90, 8) if settings.controlled_conditions else rng.uniform(0, 360)
        roll_slope, aim[2] = 0.0, 0.0
    return OrbitView(
        elevation_rad=float(np.radians(elevation)),
        azimuth_rad=float(np.radians(azimuth)),
        magnification=magnification,
        aim_m=tuple(aim.tolist()),
        roll_slope=float(roll_slope),
    )


def _accessories(rng: np.random.Generator) -> Accessories:
    sleeve = Sleeve(float(rng.uniform(0.005, 0.11)), random_albedo(rng, MAX_ALBEDO), int(rng.integers(1 << 20)))
    strap_color = STRAP_COLORS[rng.integers(len(STRAP_COLORS))]
    return Accessories(
        sleeve=sleeve if rng.random() < 0.5 else None,
        strap_color=strap_color if rng.random() < 0.15 else None,
        ring=bool(rng.random() < 0.2),
    )


def _rod(rng: np.random.Generator, pose: Pose) -> Rod | None:
    mcp_deg, pip_deg, _ = np.degrees(pose.fingers[1])
    rod = Rod(float(rng.uniform(0.012, 0.024)), random_albedo(rng, MAX_ALBEDO), float(rng.uniform(0.1, 0.6)))
    fits_grip = 25 < mcp_deg < 62 and pip_deg < 62
    return rod if rng.random() < 0.35 and fits_grip else None


def _controlled_light(rng: np.random.Generator) -> Lighting:
    lamp = LampSettings((float(rng.normal(-0.5, 0.15)), float(rng.normal(0.4, 0.15)), 1.1), 0.28, (13.0, 12.5, 11.7))
    return Lighting(None, 0, 0.0, 0.42, lamp, (0.95, 1.0, 1.07))


def _random_light(rng: np.random.Generator, surroundings: Surroundings, place: str) -> Lighting:
    in_air = place in AIR_PLACES
    names = surroundings.visible_map_names if in_air else surroundings.map_names
    half_size_m, strength, color = LAMPS[str(rng.choice(list(LAMPS)))]
    direction = rng.normal(0, 1, 3)
    direction[2] = abs(direction[2]) + 0.8
    direction = 1.1 * normalized(direction)
    if in_air:
        direction[1] = -abs(direction[1])
    radiance = np.array(color) * strength * rng.uniform(0.5, 1.4)
    mean_radiance = 0.55 * (1.0 if in_air else 0.5) * rng.uniform(0.6, 1.5)
    lamp = LampSettings(tuple(direction.tolist()), half_size_m, tuple(radiance.tolist()))
    return Lighting(
        map=str(rng.choice(names)),
        map_seed=int(rng.integers(1 << 20)),
        rotation_deg=float(rng.uniform(0, 360)),
        mean_radiance=float(mean_radiance),
        lamp=lamp,
    )


def _table(
    rng: np.random.Generator, surroundings: Surroundings, controlled_conditions: bool, max_clutter: int
) -> Table:
    seed = int(rng.integers(1 << 20))
    if controlled_conditions:
        color = PLAIN_DESK_COLORS[int(rng.random() < 0.5)]
        return Table(SurfaceTexture("procedural/plain", color, seed, repeats=6.0))
    is_plain = rng.random() < 0.2
    surface = SurfaceTexture(
        name="procedural/plain" if is_plain else str(rng.choice(surroundings.surface_names)),
        color=random_albedo(rng, MAX_ALBEDO),
        seed=seed,
        repeats=3.0 * float(rng.uniform(1.2, 4.5)),
        uv_rotation_deg=float(rng.uniform(0, 360)),
        uv_offset=tuple(rng.random(2).tolist()),
        roughness=float(rng.uniform(0.35, 0.8)),
        specular=float(rng.uniform(0.1, 0.5)),
    )
    clutter_count = int(rng.integers(0, max_clutter + 1)) if rng.random() < 0.75 else 0
    return Table(surface, clutter_count, clutter_seed=int(rng.integers(1 << 20)))


def _wall(rng: np.random.Generator, surroundings: Surroundings) -> Wall:
    name, color = str(rng.choice(surroundings.surface_names)), random_albedo(rng, MAX_ALBEDO)
    seed, distance_m = int(rng.integers(1 << 20)), float(rng.uniform(0.08, 1.2))
    rotation_deg, repeats = float(rng.normal(0, 15)), float(rng.uniform(0.8, 3))
    uv_rotation_deg, uv_offset = float(rng.choice([0, 90, 180])), tuple(rng.random(2).tolist())
    surface = SurfaceTexture(name, color, seed, repeats, uv_rotation_deg, uv_offset, roughness=0.8, specular=0.1)
    return Wall(surface, distance_m, rotation_deg)


def _good_webcam(rng: np.random.Generator) -> Webcam:
    return Webcam(
        exposure_ev=float(rng.normal(0.62, 0.08)),
        white_balance=(1.02, 1.0, 0.98),
        noise=0.006,
        blur_px=0.5,
        jpeg_quality=90,
        seed=int(rng.integers(1 << 20)),
    )


def _random_webcam(rng: np.random.Generator) -> Webcam:
    return Webcam(
        exposure_ev=float(rng.normal(-0.05, 0.3)),
        white_balance=tuple(np.exp(rng.normal(0, 0.07, 3)).tolist()),
        noise=float(rng.choice([0.005, 0.009, 0.018])),
        blur_px=float(rng.uniform(0.35, 0.9)),
        motion_px=float((rng.random() < 0.12) * rng.uniform(2, 5)),
        motion_rad=float(rng.uniform(0, np.pi)),
        vignette=float(rng.uniform(0, 0.5)),
        contrast=float(rng.uniform(-0.1, 0.5)),
        sharpening=float(rng.uniform(0, 0.8)),
        jpeg_quality=int(rng.integers(72, 96)),
        seed=int(rng.integers(1 << 20)),
    )
