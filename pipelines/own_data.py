"""Inputs of one's own in place of the packaged ones: options of `make demo` as fields of the job `everything`."""

import pathlib
from collections.abc import Mapping
from typing import Any

from deltasafe.errors import DeltasafeError
from deltasafe.perception.data.dataset_info import DatasetInfo

_LABELED = {"hands": "raw_hands", "test": "test_hands"}


def converted(root: pathlib.Path, given: Mapping[str, str]) -> dict[str, str]:
    """Return the folders ``given`` by name; labels of other tools are converted to sets below ``root`` first.

    Labels that cannot be converted stay as they are: the launch check reports them with all other defects.
    """
    from deltasafe.perception.data.importing.import_hands import import_hands, source_digest
    from deltasafe.perception.data.importing.settings import ImportSettings

    folders = {name: str(pathlib.Path(folder).expanduser().resolve()) for name, folder in given.items()}
    for name in _LABELED:
        source = pathlib.Path(folders.get(name, "/"))
        if name in folders and _kind(source) == "source":
            folder = root / "own-data" / "converted" / source_digest(source, ImportSettings())[:16]
            try:
                if not folder.is_dir():
                    print(f"{source}: {import_hands(source, folder).summary()}; see {folder}")
            except DeltasafeError:
                continue
            folders[name] = str(folder)
    return folders


def steps_of(folders: Mapping[str, str]) -> dict[str, dict[str, Any]]:
    """Return the configuration of the steps that read the ``folders``: hands, test, backgrounds, scenes."""
    steps: dict[str, dict[str, Any]] = {
        step: {_kind(pathlib.Path(folders[name])): folders[name]} for name, step in _LABELED.items() if name in folders
    }
    if "backgrounds" in folders:
        steps["augmented_hands"] = {"backgrounds": folders["backgrounds"]}
    if "scenes" in folders:
        steps["logged_scenes"] = {"folder": folders["scenes"], "n_scenes": 0}
    return steps


def home_of(root: pathlib.Path, folders: Mapping[str, str]) -> pathlib.Path:
    """Return the home of runs on ``folders``: below ``root``, one for each obstacle.

    Scenes alone stay in ``root``: its ensemble is trained on the packaged images, too, and is not trained again.

    Raises:
        DataError: ``dataset.json`` of the training images is malformed.
    """
    if set(folders) == {"scenes"}:
        return root
    obstacle = DatasetInfo.load(folders["hands"]).obstacle if "hands" in folders else "hand"
    return root / "own-data" / obstacle


def _kind(labels: pathlib.Path) -> str:
    """Return whether ``labels`` is a ``folder`` of images and masks, or the ``source`` of another tool."""
    is_set = (labels / "images").is_dir() and (labels / "masks").is_dir()
    return "folder" if is_set or not labels.exists() else "source"
