"""Recipes and stages without a renderer: random streams, contact, mirrored hands, cameras, accessories, tasks."""

import dataclasses
import json

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial import cKDTree

from deltasafe.errors import SettingsError
from generator import (
    TEST_LIKE,
    TRAIN_LIKE,
    HandSetSettings,
    SceneSettings,
    Surroundings,
    sample_hand_recipe,
    sample_scene_recipe,
    scenes,
)
from generator.accessories import ring_mesh, strap_mesh
from generator.clutter import place_clutter
from generator.placement import place_hand
from generator.recipe import AirPlacement, TablePlacement
from generator.scenes import free_tool_y_m, plan_scene
from generator.stage import camera_looking_at
from generator.stage_building import build_camera
from tests.unit.generator.oracles import is_watertight, volume

PROCEDURAL = Surroundings()
COORDINATES = st.tuples(*[st.floats(-1, 1)] * 3)


def recipes(settings, count):
    return [sample_hand_recipe(settings, PROCEDURAL, index) for index in range(count)]


def test_recipe_depends_on_seed_and_index_and_is_json():
    one, same, other = (sample_hand_recipe(TEST_LIKE, PROCEDURAL, index) for index in (5, 5, 6))
    assert one == same
    assert dataclasses.replace(other, index=5) != one
    assert json.loads(json.dumps(dataclasses.asdict(one)))["index"] == 5
    reseeded = sample_hand_recipe(dataclasses.replace(TEST_LIKE, seed=1), PROCEDURAL, 5)
    assert dataclasses.replace(reseeded, seed=0) != one


def test_change_of_one_part_leaves_other_parts_unchanged():
    dark = dataclasses.replace(TEST_LIKE, tones=(8.0, 9.0))
    for usual, changed in zip(recipes(TEST_LIKE, 8), recipes(dark, 8), strict=True):
        assert changed.person.skin.tone >= 8
        assert dataclasses.replace(changed, person=usual.person) == usual


def test_train_like_is_controlled_and_test_like_is_diverse():
    controlled, diverse = recipes(TRAIN_LIKE, 40), recipes(TEST_LIKE, 80)
    assert {recipe.place for recipe in controlled} == {"above"}
    assert len({recipe.person.body for recipe in controlled}) == 2
    assert {recipe.table.surface.name for recipe in controlled} == {"procedural/plain"}
    assert all(np.radians(72) <= recipe.view.elevation_rad <= np.radians(90) for recipe in controlled)
    assert {recipe.place for recipe in diverse} == {"above", "desk", "room", "wall"}
    tones = np.array([recipe.person.skin.tone for recipe in diverse])
    assert (np.histogram(tones, bins=3, range=(0, 9))[0] > 10).all()
    assert any(recipe.accessories.sleeve for recipe in diverse)
    assert any(recipe.accessories.ring for recipe in diverse)
    assert any(recipe.rod for recipe in diverse)
    for some in (controlled, diverse):
        assert 0.2 < np.mean([recipe.right_hand for recipe in some]) < 0.8


@pytest.mark.parametrize("index", range(6))
def test_hand_on_table_touches_table(index):
    recipe = sample_hand_recipe(TRAIN_LIKE, PROCEDURAL, index)
    vertices = place_hand(recipe).surface_m(levels=3)[0]
    assert isinstance(recipe.placement, TablePlacement)
    near = vertices[np.linalg.norm(vertices[:, :2], axis=1) < 0.15]
    assert -0.004 < near[:, 2].min() < 0.004
    assert np.mean(near[:, 2] < 0) < 0.01


@pytest.mark.parametrize("right_hand", [False, True])
@pytest.mark.parametrize("palm_up", [False, True])
def test_mesh_is_watertight_with_outward_normals(right_hand, palm_up):
    recipe = sample_hand_recipe(TRAIN_LIKE, PROCEDURAL, 3)
    placement = dataclasses.replace(recipe.placement, palm_up=palm_up)
    hand = place_hand(dataclasses.replace(recipe, right_hand=right_hand, placement=placement))
    vertices, triangles = hand.mesh_m()
    assert vertices.dtype == np.float32
    assert triangles.dtype == np.int32
    assert is_watertight(triangles)
    assert 0.0008 < volume(vertices.astype(float), triangles) < 0.004
    thumb = hand.to_world(hand.skeleton.joints_m["finger-1-4"][None])[0]
    fingers = hand.rotation @ np.array([1.0, 0, 0])
    side = np.cross(fingers, thumb - hand.offset_m)[2]
    assert (side > 0) == (right_hand != palm_up), "the thumb of a right hand, palm down, is on its left"


def test_most_of_hand_is_in_view():
    for recipe in recipes(TEST_LIKE, 8):
        hand = place_hand(recipe)
        camera = build_camera(recipe, hand, 384, 288)
        uv, depth_m = camera.project(hand.hand_points_m)
        assert (depth_m > 0.1).all()
        inside = ((uv > 0) & (uv < (384, 288))).all(axis=1)
        assert inside.mean() > 0.6
        if isinstance(recipe.placement, AirPlacement):
            assert hand.hand_points_m.mean(axis=0) == pytest.approx([0, 0, 0], abs=1e-9)


