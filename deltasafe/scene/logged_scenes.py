"""Logged scenes: an image of a hand on the table, its camera, and the task of the tool."""

import dataclasses
import math
import pathlib
from collections.abc import Callable, Mapping
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from deltasafe.errors import DataError, SettingsError
from deltasafe.geometry import Pose
from deltasafe.io.arrays import read_npz
from deltasafe.io.folder_entries import is_clutter
from deltasafe.io.storage import read_json
from deltasafe.scene.camera import Camera
from deltasafe.scene.extrusion import FieldSettings, useful_area

Mesh: TypeAlias = tuple[NDArray[np.float32], NDArray[np.int32]]

MAX_NAME_LENGTH = 100
MAX_DISTANCE_M = 10.0
"""Largest coordinate in a scene: larger ones suggest another unit than meters."""

MAX_VERTICES, MAX_TRIANGLES = 131_072, 174_762
"""Largest mesh that PyBullet takes on Linux, 524,288 corners of triangles; its build for macOS takes less."""

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
            DataError: lists the files that are missing, and the fields that are missing or outside their domain.
        """
        path = pathlib.Path(folder) / "scene.json"
        values, defects = check_scene(path, read_json(path))
        if defects:
            raise DataError.combined(folder, defects)
        return cls(**values)

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
        return _read_mesh(self.mesh_path)


def load_scenes(folder: str | pathlib.Path) -> tuple[LoggedScene, ...]:
    """Read the scenes of a folder, one per sub-folder that holds a ``scene.json``, in order of name.

    Raises:
        DataError: there is no scene, or two scenes have the same id; or lists the scenes that are invalid.
    """
    folder, defects = pathlib.Path(folder), []
    scenes = []
    for path in scene_files(folder):
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


def scene_files(folder: pathlib.Path) -> list[pathlib.Path]:
    """Return the files ``scene.json`` in the sub-folders of ``folder``, without hidden ones and those of desktops."""
    return sorted(path for path in folder.glob("*/scene.json") if not is_clutter(path.parent.name))


def check_scene(path: pathlib.Path, record: Any) -> tuple[dict[str, Any], list[DataError]]:
    """Check the content of a ``scene.json``; return the attributes of a `LoggedScene` and all defects.

    Args:
        path: of the file; the files that it names are beside it.
        record: its content. A defective field has the value None.
    """
    defects: list[DataError] = []

    def attempt(read: Callable[..., Any], *arguments: Any) -> Any:
        try:
            return read(path, *arguments)
        except DataError as error:
            defects.append(error)
            return None

    if not isinstance(record, Mapping):
        return {}, [DataError(path, "must hold one object with named fields (docs/reference/formats.md); restore it")]
    values = {
        "id": attempt(_id, record),
        "image_path": attempt(_file, record, "image"),
        "camera": attempt(_camera, record),
        "table_z_m": attempt(_number, record, "table_z_m"),
        "hand_height_m": attempt(_hand_height_m, record),
    }
    for name in ("start", "goal"):
        values[name] = attempt(_pose, record, name, values["table_z_m"])
    truth = attempt(_truth_of, record) or {}
    values |= {f"{name}_path": attempt(_file, truth, name) for name in truth}
    if all(values[name] is not None for name in ("camera", "table_z_m", "hand_height_m", "start", "goal")):
        attempt(_check_view, *(values[name] for name in ("camera", "table_z_m", "hand_height_m", "start", "goal")))
    if values.get("mesh_path") is not None:
        attempt(lambda _: _read_mesh(values["mesh_path"]))
    return values, defects


def _read_mesh(path: pathlib.Path) -> Mesh:
    """Read vertices_m (V, 3) float32 and triangles (F, 3) int32."""
    try:
        arrays = read_npz(path)
        vertices_m, triangles = arrays["vertices_m"], arrays["triangles"]
    except KeyError as error:
        raise DataError(path, f"is not a mesh (it lacks {error}); export it again") from error
    if vertices_m.ndim != 2 or vertices_m.shape[1] != 3 or vertices_m.dtype.kind not in "fiu":
        raise DataError(path, f"vertices_m must be finite (V, 3), got {vertices_m.dtype} {vertices_m.shape}")
    if not np.isfinite(vertices_m).all() or np.abs(vertices_m).max(initial=0.0) > MAX_DISTANCE_M:
        raise DataError(path, f"vertices_m must be finite, in meters, and within {MAX_DISTANCE_M:g} m")
    if triangles.ndim != 2 or triangles.shape[1] != 3 or triangles.dtype.kind not in "iu":
        raise DataError(path, f"triangles must be integers (F, 3), got shape {triangles.shape}")
    if triangles.size == 0 or triangles.min() < 0 or triangles.max() >= len(vertices_m):
        raise DataError(path, f"triangles must index the {len(vertices_m)} vertices")
    if len(vertices_m) > MAX_VERTICES or len(triangles) > MAX_TRIANGLES:
        raise DataError(
            path,
            f"has {len(vertices_m)} vertices and {len(triangles)} triangles, the simulation takes at most "
            f"{MAX_VERTICES} and {MAX_TRIANGLES}; simplify it (for example by quadric decimation)",
        )
    return vertices_m.astype(np.float32), triangles.astype(np.int32)


def _member(path: pathlib.Path, record: Any, name: str) -> Any:
    if not isinstance(record, Mapping) or name not in record:
        raise DataError(path, f"field {name} is missing; add it (docs/reference/formats.md)")
    return record[name]


def _id(path: pathlib.Path, record: Any) -> str:
    value = _member(path, record, "id")
    if not isinstance(value, str) or pathlib.PurePath(value).name != value or not _is_name(value):
        raise DataError(path, f"field id must be a name without slashes, got {value!r:.80}")
    return value


def _camera(path: pathlib.Path, record: Any) -> Camera:
    try:
        return Camera.from_json(_member(path, record, "camera"))
    except SettingsError as error:
        raise DataError(path, f"field camera: {error}") from error


def _hand_height_m(path: pathlib.Path, record: Any) -> float:
    value = _number(path, record, "hand_height_m")
    if value <= 0:
        raise DataError(path, f"field hand_height_m must be positive, got {value}")
    return value


def _check_view(
    path: pathlib.Path, camera: Camera, table_z_m: float, hand_height_m: float, start: Pose, goal: Pose
) -> None:
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
    if not len(camera.view_on_plane(table_z_m, *useful_area(start, goal))):
        raise DataError(
            path,
            f"field camera must see the table within {FieldSettings.reach_m:g} m of start and goal, but it is at "
            f"{np.round(camera.position_m, 3).tolist()} and looks along "
            f"{np.round(camera.world_from_camera_rotation[:, 2], 3).tolist()}; check units (meters) and axes "
            "(columns of the rotation: x right, y down, z forward), or start and goal",
        )


def _is_name(value: str) -> bool:
    return value.isprintable() and value not in ("", ".", "..") and len(value) <= MAX_NAME_LENGTH


def _number(path: pathlib.Path, record: Any, name: str) -> float:
    return _finite(path, name, _member(path, record, name))


def _finite(path: pathlib.Path, name: str, value: Any) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not abs(value) <= MAX_NUMBER:
        raise DataError(path, f"field {name} must be a finite number, got {value!r:.80}")
    return float(value)


def _truth_of(path: pathlib.Path, record: Mapping[str, Any]) -> Mapping[str, Any]:
    """What ``ground_truth`` names; empty if it is left out."""
    if "ground_truth" not in record:
        return {}
    truth = record["ground_truth"]
    _only(path, "ground_truth", truth, {"mask", "mesh"})
    if not isinstance(truth, Mapping) or not truth:
        raise DataError(
            path,
            f"field ground_truth must name mask, mesh or both, got {truth!r:.80}; leave it out if they are unknown",
        )
    return truth


def _only(path: pathlib.Path, name: str, value: Any, fields: set[str]) -> None:
    """Refuse unknown fields, such as a frame or a tilt, instead of ignoring them."""
    unknown = sorted(set(value) - fields) if isinstance(value, Mapping) else []
    if unknown:
        raise DataError(path, f"field {name} may hold {sorted(fields)}, in the world frame, got {unknown}; remove them")


def _pose(path: pathlib.Path, record: Any, name: str, table_z_m: float | None) -> Pose:
    value = _member(path, record, name)
    position = _member(path, value, "position_m")
    _only(path, name, value, {"position_m", "yaw_rad"})
    if not isinstance(position, list) or len(position) != 3:
        raise DataError(path, f"field {name}.position_m must hold x, y, z, got {position!r}")
    x_m, y_m, z_m = (_finite(path, f"{name}.position_m", coordinate) for coordinate in position)
    yaw_rad = _number(path, value, "yaw_rad")
    is_above = table_z_m is None or z_m > table_z_m
    if max(abs(x_m), abs(y_m), abs(z_m)) > MAX_DISTANCE_M or not is_above or abs(yaw_rad) > 2 * math.pi:
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
