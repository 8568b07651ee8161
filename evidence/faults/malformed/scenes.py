"""Logged scenes: bad calibration, other units, impossible tasks, damaged truth, paths that lead out of the folder."""

import json
import pathlib
import shutil
from collections.abc import Iterator
from random import Random
from typing import Any

import numpy as np

from deltasafe.scene import LoggedScene
from evidence.faults.judging import Case, Door, Spoil
from evidence.faults.malformed.documents import changed, document_spoils, field_spoils
from evidence.faults.malformed.files import at, file_spoils, linked_out
from evidence.faults.malformed.packed import array_spoils, with_array

__all__ = ["copied_scene", "scene_cases"]

SCENE, MESH = "scene.json", "hand_mesh.npz"
REQUIRED = [
    "id",
    "image",
    "camera",
    "table_z_m",
    "hand_height_m",
    "start",
    "goal",
    "ground_truth",
    "ground_truth.mask",
    "ground_truth.mesh",
    "start.position_m",
    "start.yaw_rad",
    "goal.position_m",
    "goal.yaw_rad",
    "camera.width",
    "camera.height",
    "camera.fx",
    "camera.fy",
    "camera.cx",
    "camera.cy",
    "camera.position_m",
    "camera.world_from_camera_rotation",
]


def copied_scene(home: pathlib.Path, datasets: pathlib.Path) -> pathlib.Path:
    """A scene as it was logged."""
    sound = home / "scene_000"
    shutil.copytree(datasets / "scenes" / "scene_000", sound)
    return sound


def scene_cases(sound: pathlib.Path) -> list[Case]:
    """A scene for `LoggedScene.load` and ``deltasafe export``."""

    def read(given: pathlib.Path, out: pathlib.Path) -> None:
        LoggedScene.load(given)

    def command(given: pathlib.Path, out: pathlib.Path) -> list[str]:
        return ["export", str(given), str(out / "scene.mcap")]

    door = Door("scene", sound, read, command)
    record = json.loads((sound / SCENE).read_text())
    changes = {**document_spoils(), **dict(field_spoils(record, REQUIRED)), **dict(_values())}
    not_there = ("missing", "a folder", "a pipe", "a link to nowhere", "a link to itself")
    spoils: dict[str, Spoil] = {}
    for name, change in changes.items():
        spoil = at(SCENE, change)
        spoils[f"{SCENE}: {name}"] = _by_folder(spoil) if name in not_there else spoil
    for name, change in {**array_spoils(sound / MESH), **_meshes()}.items():
        spoils[f"{MESH}: {name}"] = at(MESH, change)
    for name in ("image.jpg", "hand_mask.png"):
        for kind in not_there:
            spoils[f"{name}: {kind}"] = at(name, file_spoils()[kind])
    for name in ("image.jpg", "hand_mask.png", MESH):
        spoils[f"{name} is a link out of the folder"] = linked_out(name)
    return [Case(name, door, spoil) for name, spoil in spoils.items()]


def _by_folder(spoil: Spoil) -> Spoil:
    """The command looks for the file first, and speaks of the folder where there is none."""

    def spoilt(given: pathlib.Path, random: Random) -> str:
        spoil(given, random)
        return given.name

    return spoilt


def _values() -> Iterator[tuple[str, Any]]:
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
    for field, value in values:
        yield f"{field} is {value!r:.60}", changed(field, value)


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


def _meshes() -> dict[str, Any]:
    triangle, corners = np.array([[0, 1, 2]], np.int32), np.eye(3, dtype=np.float32) / 10
    wrong = corners.copy()
    wrong[1, 1] = np.nan
    infinite = corners.copy()
    infinite[2, 0] = np.inf
    return {
        "a vertex is NaN": with_array("vertices_m", np.tile(wrong, (2000, 1))),
        "a vertex is infinite": with_array("vertices_m", np.tile(infinite, (2000, 1))),
        "in millimetres": with_array("vertices_m", np.tile(corners * 1e3 * 1e3, (2000, 1))),
        "vertices in the plane": with_array("vertices_m", np.zeros((2000, 2), np.float32)),
        "vertices of complex numbers": with_array("vertices_m", np.zeros((2000, 3), np.complex64)),
        "no triangles": with_array("triangles", triangle[:0]),
        "triangles of floats": with_array("triangles", triangle.astype(np.float32)),
        "triangles of four corners": with_array("triangles", np.zeros((1, 4), np.int32)),
        "a triangle without a vertex": with_array("triangles", triangle + 10**7),
        "a triangle with a negative vertex": with_array("triangles", triangle - 1),
    }