@given(COORDINATES, COORDINATES, st.floats(20, 90))
def test_target_is_at_image_center_and_up_points_up(position, target, fov):
    position, target = np.add(position, (0, 0, 3)), np.array(target)
    camera = camera_looking_at(position, target, (0, 1, 0), fov, 64, 48)
    uv, depth_m = camera.project(np.stack([target, np.add(target, (0, 0.01, 0))]))
    assert uv[0] == pytest.approx([32, 24], abs=1e-6)
    assert depth_m[0] == pytest.approx(np.linalg.norm(target - position))
    assert uv[1, 1] < uv[0, 1]
    assert uv[1, 0] == pytest.approx(uv[0, 0], abs=0.5)


def test_ring_and_strap_are_offset_from_skin():
    hand = place_hand(sample_hand_recipe(TRAIN_LIKE, PROCEDURAL, 0))
    skin = cKDTree(hand.surface_m(levels=3)[0])
    for mesh, offset_m in ((ring_mesh(hand), 0.0012), (strap_mesh(hand, (0.0, 0.0, 0.0)), 0.0025)):
        assert mesh.quads.max() == len(mesh.vertices_m) - 1
        assert skin.query(mesh.vertices_m)[0] == pytest.approx(offset_m, abs=0.0012)


def test_clutter_keeps_distance_to_hand():
    settings = dataclasses.replace(TEST_LIKE, places=("desk",), place_weights=(1.0,))
    found = 0
    for recipe in recipes(settings, 6):
        hand = place_hand(recipe)
        points = hand.surface_m(levels=1)[0]
        outline = points[:, :2]
        for shape in place_clutter(recipe.table, PROCEDURAL, points):
            center = getattr(shape, "center_m", None)
            if center is not None:
                found += 1
                assert np.linalg.norm(outline - center[:2], axis=1).min() > 0.055
    assert found > 3


def test_scene_has_clear_visible_start_and_goal():
    settings = SceneSettings()
    for index in range(3):
        plan = plan_scene(settings, PROCEDURAL, index)
        vertices = plan.hand.mesh_m()[0]
        for x_m, y_m in ((-0.15, plan.start_y_m), (0.15, plan.goal_y_m)):
            assert np.linalg.norm(vertices[:, :2] - (x_m, y_m), axis=1).min() >= 0.06
            uv, _ = plan.camera.project(np.array([[x_m, y_m, 0.03]]))
            assert (uv > 0).all()
            assert (uv < (640, 480)).all()
        uv, depth_m = plan.camera.project(vertices.astype(float))
        seen = (depth_m > 0) & ((uv >= 0) & (uv <= (640, 480))).all(axis=1)
        assert 0 <= plan.hand_height_m - vertices[seen, 2].max() < 1.01e-4
        assert 0.03 < plan.hand_height_m < 0.15


def test_tool_position_is_the_free_one_nearest_to_axis():
    settings = SceneSettings()
    camera = camera_looking_at((0, 0, 0.5), (0, 0, 0), (0, 1, 0), 45.2, 640, 480)
    post = np.array([[0.15, 0.01, 0.02]])
    y_m = free_tool_y_m(camera, post, 0.15, settings)
    assert y_m == pytest.approx(-0.05)
    assert free_tool_y_m(camera, post, -0.15, settings) == 0
    wall = np.column_stack([np.full(200, 0.15), np.linspace(-0.5, 0.5, 200), np.zeros(200)])
    assert free_tool_y_m(camera, wall, 0.15, settings) is None
    assert free_tool_y_m(camera, post, 0.5, settings) is None, "out of view"


def test_impossible_scene_raises_error_with_remedy(monkeypatch):
    monkeypatch.setattr(scenes, "MAX_ATTEMPTS", 2)
    with pytest.raises(SettingsError, match="lower clearance_m"):
        plan_scene(SceneSettings(clearance_m=0.5), PROCEDURAL, 0)
    assert sample_scene_recipe(SceneSettings(), PROCEDURAL, 0, 0) != sample_scene_recipe(
        SceneSettings(), PROCEDURAL, 0, 1
    )


@pytest.mark.parametrize(
    "changes",
    [
        {"seed": -1},
        {"width": 0},
        {"tones": (3.0, 2.0)},
        {"poses": ("wave",)},
        {"variant": "gpu"},
        {"places": ("moon",), "place_weights": (1.0,)},
        {"place_weights": (1.0,)},
        {"controlled_conditions": True},
        {"elevation_deg": (80.0, 70.0)},
    ],
)
def test_invalid_settings_raise_settings_error(changes):
    with pytest.raises(SettingsError):
        HandSetSettings(**changes)
