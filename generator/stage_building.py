"""Build a stage from a recipe: camera, painted hand, accessories, surroundings and light."""

import math

import numpy as np

from deltasafe.scene import Camera
from generator.accessories import ring_mesh, sleeve_mesh, strap_mesh
from generator.clutter import place_clutter
from generator.placement import PlacedHand
from generator.recipe import AirPlacement, Lighting, OverheadView, Recipe, Rod, SurfaceTexture
from generator.skin import Regions, paint_skin
from generator.stage import Cylinder, Environment, Lamp, Material, Panel, Shape, SkinMesh, Stage, camera_looking_at
from generator.surface_mesh import vertex_normals
from generator.surroundings import Surroundings

UP = np.array([0.0, 0.0, 1.0])
TABLE_HALF_SIZE_M, WALL_HALF_SIZE_M = 1.5, 1.2
MAX_RADIANCE = 20.0  # clips lamps in an environment map when its mean is computed


def build_camera(recipe: Recipe, hand: PlacedHand, width: int, height: int) -> Camera:
    """Place the camera of a recipe."""
    view = recipe.view
    if isinstance(view, OverheadView):
        return camera_looking_at((0, 0, view.height_m), (0, 0, 0), (0, 1, 0), view.horizontal_fov_deg, width, height)
    points = hand.hand_points_m
    middle = points.mean(axis=0)
    tan_half_vertical_fov = math.tan(math.radians(view.horizontal_fov_deg) / 2) * height / width
    distance = np.linalg.norm(points - middle, axis=1).max() / (view.magnification * tan_half_vertical_fov)
    azimuth = np.array([math.cos(view.azimuth_rad), math.sin(view.azimuth_rad), 0])
    direction = math.cos(view.elevation_rad) * azimuth + math.sin(view.elevation_rad) * UP
    in_air = isinstance(recipe.placement, AirPlacement)
    up = np.array([view.roll_slope, 0, 1]) if in_air else 0.3 * UP - azimuth
    target = middle + view.aim_m
    return camera_looking_at(target + distance * direction, target, up, view.horizontal_fov_deg, width, height)


def build_stage(recipe: Recipe, surroundings: Surroundings, hand: PlacedHand, width: int, height: int) -> Stage:
    """Build everything that a picture of ``width`` x ``height`` pixels shows.

    Raises:
        DataError: the recipe names surroundings that do not exist.
    """
    shapes: list[Shape] = []
    if table := recipe.table:
        material = _textured(table.surface, surroundings)
        shapes.append(Panel((0.0, 0.0, 0.0), TABLE_HALF_SIZE_M, vertical=False, rotation_deg=0.0, material=material))
        shapes.extend(place_clutter(table, surroundings, hand.surface_m(levels=1)[0]))
    if wall := recipe.wall:
        center, material = (0.0, wall.distance_m, 0.0), _textured(wall.surface, surroundings)
        shapes.append(Panel(center, WALL_HALF_SIZE_M, vertical=True, rotation_deg=wall.rotation_deg, material=material))
    if recipe.rod:
        shapes.append(_rod_cylinder(recipe.rod, hand))
    worn, skin = recipe.accessories, [_skin_mesh(recipe, hand)]
    if worn.strap_color:
        skin.append(strap_mesh(hand, worn.strap_color))
    if worn.ring:
        skin.append(ring_mesh(hand))
    middle, lamp = hand.hand_points_m.mean(axis=0), recipe.light.lamp
    lamp_position = tuple((middle + np.array(lamp.offset_m)).tolist())
    return Stage(
        camera=build_camera(recipe, hand, width, height),
        hand=tuple(skin),
        sleeve=sleeve_mesh(hand, worn.sleeve) if worn.sleeve else None,
        shapes=tuple(shapes),
        lamp=Lamp(lamp_position, tuple(middle.tolist()), lamp.half_size_m, lamp.radiance),
        environment=_environment(recipe.light, surroundings),
    )


def _skin_mesh(recipe: Recipe, hand: PlacedHand) -> SkinMesh:
    skin = paint_skin(Regions.from_skeleton(hand.arm, hand.skeleton), recipe.person.skin, recipe.pose)
    vertices, quads = hand.surface_m(levels=3)
    displaced = vertices + vertex_normals(vertices, quads) * skin.relief_m[:, None]
    return SkinMesh(displaced, quads, skin.albedo, skin.roughness)


def _textured(surface: SurfaceTexture, surroundings: Surroundings) -> Material:
    return Material(
        texture=surroundings.load_surface(surface.name, surface.color, surface.seed),
        repeats=surface.repeats,
        uv_rotation_deg=surface.uv_rotation_deg,
        uv_offset=surface.uv_offset,
        roughness=surface.roughness,
        specular=surface.specular,
    )


def _rod_cylinder(rod: Rod, hand: PlacedHand) -> Cylinder:
    """Place the rod across the palm, in contact with it."""
    depth = -0.026 - rod.radius_m
    start, end = hand.to_world(np.array([[0.078, -0.09, depth], [0.078, 0.08, depth]])).tolist()
    material = Material(color=rod.color, roughness=rod.roughness, specular=0.5)
    return Cylinder(tuple(start), tuple(end), rod.radius_m, material)


def _environment(light: Lighting, surroundings: Surroundings) -> Environment:
    if light.map is None:
        uniform = np.full((4, 8, 3), np.array(light.color) * light.mean_radiance, dtype=np.float32)
        return Environment(uniform)
    radiance = surroundings.load_map(light.map, light.map_seed)
    scale = light.mean_radiance / float(np.minimum(radiance, MAX_RADIANCE).mean())
    return Environment(radiance * np.float32(scale), light.rotation_deg)
