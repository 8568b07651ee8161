"""Where the values of assets are: a pointer an asset (and partition) to the folder that it wrote."""

import pathlib
from typing import Any

import dagster as dg

from deltasafe.compute.parent_watchdog import end_with_parent
from pipelines.storage.artifact_store import Places, places_of

__all__ = ["FolderPointers"]


class FolderPointers(dg.ConfigurableIOManager):
    """Assets write folders themselves, whole or not at all, and return the path; this remembers it.

    A pointer is replaced only after its folder is complete, so a reader sees the old version or the new one.
    A partitioned asset returns `dict[partition, path]` and is read in the same form; who reads it with the
    metadata `allow_missing_partitions` gets those that were made. Where `$DELTASAFE_STORE` is set, folders are uploaded
    before they are pointed at, and fetched where they are read.
    """

    home: str

    def setup_for_execution(self, context: dg.InitResourceContext) -> None:
        """Every step comes by here: its process must not outlive that of its run."""
        end_with_parent()

    def handle_output(self, context: dg.OutputContext, obj: Any) -> None:
        if obj is None:
            return
        by_partition = obj if isinstance(obj, dict) else {None: obj}
        for partition, folder in by_partition.items():
            self.point(context.asset_key, pathlib.Path(folder), partition, context.run_id)

    def point(
        self, asset_key: dg.AssetKey, folder: pathlib.Path, partition: str | None = None, run_id: str | None = None
    ) -> None:
        """Remember ``folder`` as the value of an asset, as made by ``run_id`` or by a person."""
        places = self._places()
        pointer = {**places.put(folder), "run_id": run_id}
        for scope in dict.fromkeys((run_id, None)):
            places.write(_pointer(asset_key, partition, scope), pointer)

    def load_input(self, context: dg.InputContext) -> Any:
        run_id = context.step_context.run_id
        if not context.has_asset_partitions:
            return self.folder(context.asset_key, run_id=run_id)
        keys = sorted(context.asset_partition_keys)
        if context.definition_metadata.get("allow_missing_partitions", False):
            places = self._places()
            keys = [key for key in keys if places.read(_pointer(context.asset_key, key)) is not None]
        return {key: self.folder(context.asset_key, key, run_id) for key in keys}

    def folder(self, asset_key: dg.AssetKey, partition: str | None = None, run_id: str | None = None) -> pathlib.Path:
        """The folder that ``run_id`` made, if it made one, else the one that was last made by any run.

        So the steps of a run see what their own run made, whatever another run does meanwhile.

        Raises:
            DataError: there is none, or it was removed.
        """
        name = asset_key.to_user_string() + (f" [{partition}]" if partition else "")
        places, current = self._places(), _pointer(asset_key, partition)
        entry = places.read(_pointer(asset_key, partition, run_id)) if run_id else None
        entry = entry or places.read(current)
        if entry is None:
            raise places.missing(current, f"is missing: materialize {name} first")
        return places.take(entry, f"materialize {name} again")

    def _places(self) -> Places:
        return places_of(pathlib.Path(self.home))


def _pointer(asset_key: dg.AssetKey, partition: str | None, run_id: str | None = None) -> str:
    scope = ("runs", run_id) if run_id else ("current",)
    return "/".join((*scope, *asset_key.path, *((partition,) if partition else ())))
