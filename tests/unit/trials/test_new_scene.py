"""Scene folders from one photograph: what is written, what is refused, what is drawn."""

import dataclasses
import math
import shutil

import cv2
import numpy as np
import pytest

from deltasafe.cameras import CameraModel, write_camera
from deltasafe.cli import main
from deltasafe.errors import DataError
from deltasafe.geometry import Pose
from deltasafe.io.images import read_rgb
from deltasafe.scene import LoggedScene
from deltasafe.trials import new_scene, scene_picture
from deltasafe.trials.new_scene import SceneDraft, scene_warnings, write_scene
from tests.unit.trials.test_trials import SCENES

GIVEN = SCENES / "scene_000"
PACKAGED = LoggedScene.load(GIVEN)
DRAFT = SceneDraft(
    GIVEN / "image.jpg",
    GIVEN / "scene.json",
    hand_height_m=0.08,
    start=(-0.15, 0.0, 0.03, 0.0),
    goal=(0.15, 0.03, 0.03, 0.5),
)


def turned(turn_rad):
    """The packaged scene, whose camera is turned about the vertical."""
    cos, sin = np.cos(turn_rad), np.sin(turn_rad)
    rotation = np.array([[cos, -sin, 0], [sin, cos, 0], [0, 0, 1]]) @ PACKAGED.camera.world_from_camera_rotation
    return dataclasses.replace(
        PACKAGED, camera=dataclasses.replace(PACKAGED.camera, world_from_camera_rotation=rotation)
    )


def test_a_scene_is_written_with_image_camera_and_picture(tmp_path):
    scene = write_scene(DRAFT, tmp_path / "mine")
    assert (scene.id, scene.start, scene.goal) == ("mine", Pose(-0.15, 0, 0.03), Pose(0.15, 0.03, 0.03, 0.5))
    assert (scene.table_z_m, scene.hand_height_m, scene.mask_path, scene.mesh_path) == (0.0, 0.08, None, None)
    assert (read_rgb(scene.image_path) == read_rgb(GIVEN / "image.jpg")).all()
    for field in dataclasses.fields(scene.camera):
        assert np.array_equal(getattr(scene.camera, field.name), getattr(PACKAGED.camera, field.name))
    assert read_rgb(tmp_path / "mine" / "understood.png").shape[1] > 1000


def test_distortion_of_image_and_mask_is_undone(tmp_path):
    camera = PACKAGED.camera
    values = {field.name: getattr(camera, field.name) for field in dataclasses.fields(camera)}
    model = CameraModel(**values, distortion=(-0.2, 0.05, 0.0, 0.0, 0.0))
    write_camera(tmp_path / "camera.json", model)
    mask = np.zeros((480, 640), np.uint8)
    mask[100:300, 200:400] = 255
    cv2.imwrite(str(tmp_path / "mask.png"), mask)
    draft = dataclasses.replace(DRAFT, camera=tmp_path / "camera.json", mask=tmp_path / "mask.png")
    scene = write_scene(draft, tmp_path / "mine")
    assert (read_rgb(scene.image_path) == model.undistorted(read_rgb(GIVEN / "image.jpg"))).all()
    assert (cv2.imread(str(scene.mask_path), cv2.IMREAD_GRAYSCALE) == model.undistorted(mask, is_mask=True)).all()
    assert scene.camera.fx == model.pinhole().fx != camera.fx


def test_all_that_is_wrong_is_listed_and_nothing_is_written(tmp_path):
    draft = SceneDraft(tmp_path / "none.jpg", tmp_path / "none.json", -1.0, (0, 0, math.nan, 0), (99.0, 0, 0.1, 0))
    with pytest.raises(DataError, match="has 5 defects") as caught:
        write_scene(draft, tmp_path / "mine")
    for words in ("none.jpg", "none.json", "hand_height_m", "start.position_m", "field goal"):
        assert words in str(caught.value)
    assert not list(tmp_path.iterdir())


def test_large_photograph_is_scaled_down_with_its_camera_and_mask(tmp_path, monkeypatch):
    monkeypatch.setattr(new_scene, "MAX_PIXELS", 320 * 240)
    scene = write_scene(dataclasses.replace(DRAFT, mask=GIVEN / "hand_mask.png"), tmp_path / "mine")
    assert (scene.camera.width, scene.camera.height) == (320, 240)
    np.testing.assert_allclose([scene.camera.fx, scene.camera.cx], [PACKAGED.camera.fx / 2, 160.0])
    small, whole = (cv2.imread(str(path), cv2.IMREAD_GRAYSCALE) for path in (scene.mask_path, GIVEN / "hand_mask.png"))
    assert small.shape == read_rgb(scene.image_path).shape[:2] == (240, 320)
    assert (small > 0).mean() == pytest.approx((whole > 0).mean(), abs=0.002)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"camera": "unplaced.json"}, "deltasafe camera locate"),
        ({"mask": "small.png"}, "has 64 x 48 pixels, the image 640 x 480"),
        ({"image": "portrait.png"}, "aspect ratio"),
        ({"table_z_m": 0.1}, "must lie above the table"),
        ({"hand_height_m": 0.6}, "less than the camera's height"),
    ],
)
def test_unusable_input_is_refused(tmp_path, changes, words):
    model = CameraModel(640, 480, 768.0, 768.0, 320.0, 240.0)
    write_camera(tmp_path / "unplaced.json", model)
    cv2.imwrite(str(tmp_path / "small.png"), 255 * np.eye(48, 64, dtype=np.uint8))
    cv2.imwrite(str(tmp_path / "portrait.png"), np.zeros((640, 480, 3), np.uint8))
    given = {name: tmp_path / value if isinstance(value, str) else value for name, value in changes.items()}
    with pytest.raises(DataError, match=words):
        write_scene(dataclasses.replace(DRAFT, **given), tmp_path / "mine")
    assert not (tmp_path / "mine").exists()


