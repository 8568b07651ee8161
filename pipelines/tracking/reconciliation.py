"""Let Dagster and the note of the home follow the registry, in which a person may have decided."""

import pathlib
from typing import Any

import dagster as dg

from deltasafe.errors import DataError
from pipelines.storage.io_manager import FolderPointers
from pipelines.tracking.registry import EnsembleRegistry

_CHAMPION = dg.AssetKey("champion")


def reconcile(registry: EnsembleRegistry, instance: dg.DagsterInstance) -> list[str]:
    """Report the ensemble in use to Dagster if Dagster uses another one; return what differed, one sentence each.

    The alias in MLflow decides. It is not followed while calls of this home are pending.
    """
    pointers = FolderPointers(home=str(registry.tracker.home))
    try:
        pointed = pointers.folder(_CHAMPION, instance=instance).name
    except DataError:
        pointed = ""
    try:
        folder = registry.champion()
    except DataError as error:
        return [f"{error}{f'; Dagster still uses {pointed}' if pointed else ''}"]
    if folder is None or folder.name == pointed or registry.is_behind():
        return []
    if not pointed:
        return [f"Dagster has no champion, MLflow has {folder.name}: materialize `champion`"]
    _report(instance, pointers, folder)
    return [f"MLflow has the alias champion on {folder.name}; Dagster used {pointed}, and now follows"]


def _report(instance: dg.DagsterInstance, pointers: FolderPointers, folder: pathlib.Path) -> None:
    """Report a new version of the asset `champion`, so that downstream assets become stale."""
    pointers.point(_CHAMPION, folder)
    metadata: dict[str, Any] = {
        "ensemble": folder.name,
        "reason": "decided by hand",
        "folder": dg.MetadataValue.path(str(folder)),
    }
    tags = {"dagster/data_version": folder.name}
    instance.report_runless_asset_event(dg.AssetMaterialization(_CHAMPION, metadata=metadata, tags=tags))
