"""Where the values of assets are: a pointer file an asset (and partition) to the folder that it wrote."""

import pathlib
from typing import Any

import dagster as dg

from deltasafe.errors import DataError
from deltasafe.storage import read_json, write_json

__all__ = ["FolderPointers"]


class FolderPointers(dg.ConfigurableIOManager):
    """Assets write folders themselves, whole or not at all, and return the path; this remembers it.

    A pointer is replaced only after its folder is complete, so a reader sees the old version or the new one.
    A partitioned asset returns `dict[partition, path]` and is read in the same form; who reads it with the
    metadata `allow_missing_partitions` gets those that were made.
    """

    home: str

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
        pointer = {"folder": self._relative(folder), "run_id": run_id}
        for scope in {run_id, None}:
            write_json(self._pointer(asset_key, partition, scope), pointer)

    def load_input(self, context: dg.InputContext) -> Any:
        run_id = context.step_context.run_id
        if not context.has_asset_partitions:
            return self.folder(context.asset_key, run_id=run_id)
        keys = sorted(context.asset_partition_keys)
        if context.definition_metadata.get("allow_missing_partitions", False):
            keys = [key for key in keys if self._pointer(context.asset_key, key).is_file()]
        return {key: self.folder(context.asset_key, key, run_id) for key in keys}

    def folder(self, asset_key: dg.AssetKey, partition: str | None = None, run_id: str | None = None) -> pathlib.Path:
        """The folder that ``run_id`` made, if it made one, else the one that was last made by any run.

        So the steps of a run see what their own run made, whatever another run does meanwhile.

        Raises:
            DataError: there is none, or it was removed.
        """
        name = asset_key.to_user_string() + (f" [{partition}]" if partition else "")
        pointer = self._pointer(asset_key, partition, run_id)
        if run_id is None or not pointer.is_file():
            pointer = self._pointer(asset_key, partition)
        if not pointer.is_file():
            raise DataError(pointer, f"is missing: materialise {name} first")
        folder = pathlib.Path(self.home) / read_json(pointer)["folder"]
        if not folder.exists():
            raise DataError(folder, f"was removed: materialise {name} again")
        return folder

    def _pointer(self, asset_key: dg.AssetKey, partition: str | None, run_id: str | None = None) -> pathlib.Path:
        root = pathlib.Path(self.home, "pointers", *(("runs", run_id) if run_id else ("current",)))
        base = root.joinpath(*asset_key.path)
        return base / f"{partition}.json" if partition else base.with_suffix(".json")

    def _relative(self, folder: pathlib.Path) -> str:
        """Relative to the home where it lies below it, so that a home can be moved."""
        try:
            return folder.resolve().relative_to(pathlib.Path(self.home).resolve()).as_posix()
        except ValueError:
            return folder.resolve().as_posix()