def test_only_a_folder_of_an_earlier_scene_is_replaced(tmp_path):
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "scene.json").write_text("{}")
    assert write_scene(DRAFT, tmp_path / "mine").hand_height_m == 0.08
    (tmp_path / "mine" / "holiday.jpg").write_bytes(b"precious")
    with pytest.raises(DataError, match=r"other files \(holiday\.jpg\)"):
        write_scene(DRAFT, tmp_path / "mine")
    assert (tmp_path / "mine" / "holiday.jpg").read_bytes() == b"precious"


@pytest.mark.parametrize(
    ("start", "words"),
    [
        (Pose(-0.15, 0.0, 0.03), []),
        (Pose(-0.2, 0.0, 0.03), ["the tool at the start is not wholly inside"]),
        (Pose(-0.2, 0.0, 0.2), []),  # above the field, which ends at 0.083 m
        (Pose(0.0, -0.6, 0.2), ["does not reach the start"]),
    ],
)
def test_warnings_say_what_keeps_a_motion_from_being_found(start, words):
    found = scene_warnings(dataclasses.replace(PACKAGED, start=start))
    assert len(found) == len(words)
    assert all(word in one for word, one in zip(words, found, strict=True))


@pytest.mark.parametrize("turn_rad", [0.0, math.pi / 2, math.pi])
def test_drawn_axes_equal_the_closed_form_of_a_camera_that_looks_down(monkeypatch, turn_rad):
    """One step of 0.05 m is 768.75 * 0.05 / 0.5 pixels; the letter stands 16 pixels beyond. A swapped axis shows."""
    figures = []
    monkeypatch.setattr(scene_picture, "save_figure", lambda figure, destination: figures.append(figure))
    scene = turned(turn_rad)
    scene_picture.draw_scene(read_rgb(scene.image_path), scene, "unused.png", ["a warning"])
    image, *_, facts = figures[0].axes
    places = {text.get_text(): np.array(text.get_position()) for text in image.texts}
    length_px = PACKAGED.camera.fx * 0.05 / 0.5 + 16
    cos, sin = np.cos(turn_rad), np.sin(turn_rad)
    np.testing.assert_allclose(places["x"], [320 + length_px * cos, 240 + length_px * sin], atol=0.01)
    np.testing.assert_allclose(places["y"], [320 + length_px * sin, 240 - length_px * cos], atol=0.01)
    uv, _ = scene.camera.project(np.array([[-0.15, 0.0, 0.03]]))
    assert abs(places["start (-0.15, 0, 0.03)"][0] - uv[0, 0]) < 1e-6
    assert "a warning" in facts.texts[1].get_text()


def test_command_takes_degrees_and_lists_defects(tmp_path, capsys):
    given = ["--image", str(GIVEN / "image.jpg"), "--camera", str(GIVEN / "scene.json"), "--hand-height", "0.08"]
    task = ["--start", "-0.15", "0", "0.03", "0", "--goal", "0.15", "0.03", "0.03", "90"]
    assert main(["scene", "new", str(tmp_path / "mine"), *given, *task]) == 0
    assert LoggedScene.load(tmp_path / "mine").goal.yaw_rad == pytest.approx(math.pi / 2)
    assert "understood.png" in capsys.readouterr().out
    assert main(["scene", "check", str(tmp_path / "mine"), "-o", str(tmp_path / "again.jpg")]) == 0
    assert "without a true mask and without a true mesh" in capsys.readouterr().out
    assert (tmp_path / "again.jpg").is_file()
    bad = ["--start", "0", "0", "-1", "0", "--goal", "0", "0", "1", "999"]
    assert main(["scene", "new", str(tmp_path / "bad"), *given, *bad]) == 1
    first, *listed = capsys.readouterr().err.splitlines()
    assert first.startswith("deltasafe: ")
    assert len(listed) == 2
    assert all(line.startswith("- ") for line in listed)


def test_check_of_a_packaged_scene_finds_its_truth(tmp_path, capsys):
    shutil.copytree(GIVEN, tmp_path / "scene_000")
    assert main(["scene", "check", str(tmp_path / "scene_000")]) == 0
    assert "usable, with a true mask and with a true mesh" in capsys.readouterr().out
    (tmp_path / "scene_000" / "hand_mask.png").write_bytes(b"no image")
    assert main(["scene", "check", str(tmp_path / "scene_000")]) == 1
