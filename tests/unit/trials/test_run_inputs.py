"""All folders of a run are read before it starts, and all their defects are reported together."""

import pathlib
import shutil

import cv2
import numpy as np
import pytest

from deltasafe.trials.run_inputs import InputFolder, RunInputs
from tests.ensembles import write_hands

SCENES = pathlib.Path(__file__).parents[3] / "datasets" / "scenes"


@pytest.fixture
def folders(tmp_path):
    """A training set, a test set, backgrounds and a scene without any defect."""
    write_hands(tmp_path / "training", seed=0)
    write_hands(tmp_path / "test", seed=1)
    shutil.copytree(tmp_path / "test" / "images", tmp_path / "backgrounds")
    shutil.copytree(SCENES / "scene_000", tmp_path / "scenes" / "scene_000")
    return tmp_path


def inputs(folders, **options):
    names = ("training", "test", "backgrounds", "scenes")
    return RunInputs(**{name: InputFolder(folders / name) for name in names}, **options)


def test_intact_inputs_have_no_defects(folders):
    assert inputs(folders).defects() == []
    assert RunInputs().defects() == []


def test_all_defects_of_all_folders_are_listed_together(folders):
    two_values = np.repeat(np.uint8([0, 7, 255]), 16)[:, None] * np.ones((1, 64), np.uint8)
    cv2.imwrite(str(folders / "training" / "masks" / "0.png"), two_values)
    (folders / "training" / "images" / "1.png").write_bytes(b"not an image")
    (folders / "test" / "masks" / "3.png").unlink()
    (folders / "backgrounds" / "2.png").write_bytes(b"")
    (folders / "scenes" / "scene_000" / "scene.json").write_text("{}")
    defects = inputs(folders).defects()
    assert [defect.partition(":")[0] for defect in defects] == [
        "training images",
        "test images",
        "backgrounds",
        "scenes",
    ]
    assert "has 2 defects" in defects[0]
    assert str(folders / "training" / "masks" / "0.png") in defects[0]
    assert str(folders / "training" / "images" / "1.png") in defects[0]
    assert "no counterpart in masks/" in defects[1]


def test_images_in_two_sets_and_copies_within_one_are_defects(folders):
    shutil.copytree(folders / "training", folders / "calibration")
    for part in ("images", "masks"):
        shutil.copy(folders / "test" / part / "0.png", folders / "test" / part / "again.png")
    one, two = inputs(folders, calibration=InputFolder(folders / "calibration")).defects()
    assert "again.png: has the same pixels as 0.png of the same test set" in one
    assert two.startswith("calibration images: ")
    assert "has 4 defects" in two
    assert "of the training set" in two


def test_the_image_of_a_scene_is_compared_with_its_camera(folders):
    image = folders / "scenes" / "scene_000" / "image.jpg"
    cv2.imwrite(str(image), cv2.resize(cv2.imread(str(image)), (320, 240)))
    (defect,) = inputs(folders).defects()
    assert "is 320 x 240 pixels, its camera has" in defect
    (defect,) = RunInputs(scenes=InputFolder(SCENES), n_scenes=-1).defects()
    assert "n_scenes must be positive" in defect
