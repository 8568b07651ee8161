"""Sets and scenes on disk, with a fake renderer: format, resumption, registry, rejected settings, command line."""

import dataclasses
import subprocess
import sys
import types

import cv2
import numpy as np
import pytest

from deltasafe.errors import DataError
from deltasafe.io.storage import read_json
from deltasafe.perception.data.labeled_images import LabeledImageSet
from deltasafe.scene import load_scenes
from generator import (
    TEST_LIKE,
    TRAIN_LIKE,
    SceneSettings,
    Surroundings,
    hand_sets,
    make_hands,
    make_scenes,
    picture_folder,
    sample_hand_recipe,
    scenes,
    stage_building,
)
from generator.__main__ import main
from generator.arm import ArmModel
from generator.placement import place_hand
from generator.render import Picture
from generator.scenes import plan_scene
from generator.skin import PaintedSkin

SMALL = dataclasses.replace(TEST_LIKE, width=64, height=48, samples_per_pixel=1)
SMALL_SCENES = SceneSettings(width=64, height=48, samples_per_pixel=1)


class OutlineRenderer:
    """Fake renderer: covers the pixels of the projected vertices, and counts rendered pictures."""

    rendered = 0

    def __init__(self, variant="scalar_rgb"):
        pass

    def render(self, stage, samples, seed):
        type(self).rendered += 1
        coverage = np.zeros((stage.camera.height, stage.camera.width), dtype=np.uint8)
        uv, depth_m = stage.camera.project(stage.hand[0].vertices_m)
        inside = (depth_m > 0) & ((uv >= 0) & (uv < (stage.camera.width, stage.camera.height))).all(axis=1)
        column, row = uv[inside].astype(int).T
        coverage[row, column] = 1
        coverage = cv2.morphologyEx(coverage, cv2.MORPH_CLOSE, np.ones((3, 3), np.uint8)).astype(float)
        noise = np.random.default_rng(seed).uniform(0.1, 0.2, (*coverage.shape, 3))
        return Picture(noise + 0.5 * coverage[..., None], coverage)


@pytest.fixture(autouse=True)
def fake_renderer(monkeypatch):
    OutlineRenderer.rendered = 0
    for module in (hand_sets, scenes):
        monkeypatch.setattr(module, "Renderer", OutlineRenderer)
    n_vertices = ArmModel.load().refinements[-1].matrix.shape[0]
    bare = PaintedSkin(np.zeros((n_vertices, 3)), np.zeros(n_vertices), np.zeros(n_vertices))
    monkeypatch.setattr(stage_building, "Regions", types.SimpleNamespace(from_skeleton=lambda arm, skeleton: None))
    monkeypatch.setattr(stage_building, "paint_skin", lambda regions, skin, pose: bare)


def contents(folder):
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def test_resumed_and_extended_set_equals_set_made_in_one_run(tmp_path):
    whole, parts = tmp_path / "whole", tmp_path / "parts"
    make_hands(whole, 3, SMALL)
    hands = LabeledImageSet.load(whole, whole / "registry.sha256")
    assert [item.id for item in hands.items] == ["hand_0000", "hand_0001", "hand_0002"]
    assert hands.read(0)[0].shape == (48, 64, 3)

    make_hands(parts, 2, SMALL)
    (parts / "recipes" / "hand_0001.json").unlink()  # as after an interruption during the second picture
    (parts / "images" / "hand_0001.jpg").write_bytes(b"half")
    OutlineRenderer.rendered = 0
    make_hands(parts, 3, SMALL)
    assert OutlineRenderer.rendered == 2
    one, other = contents(whole), contents(parts)
    for files in (one, other):
        files.pop("README.md")  # contains the folder's name
    assert one == other


def test_mask_is_hand_where_at_least_half_is_covered():
    coverage = np.array([[0.0, 0.49, 0.5, 1.0]])
    renderer = types.SimpleNamespace(render=lambda stage, samples, seed: Picture(np.ones((1, 4, 3)), coverage))
    recipe = sample_hand_recipe(SMALL, Surroundings(), 0)
    hand = place_hand(recipe)
    _, mask = picture_folder.render_image_and_mask(renderer, recipe, hand, Surroundings(), SMALL)
    assert cv2.imdecode(np.frombuffer(mask, np.uint8), cv2.IMREAD_UNCHANGED).tolist() == [[0, 0, 255, 255]]


