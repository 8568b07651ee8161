"""Which frozen ensemble is in use, and the commands of whoever decides about it.

python -m pipelines.tracking.registry list                            versions, newest first
python -m pipelines.tracking.registry promote VERSION --because TEXT  put a version in use by hand
python -m pipelines.tracking.registry rollback [--because TEXT]       back to the version that was in use before
python -m pipelines.tracking.registry replay                          record what could not be recorded while MLflow was away
"""

import argparse
import pathlib
import re
import shutil
import sys
from typing import Any

from deltasafe.errors import DataError
from deltasafe.io.storage import read_json, write_json
from pipelines.home import prepare_home, tracking_uri
from pipelines.tracking.tracker import MlflowTracker, is_reachable

__all__ = ["EnsembleRegistry", "main"]


class EnsembleRegistry:
    """The alias `champion` of the registered model, and a note of it below the home for when MLflow is away.

    The registry has the word. The note has it while decisions of this home still wait to be recorded there, or
    while nobody answers.

    Args:
        tracker: for the same home.
    """

    def __init__(self, tracker: MlflowTracker) -> None:
        self.tracker = tracker
        self._note = tracker.home / "champion.json"

    def champion(self) -> pathlib.Path | None:
        """Folder of the ensemble in use, fetched from the registry if it is not here; None if there is none yet."""
        self.tracker.replay()
        noted = read_json(self._note)["artifact"] if self._note.is_file() else None
        if not self._waits():
            with self.tracker.records() as records:
                version = records.champion()
                if version is not None:
                    return _folder_of(version, self.tracker.home)
        return None if noted is None else self.tracker.home / "frozen" / noted

    def objection(self, folder: pathlib.Path) -> str:
        """Why a person took the ensemble ``folder`` out of use; empty if nobody did."""
        if self._waits():
            return ""
        with self.tracker.records() as records:
            version = records.version_of(folder.name)
        return "" if version is None else str(version.tags.get("taken_out_of_use", ""))

    def decide(self, folder: pathlib.Path, promoted: bool, reason: str) -> pathlib.Path:
        """Put ``folder`` in use, or write down why not; returns the folder of the ensemble in use."""
        present = self.champion()
        if promoted or present is None:
            unseen = present is None and self._waits()  # a registry that is away may have a champion already
            self.tracker.call("promote", artifact=folder.name, because=reason, only_as_first=unseen)
            self._write_note(folder.name, reason)
            return folder
        self.tracker.call("refuse", artifact=folder.name, because=reason)
        return present

    def versions(self) -> list[Any]:
        """All versions, newest first."""
        with self.tracker.records() as records:
            return records.versions()

    def promote(self, number: str, because: str) -> pathlib.Path:
        """Put a version in use by hand.

        Raises:
            DataError: there is no such version, or it cannot be fetched.
        """
        version = next((found for found in self.versions() if str(found.version) == number), None)
        if version is None:
            raise DataError(tracking_uri(self.tracker.home), f"has no version {number}; `make registry` lists them")
        folder = _folder_of(version, self.tracker.home)
        self.tracker.call("promote", artifact=folder.name, because=because)
        self._write_note(folder.name, because)
        return folder

    def rollback(self, because: str) -> pathlib.Path:
        """Put in use again what was in use before; what is in use now is not promoted again but by hand.

        Raises:
            DataError: nothing was in use before.
        """
        with self.tracker.records() as records:
            history, present = records.history(), records.champion()
        earlier = [number for number in history if present is None or number != str(present.version)]
        if not earlier or present is None:
            raise DataError(tracking_uri(self.tracker.home), "knows no ensemble that was in use before this one")
        self.tracker.call("take_out", artifact=present.tags["artifact"], because=because)
        return self.promote(earlier[-1], f"rolled back from version {present.version}: {because}")

    def _waits(self) -> bool:
        return bool(self.tracker.pending.files()) or not is_reachable(tracking_uri(self.tracker.home))

    def _write_note(self, artifact: str, because: str) -> None:
        write_json(self._note, {"artifact": artifact, "because": because})


