"""Predicted occupancy probabilities of each logged scene, and the occupancy grid that is extruded from them."""

import pathlib
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from deltasafe.compute.progress import Progress, silent
from deltasafe.errors import DataError, SettingsError
from deltasafe.io.images import read_rgb
from deltasafe.io.storage import atomic_folder, read_json, write_json
from deltasafe.perception.data.masks import read_mask
from deltasafe.scene import FieldSettings, ImageStamp, LoggedScene, OccupancyGrid, grid_from_image

if TYPE_CHECKING:
    from deltasafe.perception.inference.ensemble import Ensemble


def write_fields(
    ensemble: "Ensemble",
    scenes: Sequence[LoggedScene],
    folder: pathlib.Path,
    settings: FieldSettings,
    progress: Progress = silent,
) -> None:
    """Write `p_occupied.npy` (H, W) float32, `grid.npz` and the image stamp `seen.json` of each scene, atomically.

    `dataset.json` says what the ensemble detects, unless it is hands.

    Raises:
        DataError: an image is unreadable or not of its camera's size.
        SettingsError: a grid would have too many voxels.
    """
    with atomic_folder(folder) as temporary:
        ensemble.info.save(temporary)
        for done, scene in enumerate(scenes, start=1):
            rgb = read_scene_image(scene)
            p_occupied = ensemble.p_occupied(rgb)
            (temporary / scene.id).mkdir()
            np.save(temporary / scene.id / "p_occupied.npy", p_occupied, allow_pickle=False)
            task = scene.start, scene.goal
            try:
                grid = grid_from_image(p_occupied, scene.camera, scene.table_z_m, scene.hand_height_m, settings, task)
            except SettingsError as error:
                raise SettingsError(f"scene {scene.id}: {error}") from error
            grid.save(temporary / scene.id / "grid.npz")
            write_json(temporary / scene.id / "seen.json", ImageStamp.of(rgb))
            progress(done, len(scenes), f"predicted {scene.id}")


def read_scene_image(scene: LoggedScene) -> NDArray[np.uint8]:
    """Read the image of a scene, (H, W, 3) RGB.

    Raises:
        DataError: it is unreadable, or not of its camera's size.
    """
    rgb: NDArray[np.uint8] = read_rgb(scene.image_path)
    if rgb.shape[:2] != (scene.camera.height, scene.camera.width):
        raise DataError(
            scene.image_path,
            f"is {rgb.shape[1]} x {rgb.shape[0]} pixels, its camera has {scene.camera.width} x {scene.camera.height}",
        )
    return rgb


def read_true_mask(scene: LoggedScene, shape: tuple[int, ...]) -> NDArray[np.uint8] | None:
    """Read the true mask of a scene, (H, W) with 255 = hand; None if it has none. For evaluation only.

    Raises:
        DataError: it is unreadable, shows no hand, or has another ``shape`` than the image.
    """
    if scene.mask_path is None:
        return None
    mask: NDArray[np.uint8] = read_mask(scene.mask_path)
    if mask.shape != shape:
        raise DataError(scene.mask_path, f"is {mask.shape}, the image {shape} pixels; restore it")
    return mask


def load_occupancy_grid(folder: pathlib.Path, scene_id: str) -> OccupancyGrid:
    """Load the occupancy grid of a scene.

    Raises:
        DataError: there is none in ``folder``.
    """
    return OccupancyGrid.load(folder / scene_id / "grid.npz")


def load_image_stamp(folder: pathlib.Path, scene_id: str) -> ImageStamp:
    """Load the stamp of the image that the field of a scene was made from.

    Raises:
        DataError: there is none in ``folder``.
    """
    file = folder / scene_id / "seen.json"
    try:
        return ImageStamp(**read_json(file))
    except (TypeError, ValueError) as error:
        if isinstance(error, DataError):
            raise
        raise DataError(file, f"is not an image stamp ({error}); make the occupancy fields again") from error


def load_p_occupied(folder: pathlib.Path, scene_id: str) -> NDArray[np.float32]:
    """Load p_occupied (H, W) float32 of the image of a scene.

    Raises:
        DataError: there is none in ``folder``.
    """
    file = folder / scene_id / "p_occupied.npy"
    try:
        stored: NDArray[np.float32] = np.load(file, allow_pickle=False)
    except (OSError, EOFError, ValueError, MemoryError) as error:
        raise DataError(file, f"is not readable ({error}); make the occupancy fields again") from error
    return stored


def miss_rates_at_delta(scenes: Sequence[LoggedScene], folder: pathlib.Path, delta: float) -> dict[str, float]:
    """Return the miss rate of each scene with a true mask: the fraction of the hand's pixels with p_occupied <= delta.

    For evaluation only: neither the ensemble nor the planner has the true mask.

    Raises:
        DataError: a mask is unreadable, or shows no hand.
    """
    rates = {}
    for scene in scenes:
        p_occupied = load_p_occupied(folder, scene.id)
        mask = read_true_mask(scene, p_occupied.shape)
        if mask is not None:
            rates[scene.id] = float((p_occupied[mask > 0] <= delta).mean())
    return rates
