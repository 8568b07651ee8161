"""Reading logged scenes, and the errors for invalid ones."""

import json
import pathlib

import numpy as np
import pytest

from deltasafe.errors import DataError
from deltasafe.scene import LoggedScene, load_scenes

POSE = {"position_m": [-0.15, 0.0, 0.03], "yaw_rad": 0.0}


def write(folder: pathlib.Path, **changes: object) -> pathlib.Path:
    folder.mkdir(parents=True)
    value: dict = {
        "id": folder.name,
        "image": "image.jpg",
        "camera": {"width": 640, "height": 480, "fx": 768.0, "fy": 768.0, "cx": 320.0, "cy": 240.0}
        | {"position_m": [0, 0, 0.5], "world_from_camera_rotation": [[1, 0, 0], [0, -1, 0], [0, 0, -1]]},
        "table_z_m": 0.0,
        "hand_height_m": 0.07,
        "start": POSE,
        "goal": POSE | {"yaw_rad": 1.0},
        "ground_truth": {"mask": "hand_mask.png", "mesh": "hand_mesh.npz"},
    }
    (folder / "scene.json").write_text(json.dumps(value | changes))
    (folder / "image.jpg").write_bytes(b"jpeg")
    (folder / "hand_mask.png").write_bytes(b"png")
    np.savez(
        folder / "hand_mesh.npz",
        vertices_m=np.eye(3, dtype=np.float32),
        triangles=np.array([[0, 1, 2]], dtype=np.int32),
    )
    return folder


def test_scene_is_read_with_its_mesh(tmp_path: pathlib.Path) -> None:
    scene = LoggedScene.load(write(tmp_path / "scene_000"))
    assert (scene.id, scene.hand_height_m, scene.goal.yaw_rad) == ("scene_000", 0.07, 1.0)
    assert scene.start.as_tuple() == (-0.15, 0.0, 0.03, 0.0)
    assert scene.camera.height == 480
    vertices_m, triangles = scene.true_mesh()
    assert vertices_m.shape == (3, 3)
    assert triangles.tolist() == [[0, 1, 2]]


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"hand_height_m": -1}, "hand_height_m must be positive"),
        ({"table_z_m": "low"}, "table_z_m must be a finite number"),
        ({"start": {"position_m": [0, 0]}}, r"start\.position_m"),
        ({"goal": POSE | {"yaw_rad": None}}, "yaw_rad"),
        ({"goal": POSE | {"yaw_rad": 10**400}}, "yaw_rad must be a finite number"),
        ({"table_z_m": 10**400}, "table_z_m must be a finite number"),
        ({"start": POSE | {"position_m": ["-0.15", 0, 0.03]}}, r"start\.position_m must be a finite number"),
        ({"start": POSE | {"position_m": [False, 0, 0.03]}}, r"start\.position_m must be a finite number"),
        ({"start": POSE | {"position_m": [10**400, 0, 0.03]}}, r"start\.position_m must be a finite number"),
        ({"start": POSE | {"frame_id": "robot_base"}}, r"world frame, got \['frame_id'\]"),
        ({"goal": POSE | {"roll_rad": 0.7}}, "roll_rad"),
        ({"ground_truth": {"mask": "hand_mask.png", "mesh": "hand_mesh.npz", "frame_id": "camera"}}, "frame_id"),
        ({"image": "../image.jpg"}, "image must be the name"),
        ({"image": "other.jpg"}, "is missing"),
        ({"camera": {}}, "camera"),
        ({"id": ".."}, "id must be a name"),
        ({"hand_height_m": 70.0}, "less than the camera's height"),
        ({"table_z_m": 1.0}, "above the table"),
        ({"start": {"position_m": [-150, 0, 30], "yaw_rad": 0}}, "meters and radians"),
        ({"goal": POSE | {"yaw_rad": 90.0}}, "meters and radians"),
        ({"ground_truth": {"mask": "hand_mask.png", "mesh": None}}, "mesh must be the name"),
        ({"ground_truth": {"mesh": "lost.npz"}}, "is missing"),
        ({"ground_truth": {}}, "leave it out"),
        ({"ground_truth": None}, "leave it out"),
    ],
)
def test_errors_name_file_and_field(tmp_path: pathlib.Path, changes: dict, words: str) -> None:
    with pytest.raises(DataError, match=words) as caught:
        LoggedScene.load(write(tmp_path / "scene_000", **changes))
    assert "scene_000" in str(caught.value)


