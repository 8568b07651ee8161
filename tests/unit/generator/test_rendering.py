"""Rendering of tiny pictures with Mitsuba; skipped if Mitsuba is not installed (``pip install --group generator``)."""

import dataclasses
import subprocess
import sys

import cv2
import numpy as np
import pytest

from deltasafe.errors import SettingsError
from deltasafe.scene import LoggedScene
from generator import TEST_LIKE, SceneSettings, Surroundings, make_hands, make_scenes, sample_hand_recipe
from generator.backend import load_mitsuba
from generator.placement import place_hand
from generator.render import Renderer
from generator.stage_building import build_stage
from tests.unit.generator.oracles import iou, silhouette

pytest.importorskip("mitsuba")
TINY = dataclasses.replace(TEST_LIKE, width=48, height=36, samples_per_pixel=2, seed=3)
SCENE = SceneSettings(width=160, height=120, samples_per_pixel=2, seed=1)


def test_same_seed_gives_same_bytes_in_another_process(tmp_path):
    make_hands(tmp_path / "here", 1, TINY)
    program = (
        "import dataclasses; from generator import TEST_LIKE, make_hands;"
        "s = dataclasses.replace(TEST_LIKE, width=48, height=36, samples_per_pixel=2, seed=3);"
        f"make_hands({str(tmp_path / 'there')!r}, 1, s)"
    )
    subprocess.run([sys.executable, "-c", program], check=True)
    for name in ("images/hand_0000.jpg", "masks/hand_0000.png", "recipes/hand_0000.json", "registry.sha256"):
        assert (tmp_path / "here" / name).read_bytes() == (tmp_path / "there" / name).read_bytes(), name


def test_scene_mask_height_and_task_match_true_mesh(tmp_path):
    make_scenes(tmp_path, 1, SCENE)
    scene = LoggedScene.load(tmp_path / "scene_000")
    vertices, triangles = scene.true_mesh()
    mask = cv2.imread(str(scene.mask_path), cv2.IMREAD_GRAYSCALE) > 0
    assert mask.shape == (120, 160)
    assert iou(mask, silhouette(scene.camera, vertices, triangles)) >= 0.95
    uv, depth_m = scene.camera.project(vertices.astype(float))
    visible = (depth_m > 0) & ((uv >= 0) & (uv <= (160, 120))).all(axis=1)
    assert scene.hand_height_m == pytest.approx(vertices[visible, 2].max(), abs=1.01e-4)
    for pose in (scene.start, scene.goal):
        assert np.hypot(vertices[:, 0] - pose.x_m, vertices[:, 1] - pose.y_m).min() >= SCENE.clearance_m
    assert scene.start.x_m < vertices[visible, 0].mean() < scene.goal.x_m


def test_coverage_matches_projected_hand():
    renderer = Renderer()
    for place, index in (("desk", 0), ("wall", 1)):
        settings = dataclasses.replace(TEST_LIKE, places=(place,), place_weights=(1.0,), accessories=False)
        recipe = sample_hand_recipe(settings, Surroundings(), index)
        hand = place_hand(recipe)
        stage = build_stage(recipe, Surroundings(), hand, 160, 120)
        coverage = renderer.coverage(stage, seed=0)
        assert coverage.min() >= 0
        assert coverage.max() <= 1 + 1e-6
        assert iou(coverage >= 0.5, silhouette(stage.camera, *hand.mesh_m())) >= 0.95


def test_unknown_variant_raises_settings_error():
    with pytest.raises(SettingsError, match="variant"):
        load_mitsuba("rgb")


def test_loading_without_variant_keeps_current_variant():
    import mitsuba

    load_mitsuba()
    before = mitsuba.variant()
    try:
        mitsuba.set_variant("scalar_spectral")
        assert load_mitsuba().variant() == "scalar_spectral"
        assert load_mitsuba("scalar_rgb").variant() == "scalar_rgb"
    finally:
        mitsuba.set_variant(before)
