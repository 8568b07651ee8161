"""Runs of a study as a folder: the arrays in ``runs.npz``, settings and effort in ``study.json``."""

import dataclasses
import pathlib
from collections.abc import Callable, Mapping
from typing import Any, TypeVar

import numpy as np

from deltasafe.errors import DataError
from deltasafe.io.arrays import read_npz
from deltasafe.io.records import from_json
from deltasafe.io.storage import atomic_folder, read_json, write_json
from deltasafe.studies.resumable_jobs import Effort

Settings = TypeVar("Settings")


def save_runs(folder: str | pathlib.Path, settings: object, arrays: Mapping[str, Any], effort: Effort) -> None:
    """Write the folder atomically."""
    with atomic_folder(folder) as temporary:
        np.savez_compressed(temporary / "runs.npz", **arrays)
        write_json(temporary / "study.json", {"settings": settings, **dataclasses.asdict(effort)})


def load_runs(
    folder: str | pathlib.Path, kind: type[Settings], shapes_of: Callable[[Settings], Mapping[str, tuple[int, ...]]]
) -> tuple[Settings, dict[str, Any], Effort]:
    """Read a folder that ``save_runs`` wrote: settings, arrays and effort.

    Args:
        kind: class of the settings.
        shapes_of: names and shapes of the arrays that belong to some settings.

    Raises:
        DataError: a file is missing or has other content.
    """
    folder = pathlib.Path(folder)
    record, stored = read_json(folder / "study.json"), read_npz(folder / "runs.npz")
    try:
        settings: Settings = from_json(kind, record["settings"])
        shapes = shapes_of(settings)
        arrays = {name: stored[name] for name in shapes}
        for name, shape in shapes.items():
            if arrays[name].shape != shape:
                raise ValueError(f"{name} of shape {arrays[name].shape}, the settings require {shape}")
        return settings, arrays, Effort(record["minutes"], record["cpu_minutes"])
    except (KeyError, TypeError, ValueError) as error:
        raise DataError(folder, f"is not a study of this version ({error}); run the study again") from error