@pytest.mark.parametrize("known", [(), ("mask",), ("mesh",)])
def test_true_mask_and_mesh_are_optional(tmp_path: pathlib.Path, known: tuple) -> None:
    names = {"mask": "hand_mask.png", "mesh": "hand_mesh.npz"}
    folder = write(tmp_path / "scene_000", **({"ground_truth": {name: names[name] for name in known}} if known else {}))
    if not known:
        record = json.loads((folder / "scene.json").read_text())
        del record["ground_truth"]
        (folder / "scene.json").write_text(json.dumps(record))
    scene = LoggedScene.load(folder)
    assert (scene.mask_path is not None, scene.mesh_path is not None) == ("mask" in known, "mesh" in known)
    assert (scene.mesh_if_known() is None) == ("mesh" not in known)
    if "mesh" not in known:
        with pytest.raises(DataError, match="contacts cannot be judged"):
            scene.true_mesh()


@pytest.mark.parametrize("triangles", [[[0, 1, 3]], [[-1, 1, 2]], [[0.5, 1, 2]]])
def test_invalid_mesh_is_refused(tmp_path: pathlib.Path, triangles: list) -> None:
    folder = write(tmp_path / "scene_000")
    np.savez(folder / "hand_mesh.npz", vertices_m=np.eye(3), triangles=np.array(triangles))
    with pytest.raises(DataError, match="triangles"):
        LoggedScene.load(folder)


def test_all_defects_are_listed_together(tmp_path: pathlib.Path) -> None:
    folder = write(tmp_path / "scene_000", hand_height_m=-1, start={"position_m": [0, 0]}, image="lost.jpg")
    np.savez(folder / "hand_mesh.npz", vertices_m=np.eye(3), triangles=np.array([[0, 1, 3]]))
    with pytest.raises(DataError, match="has 4 defects") as caught:
        LoggedScene.load(folder)
    for words in ("hand_height_m", "start.position_m", "lost.jpg", "hand_mesh.npz: triangles"):
        assert words in str(caught.value)


def test_mesh_that_the_simulation_cannot_hold_is_refused(tmp_path: pathlib.Path) -> None:
    """B12: PyBullet takes 524,288 corners of triangles."""
    folder = write(tmp_path / "scene_000")
    triangles = np.tile(np.array([[0, 1, 2]], np.int32), (174_763, 1))
    np.savez(folder / "hand_mesh.npz", vertices_m=np.eye(3), triangles=triangles)
    with pytest.raises(DataError, match=r"174763 triangles.*simplify it"):
        LoggedScene.load(folder)


def turned(tilt: float) -> dict:
    """A camera above (0, -1.5), tilted toward +y."""
    cos, sin = float(np.cos(tilt)), float(np.sin(tilt))
    return {
        **{
            "width": 640,
            "height": 480,
            "fx": 768.0,
            "fy": 768.0,
            "cx": 320.0,
            "cy": 240.0,
            "position_m": [0, -1.5, 0.8],
        },
        "world_from_camera_rotation": [[1, 0, 0], [0, -cos, sin], [0, -sin, -cos]],
    }


def test_camera_that_sees_the_horizon_is_accepted(tmp_path: pathlib.Path) -> None:
    scene = LoggedScene.load(write(tmp_path / "scene_000", camera=turned(1.35)))
    assert scene.camera.project(np.array([[0.0, 1e6, 0.0]]))[0][0, 1] > 0  # the horizon is in the image


@pytest.mark.parametrize("tilt", [-1.1, 2.5])
def test_camera_that_looks_away_from_the_task_is_refused(tmp_path: pathlib.Path, tilt: float) -> None:
    with pytest.raises(DataError, match=r"must see the table within 0\.5 m of start and goal"):
        LoggedScene.load(write(tmp_path / "scene_000", camera=turned(tilt)))


def test_scenes_are_sorted_and_ids_are_unique(tmp_path: pathlib.Path) -> None:
    for name in ("b", "a"):
        write(tmp_path / name)
    assert [scene.id for scene in load_scenes(tmp_path)] == ["a", "b"]
    write(tmp_path / "c", id="a")
    with pytest.raises(DataError, match="more than once"):
        load_scenes(tmp_path)


def test_folder_without_scenes_is_refused(tmp_path: pathlib.Path) -> None:
    with pytest.raises(DataError, match="holds no scene"):
        load_scenes(tmp_path)
