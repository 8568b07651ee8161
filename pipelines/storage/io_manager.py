"""The I/O manager: one pointer per asset (and partition) to the folder that the asset wrote."""

import os
import pathlib
from typing import Any

import dagster as dg

from deltasafe.compute.parent_watchdog import end_with_parent
from deltasafe.errors import DataError
from pipelines.home import DATABASE_VARIABLE
from pipelines.storage.artifact_store import ArtifactStore, artifact_store
from pipelines.storage.shared_store import STORE_VARIABLE


class FolderPointers(dg.ConfigurableIOManager):
    """Stores a pointer to the folder that an asset returns. Assets write their folders themselves, atomically.

    The pointer is replaced when the folder is complete, so a reader gets the old version or the new one.
    A partitioned asset returns a path for the partition of the run, or `dict[partition, path]`. Consumers get such a
    dictionary, or the path of the one partition of their run if their parameter is annotated with `pathlib.Path`. With
    the metadata `allow_missing_partitions`, they get the existing partitions only. With `$DELTASAFE_STORE`, folders
    are uploaded before the pointer is written, and downloaded when they are read.
    """

    home: str

    def setup_for_execution(self, context: dg.InitResourceContext) -> None:
        """Let the process of a step end with the process of its run. Every step initializes this resource."""
        end_with_parent()

    def handle_output(self, context: dg.OutputContext, obj: Any) -> None:
        if obj is None:
            return
        partition = context.asset_partition_key if context.has_asset_partitions and not isinstance(obj, dict) else None
        by_partition = obj if isinstance(obj, dict) else {partition: obj}
        for partition, folder in by_partition.items():
            self.point(context.asset_key, pathlib.Path(folder), partition, context.run_id)

    def point(
        self, asset_key: dg.AssetKey, folder: pathlib.Path, partition: str | None = None, run_id: str | None = None
    ) -> None:
        """Store ``folder`` as the value of an asset, made by the run ``run_id`` or by hand."""
        store = self._store()
        pointer = {**store.publish(folder), "run_id": run_id}
        for scope in dict.fromkeys((run_id, None)):
            store.write_pointer(_pointer_name(asset_key, partition, scope), pointer)

    def load_input(self, context: dg.InputContext) -> Any:
        """Return the folders of an input. What is missing now is missing in a minute, so there is no retry."""
        try:
            return self._load_input(context)
        except DataError as error:
            raise dg.Failure(str(error), allow_retries=False) from error

    def _load_input(self, context: dg.InputContext) -> Any:
        run_id, instance = context.step_context.run_id, context.step_context.instance
        if not context.has_asset_partitions:
            return self.folder(context.asset_key, run_id=run_id, instance=instance)
        keys = sorted(context.asset_partition_keys)
        if context.definition_metadata.get("allow_missing_partitions", False):
            store = self._store()
            keys = [key for key in keys if store.read_pointer(_pointer_name(context.asset_key, key)) is not None]
        folders = {key: self.folder(context.asset_key, key, run_id, instance) for key in keys}
        return folders[context.asset_partition_key] if context.dagster_type.typing_type is pathlib.Path else folders

    def folder(
        self,
        asset_key: dg.AssetKey,
        partition: str | None = None,
        run_id: str | None = None,
        instance: dg.DagsterInstance | None = None,
    ) -> pathlib.Path:
        """Return the folder that the run ``run_id`` made; otherwise the latest one.

        So the steps of a run read what their own run made, whatever parallel runs make. With ``instance``, an asset
        that was wiped there counts as never made.

        Raises:
            DataError: the asset was never made, or its folder was removed.
        """
        name = asset_key.to_user_string() + (f" [{partition}]" if partition else "")
        store, current = self._store(), _pointer_name(asset_key, partition)
        pointer = store.read_pointer(_pointer_name(asset_key, partition, run_id)) if run_id else None
        if pointer is None and not (instance and _is_wiped(instance, asset_key, partition)):
            pointer = store.read_pointer(current)
        if pointer is None:
            raise store.missing_pointer(current, f"is missing: materialize {name} first")
        return store.fetch(pointer, f"materialize {name} again")

    def _store(self) -> ArtifactStore:
        return artifact_store(pathlib.Path(self.home))


def _is_wiped(instance: dg.DagsterInstance, asset_key: dg.AssetKey, partition: str | None) -> bool:
    """Return whether a person wiped an asset in this instance and it was not materialized since.

    With a shared store but an own database, another machine may have made it again: then its pointer is used.
    """
    if os.environ.get(STORE_VARIABLE) and not os.environ.get(DATABASE_VARIABLE):
        return False
    wiped = dg.EventRecordsFilter(dg.DagsterEventType.ASSET_WIPED, asset_key)
    if not instance.event_log_storage.get_event_records(wiped, limit=1):
        return False
    if partition is not None:
        return partition not in instance.get_materialized_partitions(asset_key)
    return instance.get_latest_materialization_event(asset_key) is None


def _pointer_name(asset_key: dg.AssetKey, partition: str | None, run_id: str | None = None) -> str:
    scope = ("runs", run_id) if run_id else ("current",)
    return "/".join((*scope, *asset_key.path, *((partition,) if partition else ())))