def main(arguments: list[str] | None = None) -> int:
    """0 if it could be done."""
    parser = argparse.ArgumentParser(
        prog="python -m pipelines.tracking.registry", description=__doc__.partition("\n")[0]
    )
    commands = parser.add_subparsers(dest="command", required=True)
    commands.add_parser("list", help="versions, newest first")
    promote = commands.add_parser("promote", help="put a version in use by hand")
    promote.add_argument("version")
    promote.add_argument("--because", required=True, help="stands on the version from now on")
    rollback = commands.add_parser("rollback", help="back to the version that was in use before")
    rollback.add_argument("--because", default="no reason given", help="stands on the version from now on")
    commands.add_parser("replay", help="record what could not be recorded while MLflow was away")
    options = parser.parse_args(arguments)
    registry = EnsembleRegistry(MlflowTracker(prepare_home()))
    registry.tracker.replay()
    if not is_reachable(tracking_uri(registry.tracker.home)):
        print(f"Nobody answers at {tracking_uri(registry.tracker.home)}; nothing was changed.", file=sys.stderr)
        return 1
    try:
        if options.command == "promote":
            _use(registry, registry.promote(options.version, options.because), options.because)
        elif options.command == "rollback":
            _use(registry, registry.rollback(options.because), f"rolled back: {options.because}")
    except DataError as error:
        print(error, file=sys.stderr)
        return 1
    _print(registry)
    return 0


def _use(registry: EnsembleRegistry, folder: pathlib.Path, because: str) -> None:
    """Dagster hears of it as a new version of the asset `champion`, so that what follows can be made again."""
    import dagster as dg

    from pipelines.storage.io_manager import FolderPointers

    key = dg.AssetKey("champion")
    FolderPointers(home=str(registry.tracker.home)).point(key, folder)
    event = dg.AssetMaterialization(
        key,
        metadata={"ensemble": folder.name, "reason": because, "folder": dg.MetadataValue.path(str(folder))},
        tags={"dagster/data_version": folder.name},
    )
    with dg.DagsterInstance.get() as instance:
        instance.report_runless_asset_event(event)


def _print(registry: EnsembleRegistry) -> None:
    for found in registry.versions():
        story = [f"{tag.replace('_', ' ')}: {found.tags[tag]}" for tag in _STORY if tag in found.tags]
        aliases = ", ".join(sorted(found.aliases))
        print(f"{found.version:>4}  {aliases:<11} {found.tags.get('artifact', '?')}  {'; '.join(story)}")
    if waiting := registry.tracker.pending.files():
        print(f"{len(waiting)} calls wait in {registry.tracker.pending.folder}")


_STORY = ("promoted", "refused", "taken_out_of_use")


def _folder_of(version: Any, home: pathlib.Path) -> pathlib.Path:
    """The frozen folder of a version: where it was made, or fetched from the registry and verified."""
    import mlflow

    from deltasafe.io.storage import atomic_folder
    from deltasafe.perception.artifact.frozen_ensemble import artifact_name, verify_artifact

    name = version.tags.get("artifact", "")
    folder = home / "frozen" / name
    if not re.fullmatch(r"ensemble-[0-9a-f]{16}", name):
        raise DataError(f"version {version.version}", f"was not registered by this project (tag artifact: {name!r})")
    if not folder.is_dir():
        with atomic_folder(folder) as temporary:
            copy = temporary / "fetched"  # without a place of its own, a registry in files gives out its own ones
            copy.mkdir()
            model = f"models:/{version.name}/{version.version}"
            fetched = mlflow.artifacts.download_artifacts(f"{model}/artifacts/{name}", dst_path=str(copy))
            for path in pathlib.Path(fetched).iterdir():
                path.replace(temporary / path.name)
            shutil.rmtree(copy)
            verify_artifact(temporary)
            if artifact_name(temporary) != name:
                raise DataError(f"version {version.version}", f"holds {artifact_name(temporary)}, not {name}")
    return folder


if __name__ == "__main__":
    sys.exit(main())
