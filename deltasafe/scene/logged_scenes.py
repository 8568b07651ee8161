"""Logged scenes: an image of a hand on the table, its camera, and the task of the tool."""

import dataclasses
import math
import pathlib
from collections.abc import Mapping
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from deltasafe.errors import DataError, SettingsError
from deltasafe.geometry import Pose
from deltasafe.io.arrays import read_npz
from deltasafe.io.storage import read_json
from deltasafe.scene.camera import Camera

Mesh: TypeAlias = tuple[NDArray[np.float32], NDArray[np.int32]]

MAX_NAME_LENGTH = 100
MAX_DISTANCE_M = 10.0
"""Largest coordinate in a scene: larger ones suggest another unit than meters."""

MAX_NUMBER = 1e6
"""Largest number in a scene: JSON integers may be too large for a float."""


@dataclasses.dataclass(frozen=True)
class LoggedScene:
    """A logged scene; images stay on disk. Mask and mesh are ground truth for evaluation, never used for planning.

    Both are optional: what needs them is not judged.

    Attributes:
        id: name of the scene.
        image_path: photograph of the size of the camera.
        camera: the camera that took it.
        table_z_m: height of the table.
        hand_height_m: height above the table of the highest visible point of the hand.
        start, goal: poses of the tool.
        mask_path: true mask (255 = hand), or None.
        mesh_path: true mesh, read by ``true_mesh``, or None.
    """

    id: str
    image_path: pathlib.Path
    camera: Camera
    table_z_m: float
    hand_height_m: float
    start: Pose
    goal: Pose
    mask_path: pathlib.Path | None = None
    mesh_path: pathlib.Path | None = None

    @classmethod
    def load(cls, folder: str | pathlib.Path) -> "LoggedScene":
        """Read and check ``scene.json`` and the files that it names.

        Raises:
            DataError: a file is missing, or a field is missing or outside its domain; names file and field.
        """
        folder = pathlib.Path(folder)
        path = folder / "scene.json"
        record = read_json(path)
        try:
            camera = Camera.from_json(_member(path, record, "camera"))
        except SettingsError as error:
            raise DataError(path, f"field camera: {error}") from error
        table_z_m, hand_height_m = _number(path, record, "table_z_m"), _number(path, record, "hand_height_m")
        if hand_height_m <= 0:
            raise DataError(path, f"field hand_height_m must be positive, got {hand_height_m}")
        _check_view(path, camera, table_z_m, hand_height_m)
        scene_id = _member(path, record, "id")
        if not isinstance(scene_id, str) or pathlib.PurePath(scene_id).name != scene_id or not _is_name(scene_id):
            raise DataError(path, f"field id must be a name without slashes, got {scene_id!r:.80}")
        scene = cls(
            id=scene_id,
            image_path=_file(path, record, "image"),
            camera=camera,
            table_z_m=table_z_m,
            hand_height_m=hand_height_m,
            start=_pose(path, record, "start", table_z_m),
            goal=_pose(path, record, "goal", table_z_m),
            **_truth(path, record),
        )
        scene.mesh_if_known()
        return scene

    def mesh_if_known(self) -> Mesh | None:
        """Read the true mesh as ``true_mesh`` does; None if the scene has none."""
        return None if self.mesh_path is None else self.true_mesh()

    def true_mesh(self) -> Mesh:
        """Read the true mesh in the world frame: vertices_m (V, 3) float32 and triangles (F, 3) int32.

        Raises:
            DataError: the scene has no true mesh, or the file is not a mesh.
        """
        if self.mesh_path is None:
            raise DataError(
                self.image_path.parent / "scene.json",
                "names no true mesh (ground_truth.mesh), without which contacts cannot be judged; add it, or leave "
                "this scene out",
            )
        try:
            arrays = read_npz(self.mesh_path)
            vertices_m, triangles = arrays["vertices_m"], arrays["triangles"]
        except KeyError as error:
            raise DataError(self.mesh_path, f"is not a mesh (it lacks {error}); export it again") from error
        if vertices_m.ndim != 2 or vertices_m.shape[1] != 3 or vertices_m.dtype.kind not in "fiu":
            raise DataError(
                self.mesh_path, f"vertices_m must be finite (V, 3), got {vertices_m.dtype} {vertices_m.shape}"
            )
        if not np.isfinite(vertices_m).all() or np.abs(vertices_m).max(initial=0.0) > MAX_DISTANCE_M:
            raise DataError(self.mesh_path, f"vertices_m must be finite, in meters, and within {MAX_DISTANCE_M:g} m")
        if triangles.ndim != 2 or triangles.shape[1] != 3 or triangles.dtype.kind not in "iu":
            raise DataError(self.mesh_path, f"triangles must be integers (F, 3), got shape {triangles.shape}")
        if triangles.size == 0 or triangles.min() < 0 or triangles.max() >= len(vertices_m):
            raise DataError(self.mesh_path, f"triangles must index the {len(vertices_m)} vertices")
        return vertices_m.astype(np.float32), triangles.astype(np.int32)


