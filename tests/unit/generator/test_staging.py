"""Recipes and stages without a renderer: contact, mirrored hands, cameras, independent random streams."""

import dataclasses
import json

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial import cKDTree

from deltasafe.errors import SettingsError
from deltasafe.io.storage import digest_of
from generator import (
    TEST_LIKE,
    TRAIN_LIKE,
    CollisionArrays,
    HandSetSettings,
    SceneSettings,
    draw_hand,
    draw_scene,
    scenes,
)
from generator.accessories import ring_shell, strap_shell
from generator.clutter import scatter_clutter
from generator.recipe import InAir, OnTable
from generator.scenes import free_place, hand_height_m, plan_scene
from generator.stage import camera_looking_at
from generator.staging import place_hand, view_of
from tests.unit.generator.test_surface_mesh import is_watertight, volume

NOTHING = CollisionArrays()
COORDINATES = st.tuples(*[st.floats(-1, 1)] * 3)


def recipes(settings, count):
    return [draw_hand(settings, NOTHING, index) for index in range(count)]


def test_a_recipe_is_a_function_of_settings_and_index_and_has_a_json_form():
    one, same, other = (
        draw_hand(TEST_LIKE, NOTHING, 5),
        draw_hand(TEST_LIKE, NOTHING, 5),
        draw_hand(TEST_LIKE, NOTHING, 6),
    )
    assert one == same
    assert digest_of(one) != digest_of(other)
    assert json.loads(json.dumps(dataclasses.asdict(one)))["index"] == 5
    assert draw_hand(dataclasses.replace(TEST_LIKE, seed=1), NOTHING, 5) != one


def test_a_change_of_one_part_leaves_the_others_as_they_were():
    dark = dataclasses.replace(TEST_LIKE, tones=(8.0, 9.0))
    for usual, changed in zip(recipes(TEST_LIKE, 8), recipes(dark, 8), strict=True):
        assert changed.person.skin.tone >= 8
        assert dataclasses.replace(changed, person=usual.person) == usual


def test_sets_are_what_they_are_called():
    plain, diverse = recipes(TRAIN_LIKE, 40), recipes(TEST_LIKE, 80)
    assert {recipe.place for recipe in plain} == {"above"}
    assert len({recipe.person.body for recipe in plain}) == 2
    assert {recipe.ground.surface for recipe in plain} == {"procedural/plain"}
    assert all(np.radians(72) <= recipe.view.elevation_rad <= np.radians(90) for recipe in plain)
    assert {recipe.place for recipe in diverse} == {"above", "desk", "room", "wall"}
    tones = np.array([recipe.person.skin.tone for recipe in diverse])
    assert (np.histogram(tones, bins=3, range=(0, 9))[0] > 10).all()
    assert any(recipe.worn.sleeve for recipe in diverse)
    assert any(recipe.worn.ring for recipe in diverse)
    assert any(recipe.held for recipe in diverse)
    for share in (np.mean([recipe.right_hand for recipe in some]) for some in (plain, diverse)):
        assert 0.2 < share < 0.8


@pytest.mark.parametrize("index", range(6))
def test_a_hand_on_a_table_touches_it(index):
    recipe = draw_hand(TRAIN_LIKE, NOTHING, index)
    vertices = place_hand(recipe).surface_m(levels=3)[0]
    assert isinstance(recipe.placement, OnTable)
    near = vertices[np.linalg.norm(vertices[:, :2], axis=1) < 0.15]
    assert -0.004 < near[:, 2].min() < 0.004
    assert np.mean(near[:, 2] < 0) < 0.01


@pytest.mark.parametrize("right_hand", [False, True])
@pytest.mark.parametrize("palm_up", [False, True])
def test_the_mesh_is_watertight_and_not_inside_out(right_hand, palm_up):
    recipe = draw_hand(TRAIN_LIKE, NOTHING, 3)
    placement = dataclasses.replace(recipe.placement, palm_up=palm_up)
    hand = place_hand(dataclasses.replace(recipe, right_hand=right_hand, placement=placement))
    vertices, triangles = hand.mesh_m()
    assert vertices.dtype == np.float32
    assert triangles.dtype == np.int32
    assert is_watertight(triangles)
    assert 0.0008 < volume(vertices.astype(float), triangles) < 0.004
    thumb = hand.to_world(hand.skeleton.joints_m["finger-1-4"][None])[0]
    fingers = hand.turn @ np.array([1.0, 0, 0])
    side = np.cross(fingers, thumb - hand.offset_m)[2]
    assert (side > 0) == (right_hand != palm_up), "the thumb of a right hand, palm down, lies on its left"


def test_the_camera_looks_at_the_hand_which_fills_a_good_part_of_the_picture():
    for recipe in recipes(TEST_LIKE, 8):
        hand = place_hand(recipe)
        camera = view_of(recipe, hand, 384, 288)
        uv, depth_m = camera.project(hand.core_m)
        assert (depth_m > 0.1).all()
        inside = ((uv > 0) & (uv < (384, 288))).all(axis=1)
        assert inside.mean() > 0.6
        if isinstance(recipe.placement, InAir):
            assert hand.core_m.mean(axis=0) == pytest.approx([0, 0, 0], abs=1e-9)


