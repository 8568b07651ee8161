"""From a recipe to a stage: the hand is shaped, posed, painted and placed, its surroundings are put up around it."""

import dataclasses
import math

import numpy as np
from numpy.typing import NDArray

from deltasafe.scene import Camera
from generator.accessories import ring_shell, sleeve_shell, strap_shell
from generator.arm import ArmModel
from generator.clutter import scatter_clutter
from generator.person import shaped_points_m
from generator.recipe import Ground, Held, InAir, Light, OnTable, Orbit, Overhead, Recipe, Wall
from generator.skeleton import Skeleton, rotation
from generator.skin import Regions, paint
from generator.skinning import posed_vertices_m
from generator.stage import (
    Cloth,
    Cylinder,
    Environment,
    Lamp,
    Material,
    Panel,
    Shape,
    SkinMesh,
    Stage,
    camera_looking_at,
)
from generator.surface_mesh import closed_triangles, vertex_normals
from generator.surroundings import CollisionArrays

__all__ = ["PlacedHand", "place_hand", "set_stage", "view_of"]

Array = NDArray[np.float64]
Quads = NDArray[np.int64]
X, Y, Z = np.eye(3)
UPRIGHT = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]])  # fingers up, back of the hand away
TABLE_SIDE_M = 3.0
BRIGHTEST = 20.0  # radiance above which a map's pixel is a lamp and does not count as its level
GOLD = (0.85, 0.62, 0.25)


@dataclasses.dataclass(frozen=True)
class PlacedHand:
    """A posed hand in the world.

    Attributes:
        arm, skeleton: model and bones of the person.
        posed_m: (V, 3) coarse mesh in the frame of the hand.
        turn: (3, 3) rotation from the frame of the hand, mirrored for a right hand.
        offset_m: (3,) position of the wrist.
        core: (N,) vertices of the fine mesh that are hand, not forearm.
    """

    arm: ArmModel
    skeleton: Skeleton
    posed_m: Array
    turn: Array
    offset_m: Array
    core: NDArray[np.bool_]

    def to_world(self, points_m: Array) -> Array:
        """Points (N, 3) from the frame of the hand to the world."""
        return np.asarray(points_m @ self.turn.T + self.offset_m)

    def facing(self, quads: Quads) -> Quads:
        """Faces whose normals point outwards in the world, too, if the hand is mirrored."""
        return quads[:, ::-1] if np.linalg.det(self.turn) < 0 else quads

    def surface_m(self, levels: int) -> tuple[Array, Quads]:
        """Vertices in the world and faces of the mesh refined ``levels`` times."""
        vertices = self.to_world(self.arm.refine(self.posed_m, levels))
        return vertices, self.facing(self.arm.refined_quads(levels))

    def mesh_m(self) -> tuple[NDArray[np.float32], NDArray[np.int32]]:
        """The watertight mesh that goes with a scene: vertices (V, 3) and triangles (F, 3) in the world."""
        vertices, triangles = closed_triangles(*self.surface_m(levels=1))
        return vertices.astype(np.float32), triangles.astype(np.int32)

    @property
    def core_m(self) -> Array:
        """(N, 3) points of the hand without the forearm."""
        return self.surface_m(levels=3)[0][self.core]


def place_hand(recipe: Recipe) -> PlacedHand:
    """The person's hand in its pose, at its place."""
    arm = ArmModel.load()
    skeleton = Skeleton.of(arm, shaped_points_m(arm, recipe.person.body))
    posed = posed_vertices_m(arm, skeleton, recipe.pose)
    rest_x = arm.refine(skeleton.vertices_m)[:, 0]
    mirror = np.diag([1.0, -1.0 if recipe.right_hand else 1.0, 1.0])
    hand = PlacedHand(arm, skeleton, posed, _turn(recipe.placement) @ mirror, np.zeros(3), rest_x > -0.06)
    points = hand.surface_m(levels=3)[0]
    middle = points[hand.core].mean(axis=0)
    if isinstance(recipe.placement, InAir):
        return dataclasses.replace(hand, offset_m=-middle)
    # the lowest 0.3 % of the skin may sink into the table, as soft skin does
    lowest = np.percentile(points[rest_x > -0.20, 2], 0.3)
    x, y = recipe.placement.offset_m
    return dataclasses.replace(
        hand, offset_m=np.array([x - middle[0], y - middle[1], recipe.placement.hover_m - lowest])
    )


def view_of(recipe: Recipe, hand: PlacedHand, width: int, height: int) -> Camera:
    """The camera of a recipe."""
    view = recipe.view
    if isinstance(view, Overhead):
        return camera_looking_at((0, 0, view.height_m), (0, 0, 0), (0, 1, 0), view.horizontal_fov_deg, width, height)
    points = hand.core_m
    middle = points.mean(axis=0)
    half_view = math.tan(math.radians(view.horizontal_fov_deg) / 2) * height / width
    distance = np.linalg.norm(points - middle, axis=1).max() / (view.fill * half_view)
    return _orbiting(view, middle + view.aim_m, distance, isinstance(recipe.placement, InAir), width, height)