def load_scenes(folder: str | pathlib.Path) -> tuple[LoggedScene, ...]:
    """Read the scenes of a folder, one per sub-folder that holds a ``scene.json``, in order of name.

    Raises:
        DataError: there is no scene, or two scenes have the same id; or lists the scenes that are invalid.
    """
    folder, defects = pathlib.Path(folder), []
    scenes = []
    for path in sorted(folder.glob("*/scene.json")):
        try:
            scenes.append(LoggedScene.load(path.parent))
        except DataError as error:
            defects.append(error)
    if defects:
        raise DataError.combined(folder, defects)
    if not scenes:
        raise DataError(folder, "holds no scene (a sub-folder with a scene.json); put one there")
    ids = [scene.id for scene in scenes]
    if len(set(ids)) < len(ids):
        twice = sorted({scene_id for scene_id in ids if ids.count(scene_id) > 1})
        raise DataError(folder, f"scene ids must be unique, these occur more than once: {twice}; rename one")
    return tuple(scenes)


def _member(path: pathlib.Path, record: Any, name: str) -> Any:
    if not isinstance(record, Mapping) or name not in record:
        raise DataError(path, f"field {name} is missing; add it (docs/reference/formats.md)")
    return record[name]


def _check_view(path: pathlib.Path, camera: Camera, table_z_m: float, hand_height_m: float) -> None:
    """Refuse a camera that sees the scene implausibly: its units or axes probably follow another convention."""
    above_m = float(camera.position_m[2]) - table_z_m
    if not 0 < above_m <= MAX_DISTANCE_M or np.abs(camera.position_m).max() > MAX_DISTANCE_M:
        raise DataError(
            path,
            f"field camera.position_m must be above the table and within {MAX_DISTANCE_M:g} m, in meters, "
            f"got {camera.position_m.tolist()} with the table at {table_z_m}",
        )
    if hand_height_m >= above_m:
        raise DataError(
            path, f"field hand_height_m must be less than the camera's height {above_m:g} m, got {hand_height_m}"
        )
    corners = np.array([(u, v) for u in (0, camera.width) for v in (0, camera.height)], dtype=np.float64)
    try:
        seen_m = camera.pixel_to_plane(corners, table_z_m)
    except SettingsError as error:
        raise DataError(path, f"field camera: {error}") from error
    if np.abs(seen_m).max() > MAX_DISTANCE_M:
        raise DataError(
            path, f"field camera must see at most {MAX_DISTANCE_M:g} m far, but sees {np.abs(seen_m).max():.3g} m"
        )


def _is_name(value: str) -> bool:
    return value.isprintable() and value not in ("", ".", "..") and len(value) <= MAX_NAME_LENGTH


def _number(path: pathlib.Path, record: Any, name: str) -> float:
    return _finite(path, name, _member(path, record, name))


def _finite(path: pathlib.Path, name: str, value: Any) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not abs(value) <= MAX_NUMBER:
        raise DataError(path, f"field {name} must be a finite number, got {value!r:.80}")
    return float(value)


def _truth(path: pathlib.Path, record: Mapping[str, Any]) -> dict[str, pathlib.Path]:
    """Paths of the true mask and mesh, as far as ``ground_truth`` names them."""
    if "ground_truth" not in record:
        return {}
    truth = record["ground_truth"]
    _only(path, "ground_truth", truth, {"mask", "mesh"})
    if not isinstance(truth, Mapping) or not truth:
        raise DataError(
            path,
            f"field ground_truth must name mask, mesh or both, got {truth!r:.80}; leave it out if they are unknown",
        )
    return {f"{name}_path": _file(path, truth, name) for name in truth}


def _only(path: pathlib.Path, name: str, value: Any, fields: set[str]) -> None:
    """Refuse unknown fields, such as a frame or a tilt, instead of ignoring them."""
    unknown = sorted(set(value) - fields) if isinstance(value, Mapping) else []
    if unknown:
        raise DataError(path, f"field {name} may hold {sorted(fields)}, in the world frame, got {unknown}; remove them")


def _pose(path: pathlib.Path, record: Any, name: str, table_z_m: float) -> Pose:
    value = _member(path, record, name)
    position = _member(path, value, "position_m")
    _only(path, name, value, {"position_m", "yaw_rad"})
    if not isinstance(position, list) or len(position) != 3:
        raise DataError(path, f"field {name}.position_m must hold x, y, z, got {position!r}")
    x_m, y_m, z_m = (_finite(path, f"{name}.position_m", coordinate) for coordinate in position)
    yaw_rad = _number(path, value, "yaw_rad")
    if max(abs(x_m), abs(y_m), abs(z_m)) > MAX_DISTANCE_M or not z_m > table_z_m or abs(yaw_rad) > 2 * math.pi:
        raise DataError(
            path,
            f"field {name} must lie above the table, within {MAX_DISTANCE_M:g} m, with a yaw of at most 2 pi, "
            f"in meters and radians, got {(x_m, y_m, z_m, yaw_rad)}",
        )
    return Pose(x_m, y_m, z_m, yaw_rad)


def _file(path: pathlib.Path, record: Any, name: str) -> pathlib.Path:
    value = _member(path, record, name)
    if not isinstance(value, str) or pathlib.PurePath(value).name != value:
        raise DataError(path, f"field {name} must be the name of a file beside it, got {value!r}")
    if not (path.parent / value).is_file():
        raise DataError(path.parent / value, f"is missing, but field {name} of {path.name} names it; restore it")
    if not (path.parent / value).resolve().is_relative_to(path.parent.resolve()):
        raise DataError(path.parent / value, "links to a file outside the scene's folder; copy the file (cp -L)")
    return path.parent / value