@given(COORDINATES, COORDINATES, st.floats(20, 90))
def test_the_target_lies_in_the_middle_and_up_is_up(position, target, fov):
    position, target = np.add(position, (0, 0, 3)), np.array(target)
    camera = camera_looking_at(position, target, (0, 1, 0), fov, 64, 48)
    uv, depth_m = camera.project(np.stack([target, np.add(target, (0, 0.01, 0))]))
    assert uv[0] == pytest.approx([32, 24], abs=1e-6)
    assert depth_m[0] == pytest.approx(np.linalg.norm(target - position))
    assert uv[1, 1] < uv[0, 1]
    assert uv[1, 0] == pytest.approx(uv[0, 0], abs=0.5)


def test_rings_and_straps_lie_outside_of_the_skin_around_finger_and_wrist():
    hand = place_hand(draw_hand(TRAIN_LIKE, NOTHING, 0))
    skin = hand.arm.refine(hand.posed_m)
    for shell, outwards in ((ring_shell, 0.0012), (strap_shell, 0.0025)):
        points, quads = shell(hand.arm, hand.skeleton, hand.posed_m)
        assert quads.max() == len(points) - 1
        gap, _ = cKDTree(skin).query(points)
        assert gap == pytest.approx(outwards, abs=0.0012)


def test_clutter_keeps_away_from_the_hand():
    settings = dataclasses.replace(TEST_LIKE, places=("desk",), shares=(1.0,))
    found = 0
    for recipe in recipes(settings, 6):
        hand = place_hand(recipe)
        points = hand.surface_m(levels=1)[0]
        outline = points[:, :2]
        for shape in scatter_clutter(recipe.ground, NOTHING, points):
            centre = getattr(shape, "centre_m", None)
            if centre is not None:
                found += 1
                assert np.linalg.norm(outline - centre[:2], axis=1).min() > 0.055
    assert found > 3


def test_scenes_leave_room_for_start_and_goal_on_both_sides():
    settings = SceneSettings()
    for index in range(3):
        plan = plan_scene(settings, NOTHING, index)
        vertices = plan.hand.mesh_m()[0]
        for x_m, y_m in ((-0.15, plan.start_y_m), (0.15, plan.goal_y_m)):
            assert np.linalg.norm(vertices[:, :2] - (x_m, y_m), axis=1).min() >= 0.06
            uv, _ = plan.camera.project(np.array([[x_m, y_m, 0.03]]))
            assert (uv > 0).all()
            assert (uv < (640, 480)).all()
        uv, depth_m = plan.camera.project(vertices.astype(float))
        seen = (depth_m > 0) & ((uv >= 0) & (uv <= (640, 480))).all(axis=1)
        assert 0 <= plan.hand_height_m - vertices[seen, 2].max() < 1.01e-4
        assert plan.hand_height_m == hand_height_m(plan.camera, vertices.astype(float))
        assert 0.03 < plan.hand_height_m < 0.15


def test_a_place_is_sought_nearest_to_the_middle():
    settings = SceneSettings()
    camera = camera_looking_at((0, 0, 0.5), (0, 0, 0), (0, 1, 0), 45.2, 640, 480)
    post = np.array([[0.15, 0.01, 0.02]])
    y_m = free_place(camera, post, 0.15, settings)
    assert y_m == pytest.approx(-0.05)
    assert free_place(camera, post, -0.15, settings) == 0
    wall = np.column_stack([np.full(200, 0.15), np.linspace(-0.5, 0.5, 200), np.zeros(200)])
    assert free_place(camera, wall, 0.15, settings) is None
    assert free_place(camera, post, 0.5, settings) is None, "not in view"


def test_impossible_scenes_are_refused_with_a_remedy(monkeypatch):
    monkeypatch.setattr(scenes, "ATTEMPTS", 2)
    with pytest.raises(SettingsError, match="lower clearance_m"):
        plan_scene(SceneSettings(clearance_m=0.5), NOTHING, 0)
    assert draw_scene(SceneSettings(), NOTHING, 0, 0) != draw_scene(SceneSettings(), NOTHING, 0, 1)


@pytest.mark.parametrize(
    "wrong",
    [
        {"seed": -1},
        {"width": 0},
        {"tones": (3.0, 2.0)},
        {"poses": ("wave",)},
        {"variant": "gpu"},
        {"places": ("moon",), "shares": (1.0,)},
        {"shares": (1.0,)},
        {"plain": True},
        {"elevation_deg": (80.0, 70.0)},
    ],
)
def test_bad_settings_are_refused(wrong):
    with pytest.raises(SettingsError):
        HandSetSettings(**wrong)
