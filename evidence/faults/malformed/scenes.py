"""Corruptions of logged scenes: calibration, units, tasks, ground truth, and paths out of the folder."""

import json
import pathlib
import shutil
from typing import Any

import numpy as np

from deltasafe.scene import LoggedScene
from evidence.faults.malformed.documents import document_changes, field_changes, with_field
from evidence.faults.malformed.files import (
    NOT_A_FILE,
    at,
    blaming_folder,
    cases_of,
    file_changes,
    linked_outside,
    prefixed,
)
from evidence.faults.malformed.packed import array_changes, with_array
from evidence.faults.rejection import Case, Change, Corruption, InputKind
from pipelines.home import DATASETS

SCENE, MESH = "scene.json", "hand_mesh.npz"
REQUIRED = [
    *("id", "image", "camera", "table_z_m", "hand_height_m", "start", "goal"),
    *(f"{end}.{name}" for end in ("start", "goal") for name in ("position_m", "yaw_rad")),
    *(f"camera.{name}" for name in ("width", "height", "fx", "fy", "cx", "cy")),
    *("camera.position_m", "camera.world_from_camera_rotation"),
]

OPTIONAL = ["ground_truth", "ground_truth.mask", "ground_truth.mesh"]
"""Fields that may be missing, but not be of another type."""


def copied_scene(home: pathlib.Path) -> pathlib.Path:
    """Copy a packaged scene."""
    valid = home / "scene_000"
    shutil.copytree(DATASETS / "scenes" / "scene_000", valid)
    return valid


def scene_cases(valid: pathlib.Path) -> list[Case]:
    """A logged scene, as `LoggedScene.load` and ``deltasafe export`` read it."""

    def command(given: pathlib.Path, out: pathlib.Path) -> list[str]:
        return ["export", str(given), str(out / "scene.mcap")]

    def target(change: Change) -> Corruption:
        return at(SCENE, change)

    kind = InputKind("scene", valid, lambda given, out: LoggedScene.load(given), command)
    record = json.loads((valid / SCENE).read_text())
    optional = {name: change for name, change in field_changes(record, OPTIONAL) if not name.startswith("without")}
    changes = {**document_changes(), **dict(field_changes(record, REQUIRED)), **optional, **_values()}
    missing = {name: changes.pop(name) for name in NOT_A_FILE}
    corruptions = prefixed(SCENE, changes, target)
    # the command looks for the file first, and reports the folder if there is none
    corruptions |= prefixed(SCENE, missing, lambda change: blaming_folder(target(change)))
    corruptions |= prefixed(MESH, {**array_changes(valid / MESH), **_meshes()}, lambda change: at(MESH, change))
    for name in ("image.jpg", "hand_mask.png"):
        for state in NOT_A_FILE:
            corruptions[f"{name}: {state}"] = at(name, file_changes()[state])
    for name in ("image.jpg", "hand_mask.png", MESH):
        corruptions[f"{name} is a link out of the folder"] = linked_outside(name)
    return cases_of(kind, corruptions)


def _values() -> dict[str, Change]:
    values: list[tuple[str, Any]] = [
        *((f"camera.{name}", value) for name in ("fx", "fy") for value in (0.0, -768.75, 1e-9, "wide")),
        *((f"camera.{name}", value) for name in ("width", "height") for value in (0, -640, 640.5, "640", True)),
        *(("camera.position_m", value) for value in ([0, 0], [0, 0, "x"], [0, 0, -0.5], [0, 0, 500.0], [0, 0, 0])),
        *(("camera.world_from_camera_rotation", value) for value in _rotations()),
        *(("hand_height_m", value) for value in (0, -0.07, 73.1, 0.5, 1e308)),
        *(("table_z_m", value) for value in (0.6, 1e9, 500.0)),
        *((f"{end}.position_m", value) for end in ("start", "goal") for value in _positions()),
        *((f"{end}.yaw_rad", value) for end in ("start", "goal") for value in (90.0, -180.0)),
        *(("id", value) for value in ("", ".", "..", "../other", "a/b", "/etc", "a\0b", "a\nb", "x" * 300)),
        *((name, value) for name in ("image", "ground_truth.mask", "ground_truth.mesh") for value in _paths()),
    ]
    return {f"{field} is {value!r:.60}": with_field(field, value) for field, value in values}


def _rotations() -> list[Any]:
    level = [[1.0, 0, 0], [0, -1.0, 0], [0, 0, -1.0]]
    return [
        [[0.0] * 3] * 3,
        (2 * np.array(level)).tolist(),
        np.diag([1.0, 1.0, -1.0]).tolist(),
        (np.array(level) + 0.01).tolist(),
        np.eye(3).tolist(),
        [[1.0, 0, 0], [0, 0, 1.0], [0, -1.0, 0]],
        level[:2],
        [*level[:2], [0, 0]],
    ]


def _positions() -> list[Any]:
    return [[-150.0, 0.0, 30.0], [0, 0], [0, 0, 0, 0], [0, 0, -0.03], [0, 0, "high"], {"x": 0}, [0, 0, None]]


def _paths() -> list[str]:
    return ["../scene_001/image.jpg", "/etc/passwd", "", ".", "..", "none.jpg", "a\0b"]


def _meshes() -> dict[str, Change]:
    triangle, corners = np.array([[0, 1, 2]], np.int32), np.eye(3, dtype=np.float32) / 10
    wrong = corners.copy()
    wrong[1, 1] = np.nan
    infinite = corners.copy()
    infinite[2, 0] = np.inf
    return {
        "a vertex is NaN": with_array("vertices_m", np.tile(wrong, (2000, 1))),
        "a vertex is infinite": with_array("vertices_m", np.tile(infinite, (2000, 1))),
        "in micrometers": with_array("vertices_m", np.tile(corners * 1e6, (2000, 1))),
        "vertices in two dimensions": with_array("vertices_m", np.zeros((2000, 2), np.float32)),
        "complex vertices": with_array("vertices_m", np.zeros((2000, 3), np.complex64)),
        "no triangles": with_array("triangles", triangle[:0]),
        "more triangles than the simulation takes": with_array("triangles", np.tile(triangle, (174_763, 1))),
        "triangles as floats": with_array("triangles", triangle.astype(np.float32)),
        "triangles with four corners": with_array("triangles", np.zeros((1, 4), np.int32)),
        "a triangle with a missing vertex": with_array("triangles", triangle + 10**7),
        "a triangle with a negative vertex index": with_array("triangles", triangle - 1),
    }
