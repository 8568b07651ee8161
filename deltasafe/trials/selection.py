"""Selection of logged scenes, copied into one folder, so that all later steps use the same ones on any machine."""

import os
import pathlib
import shutil
from collections.abc import Sequence

from deltasafe.errors import DataError, SettingsError
from deltasafe.io.storage import atomic_folder, read_json, sha256_of_file, write_json
from deltasafe.scene import LoggedScene, load_scenes

SCENE = "scene.json"


def select_scenes(source: pathlib.Path, n_scenes: int, folder: pathlib.Path) -> tuple[LoggedScene, ...]:
    """Check the scenes below ``source`` and write at most ``n_scenes`` (0: all) to ``folder``.

    Files are hard links if the file system allows it, else copies.

    Raises:
        DataError: a scene is defective, or there is none.
        SettingsError: ``n_scenes`` is negative.
    """
    chosen = chosen_scenes(source, n_scenes)
    _write(chosen, folder)
    return chosen


def chosen_scenes(source: pathlib.Path, n_scenes: int) -> tuple[LoggedScene, ...]:
    """Check the scenes below ``source``, and return at most ``n_scenes`` (0: all).

    Raises:
        DataError, SettingsError: see `select_scenes`.
    """
    scenes = load_scenes(source)
    if n_scenes < 0:
        raise SettingsError(f"n_scenes must be positive, or 0 (all scenes), got {n_scenes}")
    return scenes[: n_scenes or None]


def select_scene(source: pathlib.Path, folder: pathlib.Path) -> LoggedScene:
    """Check the scene in ``source`` and write it to ``folder``.

    Raises:
        DataError: the scene is defective, or its id is not the name of its folder.
    """
    scene = LoggedScene.load(source)
    if scene.id != source.name:
        raise DataError(source, f"holds the scene {scene.id!r}; rename the folder to that id")
    _write((scene,), folder)
    return scene


def _write(scenes: Sequence[LoggedScene], folder: pathlib.Path) -> None:
    with atomic_folder(folder) as temporary:
        record = []
        for scene in scenes:
            place = scene.image_path.parent
            shutil.copytree(place, temporary / place.name, copy_function=_link, ignore=shutil.ignore_patterns(".*"))
            digests = {"image_sha256": sha256_of_file(scene.image_path), "scene_sha256": sha256_of_file(place / SCENE)}
            record.append({"folder": place.name, **digests})
        write_json(temporary / "scenes.json", record)


def _link(source: str, destination: str) -> None:
    try:
        os.link(pathlib.Path(source).resolve(), destination)
    except OSError:
        shutil.copyfile(source, destination)


def load_selection(folder: pathlib.Path) -> tuple[LoggedScene, ...]:
    """Load the scenes that `select_scenes` or `select_scene` wrote.

    Raises:
        DataError: a scene is missing, or its image or scene.json was replaced.
    """
    scenes = []
    for entry in read_json(folder / "scenes.json"):
        scene = LoggedScene.load(folder / entry["folder"])
        for path, name in ((scene.image_path, "image_sha256"), (folder / entry["folder"] / SCENE, "scene_sha256")):
            if name in entry and sha256_of_file(path) != entry[name]:  # earlier versions lack scene_sha256
                raise DataError(path, "was replaced since the scenes were selected; select them again")
        scenes.append(scene)
    return tuple(scenes)
