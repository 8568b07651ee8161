"""Scenes in the form of ``datasets/scenes``: what a webcam above the table logs, the task, and the true mesh."""

import dataclasses
import math
import pathlib
from typing import Any

import numpy as np
from numpy.typing import NDArray

from deltasafe.compute.progress import Progress, silent
from deltasafe.errors import SettingsError
from deltasafe.io.storage import atomic_folder, write_json
from deltasafe.scene import Camera, LoggedScene
from generator.datasheet import write_scenes_datasheet
from generator.drawing import draw_scene
from generator.hand_sets import keep_to_settings, render_hand
from generator.recipe import Recipe
from generator.render import Renderer
from generator.settings import SceneSettings
from generator.staging import PlacedHand, place_hand, view_of
from generator.surroundings import CollisionArrays

__all__ = ["free_place", "hand_height_m", "make_scenes", "plan_scene"]

Array = NDArray[np.float64]
ATTEMPTS = 100
STEP_M = 0.005
TABLE_Z_M = 0.0
BORDER_M = 0.035  # of the view, kept free around start and goal: the tool's reach


@dataclasses.dataclass(frozen=True)
class _Plan:
    recipe: Recipe
    hand: PlacedHand
    camera: Camera
    start_y_m: float
    goal_y_m: float
    hand_height_m: float


def make_scenes(
    folder: str | pathlib.Path,
    count: int,
    settings: SceneSettings,
    surroundings: CollisionArrays | None = None,
    progress: Progress = silent,
) -> pathlib.Path:
    """Fill ``folder`` with ``scene_000`` to ``scene_<count - 1>``, each written whole or not at all.

    Scene i is a function of settings, surroundings and i alone; those that are there already are kept.

    Raises:
        SettingsError: ``count`` is not positive, Mitsuba is not installed, or no scene leaves room for start and goal.
        DataError: the folder holds scenes made with other settings or surroundings.
    """
    if count < 1:
        raise SettingsError(f"count must be at least 1, got {count}")
    folder, surroundings = pathlib.Path(folder), surroundings or CollisionArrays()
    renderer = Renderer(settings.variant)
    keep_to_settings(folder, "scenes", settings, surroundings)
    for index in range(count):
        name = f"scene_{index:03d}"
        progress(index, count, name)
        if (folder / name / "scene.json").is_file():
            continue
        plan = plan_scene(settings, surroundings, index)
        image, mask = render_hand(renderer, plan.recipe, surroundings, settings)
        vertices, triangles = plan.hand.mesh_m()
        with atomic_folder(folder / name) as temporary:
            (temporary / "image.jpg").write_bytes(image)
            (temporary / "hand_mask.png").write_bytes(mask)
            np.savez_compressed(temporary / "hand_mesh.npz", vertices_m=vertices, triangles=triangles)
            write_json(temporary / "recipe.json", plan.recipe)
            write_json(temporary / "scene.json", _record(name, plan, settings))
            LoggedScene.load(temporary)
    write_scenes_datasheet(folder, settings)
    progress(count, count, f"{count} scenes lie in {folder}")
    return folder


def plan_scene(settings: SceneSettings, surroundings: CollisionArrays, index: int) -> _Plan:
    """Recipe, hand, camera and task of scene ``index``: the first of its drawings that leaves room for start and goal.

    Raises:
        SettingsError: none of a hundred does.
    """
    for attempt in range(ATTEMPTS):
        recipe = draw_scene(settings, surroundings, index, attempt)
        hand = place_hand(recipe)
        camera = view_of(recipe, hand, settings.width, settings.height)
        vertices = hand.mesh_m()[0].astype(float)
        places = [free_place(camera, vertices, sign * settings.tool_x_m, settings) for sign in (-1, 1)]
        if places[0] is not None and places[1] is not None:
            height = hand_height_m(camera, vertices)
            return _Plan(recipe, hand, camera, places[0], places[1], height)
    raise SettingsError(
        f"no hand leaves {settings.clearance_m} m around start and goal at x = +-{settings.tool_x_m} m; "
        "lower clearance_m, or raise the camera"
    )


def free_place(camera: Camera, vertices_m: Array, x_m: float, settings: SceneSettings) -> float | None:
    """The y nearest to 0 at which (x, y) lies in view and ``clearance_m`` away from the mesh (V, 3) seen from above.

    Seen from above, since the tool's shaft reaches up. None if there is no such place.
    """
    corners = np.array([[0.0, 0.0], [camera.width, camera.height]])
    view = camera.pixel_to_plane(corners, settings.tool_z_m)[:, :2]
    low, high = view.min(axis=0) + BORDER_M, view.max(axis=0) - BORDER_M
    if not low[0] <= x_m <= high[0]:
        return None
    for step in range(math.ceil(high[1] / STEP_M)):
        for y_m in (step * STEP_M, -step * STEP_M):
            distance = np.hypot(vertices_m[:, 0] - x_m, vertices_m[:, 1] - y_m).min()
            if low[1] <= y_m <= high[1] and distance >= settings.clearance_m:
                return y_m
    return None


def hand_height_m(camera: Camera, vertices_m: Array) -> float:
    """Height above the table of the highest vertex inside the view, rounded up to a tenth of a millimetre."""
    uv, depth_m = camera.project(vertices_m)
    inside = (depth_m > 0) & ((uv >= 0) & (uv <= (camera.width, camera.height))).all(axis=1)
    return math.ceil(float(vertices_m[inside, 2].max()) * 1e4) / 1e4 - TABLE_Z_M


def _record(name: str, plan: _Plan, settings: SceneSettings) -> dict[str, Any]:
    camera = dataclasses.asdict(plan.camera)

    def pose(x_m: float, y_m: float) -> dict[str, Any]:
        return {"position_m": [x_m, y_m, settings.tool_z_m], "yaw_rad": 0.0}

    return {
        "id": name,
        "image": "image.jpg",
        "camera": camera,
        "table_z_m": TABLE_Z_M,
        "hand_height_m": plan.hand_height_m,
        "start": pose(-settings.tool_x_m, plan.start_y_m),
        "goal": pose(settings.tool_x_m, plan.goal_y_m),
        "ground_truth": {"mask": "hand_mask.png", "mesh": "hand_mesh.npz"},
        "seed": settings.seed,
    }
