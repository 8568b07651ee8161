"""Situations: a scene, a picture of it, a task, an arm. Drawn from the study's seed and the situation's number."""

import dataclasses

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from deltasafe.errors import DataError
from deltasafe.geometry import Pose
from deltasafe.scene import LoggedScene
from deltasafe.studies.safety.camera_noise import photograph_again
from deltasafe.studies.safety.settings import SafetyStudySettings, TaskSettings

__all__ = ["Situation", "draw_situation", "draw_task", "true_mask"]

Array = NDArray[np.float64]
ATTEMPTS = 4000
PLANNER, ARM, MEMBER = 0, 1, 2


@dataclasses.dataclass(frozen=True)
class Situation:
    """What every contender of a situation is given.

    Attributes:
        number: of the situation.
        scene: index of its scene.
        rgb: (H, W, 3) uint8, the picture.
        task: start and goal of the tool; None where the hand leaves no room for them.
        plan_seed, arm_seed: of the search, and of the arm's friction and torque sensors.
        member: draws the single member; modulo M.
    """

    number: int
    scene: int
    rgb: NDArray[np.uint8]
    task: tuple[Pose, Pose] | None
    plan_seed: int
    arm_seed: int
    member: int


def draw_situation(settings: SafetyStudySettings, scenes: int, scene: LoggedScene, number: int) -> Situation:
    """Situation ``number``: scenes take turns, everything else is drawn.

    Args:
        scenes: how many there are.
        scene: the one whose turn it is, number ``number % scenes``.

    Raises:
        DataError: the image is unreadable or not of its camera's size.
    """
    from deltasafe.perception.data.labeled_images import read_rgb

    rng = np.random.default_rng([settings.seed, number])
    rgb = read_rgb(scene.image_path)
    if rgb.shape[:2] != (scene.camera.height, scene.camera.width):
        raise DataError(
            scene.image_path,
            f"is {rgb.shape[1]} x {rgb.shape[0]} pixels, its camera has {scene.camera.width} x {scene.camera.height}",
        )
    seeds = rng.integers(0, 2**31 - 1, 3)
    task = draw_task(settings.task, scene, rng)
    return Situation(
        number,
        number % scenes,
        photograph_again(rgb, settings.camera, rng),
        task,
        int(seeds[PLANNER]),
        int(seeds[ARM]),
        int(seeds[MEMBER]),
    )


def draw_task(settings: TaskSettings, scene: LoggedScene, rng: np.random.Generator) -> tuple[Pose, Pose] | None:
    """Start and goal, uniform among those pairs that the settings admit; None if the hand leaves no room for any.

    They are drawn with the true mesh at hand: whoever sets a task does not ask the tool to start in a hand. Whether
    they are safe in a planner's field is another matter, and may be a reason to refuse.
    """
    camera, mesh = scene.camera, scene.true_mesh()[0].astype(np.float64)
    corners = np.array([[0.0, 0.0], [camera.width, 0.0], [0.0, camera.height], [camera.width, camera.height]])
    view = camera.pixel_to_plane(corners, scene.table_z_m + settings.z_range_m[1])[:, :2]
    low, high = view.min(axis=0) + settings.border_m, view.max(axis=0) - settings.border_m
    hand = cKDTree(mesh[:, :2])
    drawn = rng.uniform(low, high, (ATTEMPTS, 2, 2))
    clear = (hand.query(drawn.reshape(-1, 2))[0] >= settings.clearance_m).reshape(-1, 2).all(axis=1)
    far = np.linalg.norm(drawn[:, 1] - drawn[:, 0], axis=1) >= settings.least_way_m
    for start, goal in drawn[clear & far]:
        line = start + np.linspace(0.0, 1.0, 64)[:, None] * (goal - start)
        if hand.query(line)[0].min() <= settings.close_m:
            z = scene.table_z_m + rng.uniform(settings.z_range_m[0], settings.z_range_m[1], 2)
            yaw = rng.uniform(-settings.yaw_range_rad, settings.yaw_range_rad, 2)
            poses = [
                Pose(float(end[0]), float(end[1]), float(height), float(turn))
                for end, height, turn in zip((start, goal), z, yaw, strict=True)
            ]
            return poses[0], poses[1]
    return None


def true_mask(scene: LoggedScene) -> NDArray[np.bool_]:
    """(H, W) the true hand in the picture, for judging alone.

    Raises:
        DataError: the mask is unreadable, or shows no hand.
    """
    import cv2

    mask = cv2.imdecode(np.fromfile(scene.mask_path, np.uint8), cv2.IMREAD_GRAYSCALE)
    if mask is None or not mask.any():
        raise DataError(scene.mask_path, "is no mask of a hand (255 = hand); restore it")
    return np.asarray(mask > 0)
