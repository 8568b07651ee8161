"""The simulated camera shows the hand where it is, never less of it; motions keep their speed."""

import dataclasses

import numpy as np
import pytest
from scipy.ndimage import binary_dilation

from deltasafe.errors import SettingsError
from deltasafe.io.images import read_rgb
from deltasafe.online.hand_motions import KINDS, REACH_M, HandMotion
from deltasafe.online.moving_scene import MovingHand, SimulatedCamera, hand_of, pixels_of, surface_points
from deltasafe.scene import Camera, LoggedScene
from deltasafe.studies.safety.scenarios import true_mask
from pipelines.home import DATASETS

CAMERA = Camera(160, 120, 192.0, 192.0, 80.0, 60.0, np.array([0.0, 0.0, 0.9]), np.diag([1.0, -1.0, -1.0]))
PLATE = np.full((120, 160, 3), 30, np.uint8)
TRIANGLE = np.array([[0, 0, 0.02], [0.05, 0, 0.05], [0, 0.08, 0.01]], np.float32)
POINTS = surface_points(TRIANGLE, np.array([[0, 1, 2]], np.int32), 0.004)


def test_points_cover_the_surface_densely() -> None:
    rng = np.random.default_rng(0)
    a, b = rng.uniform(0, 1, (2, 500))
    a, b = np.where(a + b > 1, 1 - a, a), np.where(a + b > 1, 1 - b, b)
    drawn = TRIANGLE[0] + a[:, None] * (TRIANGLE[1] - TRIANGLE[0]) + b[:, None] * (TRIANGLE[2] - TRIANGLE[0])
    assert np.linalg.norm(drawn[:, None] - POINTS, axis=2).min(axis=1).max() <= 0.004 / np.sqrt(3) + 1e-6


def test_the_silhouette_contains_every_point_at_its_true_place() -> None:
    hand = MovingHand(POINTS, np.full(POINTS.shape, 200, np.uint8), lambda time_s: np.array([0.1 * time_s, -0.02]))
    camera = SimulatedCamera(hand, CAMERA, PLATE)
    rows, columns = pixels_of(POINTS + np.array([0.05, -0.02, 0.0]), CAMERA)
    mask, image = camera.silhouette(0.5), camera.draw(0.5)
    assert mask[rows, columns].all()
    assert (image[rows, columns] > 150).all()
    assert mask.sum() < 9 * len(set(zip(rows, columns, strict=True)))
    assert (image[~mask] < 60).all()


def test_a_hand_has_the_colors_of_its_photograph_and_none_of_the_background() -> None:
    scene = LoggedScene.load(DATASETS / "scenes" / "scene_000")
    rgb, mask = read_rgb(scene.image_path), true_mask(scene)
    hand = hand_of(scene, rgb, lambda time_s: np.zeros(2), mask)
    skin = {tuple(color) for color in rgb[mask]}
    assert {tuple(color) for color in hand.colors} <= skin
    rows, columns = pixels_of(hand.points_m, scene.camera)
    inside = (rows >= 0) & (rows < 480) & (columns >= 0) & (columns < 640)
    assert binary_dilation(mask, iterations=3)[rows[inside], columns[inside]].all()  # shape and photograph agree
    assert hand.height_m >= scene.hand_height_m - 0.01


def test_no_gap_is_left_in_a_surface_close_to_the_camera() -> None:
    near = dataclasses.replace(CAMERA, position_m=np.array([0.0, 0.0, 0.15]))
    camera = SimulatedCamera(MovingHand(POINTS, POINTS.astype(np.uint8), lambda time_s: np.zeros(2)), near, PLATE)
    a, b = np.random.default_rng(1).dirichlet((1, 1, 1), 20_000)[:, :2].T
    drawn = TRIANGLE[0] + a[:, None] * (TRIANGLE[1] - TRIANGLE[0]) + b[:, None] * (TRIANGLE[2] - TRIANGLE[0])
    rows, columns = pixels_of(drawn, near)
    inside = (rows < 120) & (columns < 160) & (rows >= 0) & (columns >= 0)
    assert inside.sum() > 1000
    assert camera.silhouette(0.0)[rows[inside], columns[inside]].all()


def test_the_camera_delivers_after_its_latency_and_no_two_images_are_equal() -> None:
    hand = MovingHand(POINTS, np.full(POINTS.shape, 200, np.uint8), lambda time_s: np.zeros(2))
    camera = SimulatedCamera(hand, CAMERA, PLATE, period_s=0.1, latency_s=0.15)
    assert camera.newest(0.1) is None
    first, second = camera.newest(0.16), camera.newest(0.26)
    assert first is not None
    assert second is not None
    assert (first.captured_s, second.captured_s) == (0.0, pytest.approx(0.1))
    assert (first.rgb != second.rgb).any()


@pytest.mark.parametrize("kind", KINDS)
def test_a_hand_keeps_its_speed_and_its_area(kind: str) -> None:
    for seed in range(5):
        motion, tool = HandMotion(kind, 0.2, seed), np.array([0.1, 0.0, 0.05, 0.0])
        path = []
        for n in range(1000):
            motion.see(0.01 * n, tool)
            path.append(motion(0.01 * n))
        moved = np.linalg.norm(np.diff(path, axis=0), axis=1)
        assert moved.max() <= 0.2 * 0.01 + 1e-9
        assert moved.max() > 0.0019
        assert np.abs(path).max() <= REACH_M + 1e-9


def test_an_unknown_motion_is_refused() -> None:
    with pytest.raises(SettingsError, match="kind"):
        HandMotion("waving", 0.1, 0)
