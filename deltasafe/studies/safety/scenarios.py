"""Scenarios: scene, image, task, arm and single member, drawn from the study's seed and the scenario's number."""

import dataclasses

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from deltasafe.errors import DataError
from deltasafe.geometry import Pose
from deltasafe.scene import LoggedScene
from deltasafe.studies.safety.camera_noise import photograph_again
from deltasafe.studies.safety.settings import SafetyStudySettings, TaskSettings

ATTEMPTS = 4000
"""Pairs of start and goal that are drawn for a task."""


@dataclasses.dataclass(frozen=True)
class Scenario:
    """Input that all methods of a scenario share.

    Attributes:
        number: number of the scenario.
        scene: index of its scene.
        rgb: image (H, W, 3) uint8.
        task: start and goal of the tool; None if no pair was found.
        plan_seed: seed of the search.
        arm_seed: seed of the arm's friction and torque sensors.
        member: random number that selects the single member, modulo M.
    """

    number: int
    scene: int
    rgb: NDArray[np.uint8]
    task: tuple[Pose, Pose] | None
    plan_seed: int
    arm_seed: int
    member: int


def draw_scenario(settings: SafetyStudySettings, n_scenes: int, scene: LoggedScene, number: int) -> Scenario:
    """Draw scenario ``number``.

    Args:
        n_scenes: number of scenes of the study.
        scene: the scene with index ``number % n_scenes``.

    Raises:
        DataError: the image is unreadable or does not have the size of its camera.
    """
    from deltasafe.io.images import read_rgb

    rng = np.random.default_rng([settings.seed, number])
    rgb = read_rgb(scene.image_path)
    if rgb.shape[:2] != (scene.camera.height, scene.camera.width):
        raise DataError(
            scene.image_path,
            f"is {rgb.shape[1]} x {rgb.shape[0]} pixels, its camera has {scene.camera.width} x {scene.camera.height}",
        )
    plan_seed, arm_seed, member = map(int, rng.integers(0, 2**31 - 1, 3))
    task = draw_task(settings.task, scene, rng)
    rgb = photograph_again(rgb, settings.camera, rng)
    return Scenario(number, number % n_scenes, rgb, task, plan_seed, arm_seed, member)


def draw_task(settings: TaskSettings, scene: LoggedScene, rng: np.random.Generator) -> tuple[Pose, Pose] | None:
    """Draw start and goal uniformly among the pairs that the settings allow; None if no pair was found.

    The true hand is used, because a task never starts or ends in a hand. Whether the ends are safe in a planner's
    field is not tested here; the planner may refuse them.
    """
    camera, mesh = scene.camera, scene.true_mesh()[0].astype(np.float64)
    corners = np.array([[0.0, 0.0], [camera.width, 0.0], [0.0, camera.height], [camera.width, camera.height]])
    view = camera.pixel_to_plane(corners, scene.table_z_m + settings.z_range_m[1])[:, :2]
    low, high = view.min(axis=0) + settings.border_m, view.max(axis=0) - settings.border_m
    hand = cKDTree(mesh[:, :2])
    drawn = rng.uniform(low, high, (ATTEMPTS, 2, 2))
    clear = (hand.query(drawn.reshape(-1, 2))[0] >= settings.clearance_m).reshape(-1, 2).all(axis=1)
    far = np.linalg.norm(drawn[:, 1] - drawn[:, 0], axis=1) >= settings.min_distance_m
    for start, goal in drawn[clear & far]:
        line = start + np.linspace(0.0, 1.0, 64)[:, None] * (goal - start)
        if hand.query(line)[0].min() <= settings.near_hand_m:
            z = scene.table_z_m + rng.uniform(settings.z_range_m[0], settings.z_range_m[1], 2)
            yaw = rng.uniform(-settings.yaw_range_rad, settings.yaw_range_rad, 2)
            first, last = (Pose(*map(float, (*xy, z[n], yaw[n]))) for n, xy in enumerate((start, goal)))
            return first, last
    return None


def true_mask(scene: LoggedScene) -> NDArray[np.bool_]:
    """Read the true mask (H, W) of the hand, which only the evaluation uses.

    Raises:
        DataError: the mask is unreadable or shows no hand.
    """
    import cv2

    assert scene.mask_path is not None  # `StudyInputs.gather` requires it
    mask = cv2.imdecode(np.fromfile(scene.mask_path, np.uint8), cv2.IMREAD_GRAYSCALE)
    if mask is None or not mask.any():
        raise DataError(scene.mask_path, "is not a mask of a hand (255 = hand); restore it")
    return np.asarray(mask > 0)
