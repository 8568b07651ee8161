"""Sets and scenes on disk, with stand-ins for skin and path tracer: form, resumption, registry, refusals, commands."""

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
    CollisionArrays,
    SceneSettings,
    hand_sets,
    make_hands,
    make_scenes,
    scenes,
    staging,
)
from generator.__main__ import main
from generator.arm import ArmModel
from generator.render import Picture
from generator.scenes import plan_scene
from generator.skin import PaintedSkin

SMALL = dataclasses.replace(TEST_LIKE, width=64, height=48, samples_per_pixel=1)
SMALL_SCENES = SceneSettings(width=64, height=48, samples_per_pixel=1)


class OutlineRenderer:
    """Marks the pixels that the hand's vertices fall on, and counts its pictures."""

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
def no_path_tracer(monkeypatch):
    OutlineRenderer.rendered = 0
    for module in (hand_sets, scenes):
        monkeypatch.setattr(module, "Renderer", OutlineRenderer)
    n_vertices = ArmModel.load().refinements[-1].matrix.shape[0]
    bare = PaintedSkin(np.zeros((n_vertices, 3)), np.zeros(n_vertices), np.zeros(n_vertices))
    monkeypatch.setattr(staging, "Regions", types.SimpleNamespace(of=lambda arm, skeleton: None))
    monkeypatch.setattr(staging, "paint", lambda regions, skin, pose: bare)


def contents(folder):
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def test_a_set_is_read_by_the_project_and_grows_and_goes_on_without_change(tmp_path):
    whole, parts = tmp_path / "whole", tmp_path / "parts"
    make_hands(whole, 3, SMALL)
    hands = LabeledImageSet.load(whole, whole / "registry.sha256")
    assert [item.id for item in hands.items] == ["hand_0000", "hand_0001", "hand_0002"]
    assert hands.read(0)[0].shape == (48, 64, 3)

    make_hands(parts, 2, SMALL)
    (parts / "recipes" / "hand_0001.json").unlink()  # as if it had been killed while it wrote the second picture
    (parts / "images" / "hand_0001.jpg").write_bytes(b"half")
    OutlineRenderer.rendered = 0
    make_hands(parts, 3, SMALL)
    assert OutlineRenderer.rendered == 2
    same, other = contents(whole), contents(parts)
    for files in (same, other):
        files.pop("README.md")  # names the folder
    assert same == other


def test_other_settings_or_surroundings_are_refused_before_anything_is_written(tmp_path):
    make_hands(tmp_path / "set", 1, SMALL)
    before = contents(tmp_path / "set")
    with pytest.raises(DataError, match="settings"):
        make_hands(tmp_path / "set", 2, dataclasses.replace(SMALL, seed=1))
    (tmp_path / "surfaces").mkdir()
    (tmp_path / "surfaces" / "oak.png").write_bytes(b"")
    with pytest.raises(DataError, match="surroundings"):
        make_hands(tmp_path / "set", 2, SMALL, CollisionArrays.find(tmp_path))
    assert contents(tmp_path / "set") == before
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "thesis.tex").touch()
    with pytest.raises(DataError, match="not empty"):
        make_hands(tmp_path / "mine", 1, SMALL)


def test_the_datasheet_counts_what_is_there_and_names_its_sources(tmp_path):
    make_hands(tmp_path / "set", 2, dataclasses.replace(TRAIN_LIKE, width=64, height=48))
    text = (tmp_path / "set" / "README.md").read_text()
    assert "2 pairs" in text
    assert "| place | above: 2 |" in text
    assert "light: 2" in text
    assert "MakeHuman" in text
    assert "CC0 1.0" in text


def test_scenes_are_read_by_the_project_and_agree_with_their_plan(tmp_path):
    said = []
    make_scenes(tmp_path, 2, SMALL_SCENES, progress=lambda done, total, message: said.append((done, total)))
    assert said == [(0, 2), (1, 2), (2, 2)]
    for index, scene in enumerate(load_scenes(tmp_path)):
        plan = plan_scene(SMALL_SCENES, CollisionArrays(), index)
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


def test_the_command_line_makes_what_it_is_told_to(tmp_path, capsys):
    small = ["--width", "64", "--height", "48", "--samples", "1", "--surroundings", str(tmp_path / "none")]
    out = tmp_path / "hands"
    told = ["--set", "train-like", "--tones", "8", "9", "--poses", "fist", "claw", "--places", "desk"]
    assert main(["hands", "--out", str(out), "--count", "1", *told, *small]) == 0
    settings = read_json(out / "settings.json")["settings"]
    assert settings["poses"] == ["fist", "claw"]
    assert settings["tones"] == [8.0, 9.0]
    assert read_json(out / "recipes" / "hand_0000.json")["place"] == "desk"
    assert "procedural" in capsys.readouterr().out
    assert main(["scenes", "--out", str(tmp_path / "scenes"), "--count", "1", "--camera-height", "0.6", *small]) == 0
    assert load_scenes(tmp_path / "scenes")[0].camera.position_m[2] == pytest.approx(0.6)
    assert main(["hands", "--out", str(out), "--count", "1", *small]) == 1
    assert "choose another folder" in capsys.readouterr().err


def test_the_mathematics_needs_no_renderer():
    program = "import sys, generator; print('mitsuba' in sys.modules, 'torch' in sys.modules, 'cv2' in sys.modules)"
    run = subprocess.run([sys.executable, "-c", program], check=True, capture_output=True, text=True)
    assert run.stdout.split() == ["False", "False", "False"]
