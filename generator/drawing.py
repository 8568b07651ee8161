"""Recipes drawn at random. Each part has a random stream of its own: a change in one leaves the others as they were."""

import dataclasses

import numpy as np

from generator.person import ALIKE, Person, draw_person
from generator.pose import Pose, draw_pose
from generator.recipe import (
    Ground,
    Held,
    InAir,
    LampPlace,
    Light,
    OnTable,
    Orbit,
    Overhead,
    Recipe,
    Rgb,
    Sleeve,
    Wall,
    Worn,
)
from generator.settings import HandSetSettings, PictureSettings, SceneSettings
from generator.skin.palette import linear
from generator.surface_mesh import unit
from generator.surroundings import CollisionArrays
from generator.webcam import Webcam

__all__ = ["draw_hand", "draw_scene"]

PARTS = ("person", "pose", "placement", "view", "worn", "light", "ground", "camera")
PLAIN_DESKS: tuple[Rgb, ...] = ((0.70, 0.70, 0.68), (0.68, 0.63, 0.56))
# half size in metres, radiance and colour of the lamps
LAMPS: dict[str, tuple[float, float, Rgb]] = {
    "soft": (0.45, 3.0, (1.0, 0.98, 0.95)),
    "key": (0.2, 16.0, (1.0, 0.95, 0.88)),
    "hard": (0.05, 330.0, (1.0, 0.97, 0.92)),
    "warm": (0.12, 45.0, (1.0, 0.72, 0.45)),
    "dim": (0.3, 2.0, (0.8, 0.9, 1.0)),
}


def draw_hand(settings: HandSetSettings, surroundings: CollisionArrays, index: int) -> Recipe:
    """Recipe of picture ``index`` of a set of hands."""
    rng = _streams(settings, index)
    shares = np.array(settings.shares) / sum(settings.shares)
    place = str(rng["placement"].choice(settings.places, p=shares))
    on_table = place in ("above", "desk")
    person = _alike(rng["person"]) if settings.two_alike else draw_person(rng["person"], settings.tones)
    pose = draw_pose(rng["pose"], settings.poses_at(place))
    palm_up = on_table and rng["pose"].random() < 0.3
    if on_table:
        extension = -rng["pose"].uniform(0, 8) if palm_up else rng["pose"].uniform(8, 20)
        pose = dataclasses.replace(pose, wrist_extension=float(np.radians(extension)))
        placement: OnTable | InAir = _lying(rng["placement"], palm_up, settings.plain)
    else:
        placement = _held_up(rng["placement"])
    return Recipe(
        seed=settings.seed,
        index=index,
        place=place,
        person=person,
        pose=pose,
        right_hand=bool(rng["placement"].random() < 0.5),
        placement=placement,
        view=_orbit(rng["view"], place, settings),
        worn=_worn(rng["worn"]) if settings.worn else Worn(),
        held=_held(rng["worn"], pose) if settings.worn else None,
        light=_plain_light(rng["light"]) if settings.plain else _light(rng["light"], surroundings, place),
        ground=_ground(rng["ground"], surroundings, settings.plain, clutter=9) if on_table else None,
        wall=_wall(rng["ground"], surroundings) if place == "wall" else None,
        webcam=_good_camera(rng["camera"]) if settings.plain else _any_camera(rng["camera"]),
    )


def draw_scene(settings: SceneSettings, surroundings: CollisionArrays, index: int, attempt: int = 0) -> Recipe:
    """Recipe of scene ``index``; a scene without room for start and goal is drawn again as the next ``attempt``."""
    rng = _streams(settings, index, attempt)
    pose = draw_pose(rng["pose"], settings.poses)
    pose = dataclasses.replace(pose, wrist_extension=float(np.radians(rng["pose"].uniform(4, 8))))
    offset = rng["placement"].uniform([-0.06, -0.07], [0.06, 0.0])
    placement = dataclasses.replace(
        _lying(rng["placement"], palm_up=False, plain=True), offset_m=tuple(offset.tolist())
    )
    return Recipe(
        seed=settings.seed,
        index=index,
        place="scene",
        person=draw_person(rng["person"], settings.tones),
        pose=pose,
        right_hand=bool(rng["placement"].random() < 0.5),
        placement=placement,
        view=Overhead(height_m=settings.camera_height_m),
        worn=Worn(),
        held=None,
        light=_light(rng["light"], surroundings, "scene"),
        ground=_ground(rng["ground"], surroundings, plain=False, clutter=3),
        wall=None,
        webcam=_any_camera(rng["camera"]),
    )


def _streams(settings: PictureSettings, index: int, attempt: int = 0) -> dict[str, np.random.Generator]:
    return {part: np.random.default_rng([settings.seed, index, attempt, i]) for i, part in enumerate(PARTS)}


def _alike(rng: np.random.Generator) -> Person:
    person = ALIKE[int(rng.random() < 0.4)]
    return dataclasses.replace(person, skin=dataclasses.replace(person.skin, seed=int(rng.integers(1 << 20))))


def _lying(rng: np.random.Generator, palm_up: bool, plain: bool) -> OnTable:
    yaw_deg = rng.normal(90, 35) if plain else rng.uniform(0, 360)
    hovers = not plain and rng.random() >= 0.6
    return OnTable(
        yaw_rad=float(np.radians(yaw_deg)),
        roll_rad=float(np.radians(rng.normal(0, 6))),
        pitch_rad=float(np.radians(rng.normal(0, 4))),
        palm_up=bool(palm_up),
        hover_m=float(rng.uniform(0.01, 0.08)) if hovers else 0.001,
    )


