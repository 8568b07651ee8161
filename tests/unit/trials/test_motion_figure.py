import pathlib

import numpy as np
import pytest

pytest.importorskip("matplotlib")

from matplotlib.image import imread

from deltasafe.errors import SettingsError
from deltasafe.geometry import Pose
from deltasafe.planning import MotionSettings, plan_motion
from deltasafe.scene import Camera, grid_from_image
from deltasafe.trials.motion_figure import plan_over_image

CAMERA = Camera(160, 120, 192.0, 192.0, 80.0, 60.0, np.array([0.0, 0.0, 0.5]), np.diag([1.0, -1.0, -1.0]))


def probabilities() -> np.ndarray:
    v, u = np.mgrid[:120, :160] + 0.5
    return np.clip(1.5 - np.hypot(u - 80, v - 70) / 20, 0, 1).astype(np.float32)


@pytest.mark.parametrize("start", [Pose(-0.13, 0.0, 0.03), Pose(0.0, -0.02, 0.03)])
def test_a_motion_and_a_scene_without_one_are_drawn(start: Pose, tmp_path: pathlib.Path) -> None:
    image = np.full((120, 160, 3), 90, np.uint8)
    grid = grid_from_image(probabilities(), CAMERA, 0.0, 0.05)
    motion = plan_motion(grid, start, Pose(0.13, 0.0, 0.03), MotionSettings(n_iterations=300), 0)
    assert motion.is_safe == (start.x_m < 0)
    plan_over_image(image, probabilities(), CAMERA, motion, tmp_path / "plan.png")
    drawn = imread(tmp_path / "plan.png")
    assert min(drawn.shape[:2]) > 400
    assert drawn[..., :3].std() > 0.1
    assert [path.name for path in tmp_path.iterdir()] == ["plan.png"]


def test_images_of_another_size_are_refused_before_anything_is_written(tmp_path: pathlib.Path) -> None:
    grid = grid_from_image(probabilities(), CAMERA, 0.0, 0.05)
    motion = plan_motion(grid, Pose(0, -0.02, 0.03), Pose(0.13, 0, 0.03), MotionSettings(), 0)
    with pytest.raises(SettingsError, match="camera's size"):
        plan_over_image(np.zeros((5, 5, 3), np.uint8), probabilities(), CAMERA, motion, tmp_path / "a.png")
    assert not list(tmp_path.iterdir())
