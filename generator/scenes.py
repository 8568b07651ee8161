"""Scenes in the format of ``datasets/scenes``: the log of a webcam above the table, the task, and the true mesh."""

import dataclasses
import math
import pathlib
from typing import Any

import numpy as np

from deltasafe.compute.progress import Progress, silent
from deltasafe.errors import SettingsError
from deltasafe.io.storage import atomic_folder, write_json
from deltasafe.scene import Camera, LoggedScene
from generator.aliases import Array
from generator.datasheet import write_datasheet
from generator.picture_folder import missing_items, render_image_and_mask
from generator.placement import PlacedHand, place_hand
from generator.recipe import Recipe
from generator.recipe_sampling import sample_scene_recipe
from generator.render import Renderer
from generator.settings import SceneSettings
from generator.stage_building import build_camera
from generator.surroundings import Surroundings

MAX_ATTEMPTS = 100
STEP_M = 0.005
TABLE_Z_M = 0.0
VIEW_MARGIN_M = 0.035  # distance of start and goal to the border of the view, so that the tool is visible


@dataclasses.dataclass(frozen=True)
class ScenePlan:
    """A scene before rendering."""

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
    surroundings: Surroundings | None = None,
    progress: Progress = silent,
) -> None:
    """Render ``scene_000`` to ``scene_<count - 1>`` into ``folder``; each scene is written atomically.

    Scene i is a function of settings, surroundings and i alone. Existing scenes are kept.

    Raises:
        SettingsError: ``count`` is not positive, Mitsuba is not installed, or no hand leaves room for start and goal.
        DataError: the folder holds scenes made with other settings or surroundings.
    """
    folder, surroundings = pathlib.Path(folder), surroundings or Surroundings()
    renderer = Renderer(settings.variant)
    scene_files = [folder / f"scene_{index:03d}" / "scene.json" for index in range(count)]
    for index in missing_items(folder, scene_files, settings, surroundings, progress):
        plan = plan_scene(settings, surroundings, index)
        image, mask = render_image_and_mask(renderer, plan.recipe, plan.hand, surroundings, settings)
        vertices, triangles = plan.hand.mesh_m()
        destination = scene_files[index].parent
        with atomic_folder(destination) as temporary:
            (temporary / "image.jpg").write_bytes(image)
            (temporary / "hand_mask.png").write_bytes(mask)
            np.savez_compressed(temporary / "hand_mesh.npz", vertices_m=vertices, triangles=triangles)
            write_json(temporary / "recipe.json", plan.recipe)
            write_json(temporary / "scene.json", _scene_json(destination.name, plan, settings))
            LoggedScene.load(temporary)  # validates the files before they are published
    write_datasheet(folder, "scene_*/recipe.json", settings)
    progress(count, count, f"{count} scenes are in {folder}")


def plan_scene(settings: SceneSettings, surroundings: Surroundings, index: int) -> ScenePlan:
    """Sample recipes of scene ``index`` until one leaves room for start and goal.

    Raises:
        SettingsError: no recipe within ``MAX_ATTEMPTS`` does.
    """
    for attempt in range(MAX_ATTEMPTS):
        recipe = sample_scene_recipe(settings, surroundings, index, attempt)
        hand = place_hand(recipe)
        camera = build_camera(recipe, hand, settings.width, settings.height)
        vertices = hand.mesh_m()[0].astype(float)
        start_y, goal_y = (free_tool_y_m(camera, vertices, sign * settings.tool_x_m, settings) for sign in (-1, 1))
        if start_y is not None and goal_y is not None:
            return ScenePlan(recipe, hand, camera, start_y, goal_y, _hand_height_m(camera, vertices))
    raise SettingsError(
        f"no hand leaves {settings.clearance_m} m around start and goal at x = +-{settings.tool_x_m} m; "
        "lower clearance_m, or raise the camera"
    )


def free_tool_y_m(camera: Camera, vertices_m: Array, x_m: float, settings: SceneSettings) -> float | None:
    """Find the y nearest to 0 at which (x, y) is in view and ``clearance_m`` away from the mesh (V, 3).

    The distance is horizontal, because the shaft of the tool extends upwards. Returns None if there is no such y.
    """
    corners = np.array([[0.0, 0.0], [camera.width, camera.height]])
    view = camera.pixel_to_plane(corners, settings.tool_z_m)[:, :2]
    low, high = view.min(axis=0) + VIEW_MARGIN_M, view.max(axis=0) - VIEW_MARGIN_M
    if not low[0] <= x_m <= high[0]:
        return None
    for step in range(math.ceil(high[1] / STEP_M)):
        for y_m in (step * STEP_M, -step * STEP_M):
            distance = np.hypot(vertices_m[:, 0] - x_m, vertices_m[:, 1] - y_m).min()
            if low[1] <= y_m <= high[1] and distance >= settings.clearance_m:
                return y_m
    return None


def _hand_height_m(camera: Camera, vertices_m: Array) -> float:
    """Return the height above the table of the highest visible vertex, rounded up to 0.1 mm."""
    uv, depth_m = camera.project(vertices_m)
    visible = (depth_m > 0) & ((uv >= 0) & (uv <= (camera.width, camera.height))).all(axis=1)
    return math.ceil(float(vertices_m[visible, 2].max()) * 1e4) / 1e4 - TABLE_Z_M


def _scene_json(name: str, plan: ScenePlan, settings: SceneSettings) -> dict[str, Any]:
    start_m = [-settings.tool_x_m, plan.start_y_m, settings.tool_z_m]
    goal_m = [settings.tool_x_m, plan.goal_y_m, settings.tool_z_m]
    return {
        "id": name,
        "image": "image.jpg",
        "camera": dataclasses.asdict(plan.camera),
        "table_z_m": TABLE_Z_M,
        "hand_height_m": plan.hand_height_m,
        "start": {"position_m": start_m, "yaw_rad": 0.0},
        "goal": {"position_m": goal_m, "yaw_rad": 0.0},
        "ground_truth": {"mask": "hand_mask.png", "mesh": "hand_mesh.npz"},
        "seed": settings.seed,
    }