def _held_up(rng: np.random.Generator) -> InAir:
    lean, turn, tilt = np.radians(rng.normal(0, [40, 35, 25]))
    return InAir(float(lean), float(turn + np.pi * (rng.random() < 0.5)), float(tilt))


def _orbit(rng: np.random.Generator, place: str, settings: HandSetSettings) -> Orbit:
    fill, aim = float(rng.uniform(1.25, 2.0)), rng.normal(0, 0.014, 3)
    if place in ("room", "wall"):
        elevation, azimuth, roll = rng.normal(0, 12), -90.0, np.radians(rng.normal(0, 6))
    else:
        elevation = rng.uniform(*(settings.elevation_deg if place == "above" else (38, 75)))
        azimuth = rng.normal(-90, 8) if settings.plain else rng.uniform(0, 360)
        roll, aim[2] = 0.0, 0.0
    return Orbit(
        elevation_rad=float(np.radians(elevation)),
        azimuth_rad=float(np.radians(azimuth)),
        fill=fill,
        aim_m=tuple(aim.tolist()),
        roll=float(roll),
    )


def _colour(rng: np.random.Generator) -> Rgb:
    red, green, blue = np.clip(linear(rng.integers(10, 250, 3)), 0.01, 0.85).tolist()
    return red, green, blue


def _worn(rng: np.random.Generator) -> Worn:
    sleeve = Sleeve(float(rng.uniform(0.005, 0.11)), _colour(rng), int(rng.integers(1 << 20)))
    straps: tuple[Rgb, ...] = ((0.02, 0.02, 0.02), (0.25, 0.12, 0.05), (0.4, 0.4, 0.42))
    strap = straps[rng.integers(len(straps))]
    return Worn(
        sleeve=sleeve if rng.random() < 0.5 else None,
        strap=strap if rng.random() < 0.15 else None,
        ring=bool(rng.random() < 0.2),
    )


def _held(rng: np.random.Generator, pose: Pose) -> Held | None:
    middle = np.degrees(pose.fingers[1])
    held = Held(float(rng.uniform(0.012, 0.024)), _colour(rng), float(rng.uniform(0.1, 0.6)))
    return held if rng.random() < 0.35 and 25 < middle[0] < 62 and middle[1] < 62 else None


def _plain_light(rng: np.random.Generator) -> Light:
    lamp = LampPlace((float(rng.normal(-0.5, 0.15)), float(rng.normal(0.4, 0.15)), 1.1), 0.28, (13.0, 12.5, 11.7))
    return Light(None, 0, 0.0, 0.42, lamp, (0.95, 1.0, 1.07))


def _light(rng: np.random.Generator, surroundings: CollisionArrays, place: str) -> Light:
    in_air = place in ("room", "wall")
    names = surroundings.unseen_map_names if in_air else surroundings.map_names
    half_m, strength, colour = LAMPS[str(rng.choice(list(LAMPS)))]
    direction = rng.normal(0, 1, 3)
    direction[2] = abs(direction[2]) + 0.8
    direction = 1.1 * unit(direction)
    if in_air:
        direction[1] = -abs(direction[1])
    radiance = np.array(colour) * strength * rng.uniform(0.5, 1.4)
    level = 0.55 * (1.0 if in_air else 0.5) * rng.uniform(0.6, 1.5)
    lamp = LampPlace(tuple(direction.tolist()), half_m, tuple(radiance.tolist()))
    return Light(str(rng.choice(names)), int(rng.integers(1 << 20)), float(rng.uniform(0, 360)), float(level), lamp)


def _ground(rng: np.random.Generator, surroundings: CollisionArrays, plain: bool, clutter: int) -> Ground:
    seed = int(rng.integers(1 << 20))
    if plain:
        return Ground("procedural/plain", PLAIN_DESKS[int(rng.random() < 0.5)], seed)
    bare = rng.random() < 0.2
    return Ground(
        surface="procedural/plain" if bare else str(rng.choice(surroundings.surface_names)),
        colour=_colour(rng),
        seed=seed,
        repeats_per_m=float(rng.uniform(1.2, 4.5)),
        turn_deg=float(rng.uniform(0, 360)),
        shift=tuple(rng.random(2).tolist()),
        roughness=float(rng.uniform(0.35, 0.8)),
        specular=float(rng.uniform(0.1, 0.5)),
        clutter=int(rng.integers(0, clutter)) if rng.random() < 0.75 else 0,
        clutter_seed=int(rng.integers(1 << 20)),
    )


def _wall(rng: np.random.Generator, surroundings: CollisionArrays) -> Wall:
    return Wall(
        surface=str(rng.choice(surroundings.surface_names)),
        colour=_colour(rng),
        seed=int(rng.integers(1 << 20)),
        distance_m=float(rng.uniform(0.08, 1.2)),
        turn_deg=float(rng.normal(0, 15)),
        repeats=float(rng.uniform(0.8, 3)),
        pattern_turn_deg=float(rng.choice([0, 90, 180])),
        shift=tuple(rng.random(2).tolist()),
    )


def _good_camera(rng: np.random.Generator) -> Webcam:
    return Webcam(
        exposure_ev=float(rng.normal(0.62, 0.08)),
        white_balance=(1.02, 1.0, 0.98),
        noise=0.006,
        blur_px=0.5,
        jpeg_quality=90,
        seed=int(rng.integers(1 << 20)),
    )


def _any_camera(rng: np.random.Generator) -> Webcam:
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