def test_other_settings_or_surroundings_raise_before_any_output(tmp_path):
    make_hands(tmp_path / "set", 1, SMALL)
    before = contents(tmp_path / "set")
    with pytest.raises(DataError, match="settings"):
        make_hands(tmp_path / "set", 2, dataclasses.replace(SMALL, seed=1))
    (tmp_path / "surfaces").mkdir()
    (tmp_path / "surfaces" / "oak.png").write_bytes(b"")
    with pytest.raises(DataError, match="surroundings"):
        make_hands(tmp_path / "set", 2, SMALL, Surroundings.find(tmp_path))
    assert contents(tmp_path / "set") == before
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "thesis.tex").touch()
    with pytest.raises(DataError, match="not empty"):
        make_hands(tmp_path / "mine", 1, SMALL)


def test_datasheet_counts_pictures_and_names_sources(tmp_path):
    make_hands(tmp_path / "set", 2, dataclasses.replace(TRAIN_LIKE, width=64, height=48))
    text = (tmp_path / "set" / "README.md").read_text()
    assert "2 pairs" in text
    assert "| place | above: 2 |" in text
    assert "light: 2" in text
    assert "MakeHuman" in text
    assert "CC0 1.0" in text


def test_scenes_load_and_match_their_plan(tmp_path):
    reports = []
    make_scenes(tmp_path, 2, SMALL_SCENES, progress=lambda done, total, message: reports.append((done, total)))
    assert reports == [(0, 2), (1, 2), (2, 2)]
    for index, scene in enumerate(load_scenes(tmp_path)):
        plan = plan_scene(SMALL_SCENES, Surroundings(), index)
        assert scene.id == f"scene_{index:03d}"
        assert scene.hand_height_m == plan.hand_height_m
        assert (scene.start.x_m, scene.start.y_m, scene.start.z_m) == (-0.15, plan.start_y_m, 0.03)
        assert (scene.goal.x_m, scene.goal.y_m) == (0.15, plan.goal_y_m)
        assert np.array_equal(scene.true_mesh()[0], plan.hand.mesh_m()[0])
        assert np.allclose(scene.camera.position_m, (0, 0, 0.5))
        assert read_json(scene.image_path.parent / "recipe.json")["index"] == index
    before = contents(tmp_path)
    rendered = OutlineRenderer.rendered
    make_scenes(tmp_path, 2, SMALL_SCENES)
    assert OutlineRenderer.rendered == rendered
    assert contents(tmp_path) == before


def test_command_line_applies_options(tmp_path, capsys):
    small = ["--width", "64", "--height", "48", "--samples", "1", "--surroundings", str(tmp_path / "none")]
    out = tmp_path / "hands"
    options = ["--set", "train-like", "--tones", "8", "9", "--poses", "fist", "claw", "--places", "desk"]
    assert main(["hands", "--out", str(out), "--count", "1", *options, *small]) == 0
    settings = read_json(out / "settings.json")["settings"]
    assert settings["poses"] == ["fist", "claw"]
    assert settings["tones"] == [8.0, 9.0]
    assert read_json(out / "recipes" / "hand_0000.json")["place"] == "desk"
    assert "procedural" in capsys.readouterr().out
    assert main(["scenes", "--out", str(tmp_path / "scenes"), "--count", "1", "--camera-height", "0.6", *small]) == 0
    assert load_scenes(tmp_path / "scenes")[0].camera.position_m[2] == pytest.approx(0.6)
    assert main(["hands", "--out", str(out), "--count", "1", *small]) == 1
    assert "choose another folder" in capsys.readouterr().err


def test_import_does_not_load_mitsuba_torch_or_cv2():
    program = "import sys, generator; print('mitsuba' in sys.modules, 'torch' in sys.modules, 'cv2' in sys.modules)"
    run = subprocess.run([sys.executable, "-c", program], check=True, capture_output=True, text=True)
    assert run.stdout.split() == ["False", "False", "False"]