def set_stage(recipe: Recipe, surroundings: CollisionArrays, hand: PlacedHand, width: int, height: int) -> Stage:
    """All that the picture shows.

    Raises:
        DataError: the recipe names surroundings that are not there.
    """
    middle = hand.core_m.mean(axis=0)
    shapes: list[Shape] = []
    if recipe.ground:
        shapes.append(_table(recipe.ground, surroundings))
        shapes.extend(scatter_clutter(recipe.ground, surroundings, hand.surface_m(levels=1)[0]))
    if recipe.wall:
        shapes.append(_wall(recipe.wall, surroundings))
    if recipe.held:
        shapes.append(_rod(recipe.held, hand))
    offset = np.array(recipe.light.lamp.offset_m)
    lamp = Lamp(
        tuple((middle + offset).tolist()), tuple(middle.tolist()), recipe.light.lamp.half_m, recipe.light.lamp.radiance
    )
    return Stage(
        camera=view_of(recipe, hand, width, height),
        hand=(_skin(recipe, hand), *_jewellery(recipe, hand)),
        cloths=_sleeves(recipe, hand),
        shapes=tuple(shapes),
        lamps=(lamp,),
        environment=_environment(recipe.light, surroundings),
    )


def _turn(placement: OnTable | InAir) -> Array:
    if isinstance(placement, InAir):
        lean, tilt = rotation(Y, placement.lean_rad), rotation(X, placement.tilt_rad)
        return lean @ tilt @ rotation(Z, placement.facing_rad) @ UPRIGHT
    roll = placement.roll_rad + (math.pi if placement.palm_up else 0.0)
    return rotation(Z, placement.yaw_rad) @ rotation(X, roll) @ rotation(Y, placement.pitch_rad)


def _orbiting(view: Orbit, target: Array, distance: float, in_air: bool, width: int, height: int) -> Camera:
    flat = np.array([math.cos(view.azimuth_rad), math.sin(view.azimuth_rad), 0])
    away = math.cos(view.elevation_rad) * flat + math.sin(view.elevation_rad) * Z
    up = np.array([view.roll, 0, 1]) if in_air else 0.3 * Z - flat
    return camera_looking_at(target + distance * away, target, up, view.horizontal_fov_deg, width, height)


def _skin(recipe: Recipe, hand: PlacedHand) -> SkinMesh:
    skin = paint(Regions.of(hand.arm, hand.skeleton), recipe.person.skin, recipe.pose)
    vertices, quads = hand.surface_m(levels=3)
    raised = vertices + vertex_normals(vertices, quads) * skin.relief_m[:, None]
    return SkinMesh(raised, quads, skin.albedo, skin.roughness)


def _jewellery(recipe: Recipe, hand: PlacedHand) -> tuple[SkinMesh, ...]:
    parts = []
    if recipe.worn.strap:
        parts.append((strap_shell(hand.arm, hand.skeleton, hand.posed_m), recipe.worn.strap, 0.35))
    if recipe.worn.ring:
        parts.append((ring_shell(hand.arm, hand.skeleton, hand.posed_m), GOLD, 0.22))
    return tuple(
        SkinMesh(
            hand.to_world(points), hand.facing(quads), np.tile(colour, (len(points), 1)), np.full(len(points), rough)
        )
        for (points, quads), colour, rough in parts
    )


def _sleeves(recipe: Recipe, hand: PlacedHand) -> tuple[Cloth, ...]:
    if recipe.worn.sleeve is None:
        return ()
    points, quads = sleeve_shell(hand.arm, hand.skeleton, hand.posed_m, recipe.worn.sleeve)
    cloth = Material(colour=recipe.worn.sleeve.colour, roughness=0.9, specular=0.1)
    return (Cloth(hand.to_world(points), hand.facing(quads), cloth),)


def _table(ground: Ground, surroundings: CollisionArrays) -> Panel:
    material = Material(
        texture=surroundings.surface(ground.surface, ground.colour, ground.seed),
        tiles=TABLE_SIDE_M * ground.repeats_per_m,
        turn_deg=ground.turn_deg,
        shift=ground.shift,
        roughness=ground.roughness,
        specular=ground.specular,
    )
    return Panel((0.0, 0.0, 0.0), TABLE_SIDE_M / 2, False, 0.0, material)


def _wall(wall: Wall, surroundings: CollisionArrays) -> Panel:
    material = Material(
        texture=surroundings.surface(wall.surface, wall.colour, wall.seed),
        tiles=wall.repeats,
        turn_deg=wall.pattern_turn_deg,
        shift=wall.shift,
        roughness=0.8,
        specular=0.1,
    )
    return Panel((0.0, wall.distance_m, 0.0), 1.2, True, wall.turn_deg, material)


def _rod(held: Held, hand: PlacedHand) -> Cylinder:
    depth = -0.026 - held.radius_m
    start, end = hand.to_world(np.array([[0.078, -0.09, depth], [0.078, 0.08, depth]])).tolist()
    material = Material(colour=held.colour, roughness=held.roughness, specular=0.5)
    return Cylinder(tuple(start), tuple(end), held.radius_m, material)


def _environment(light: Light, surroundings: CollisionArrays) -> Environment:
    if light.map is None:
        return Environment(np.full((4, 8, 3), np.array(light.colour) * light.level, dtype=np.float32))
    radiance = surroundings.map(light.map, light.map_seed)
    scale = light.level / float(np.minimum(radiance, BRIGHTEST).mean())
    return Environment(radiance * np.float32(scale), light.turn_deg)
