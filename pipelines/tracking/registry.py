"""The ensemble in use, and the commands that change it.

python -m pipelines.tracking.registry list                            versions, newest first
python -m pipelines.tracking.registry promote VERSION --because TEXT  use a version
python -m pipelines.tracking.registry rollback [--because TEXT]       use the previous version again
python -m pipelines.tracking.registry replay                          send the MLflow calls that are pending
"""

import argparse
import pathlib
import re
import shutil
import sys
from typing import Any

from deltasafe.errors import DataError
from deltasafe.io.storage import atomic_folder, read_json, write_json
from pipelines.command_line import run_command
from pipelines.home import prepare_home, tracking_uri
from pipelines.tracking.model_versions import DEMOTED_TAG
from pipelines.tracking.tracker import MlflowTracker, is_reachable

_DECISION_TAGS = ("promoted", "refused", DEMOTED_TAG)


class EnsembleRegistry:
    """The alias `champion` of the registered model, and a copy of it in ``champion.json`` below the home.

    The registry decides. The copy decides while calls of this home are pending or MLflow is away.

    Args:
        tracker: the tracker of the same home.
    """

    def __init__(self, tracker: MlflowTracker) -> None:
        self.tracker = tracker
        self._copy = tracker.home / "champion.json"

    def champion(self) -> pathlib.Path | None:
        """Return the folder of the ensemble in use, downloaded if it is missing here; None if there is none yet."""
        self.tracker.replay()
        noted = read_json(self._copy)["artifact"] if self._copy.is_file() else None
        if not self._is_behind():
            with self.tracker.records() as records:
                version = records.champion()
                if version is not None:
                    return _frozen_folder(version, self.tracker.home)
        return None if noted is None else self.tracker.home / "frozen" / noted

    def demotion_reason(self, folder: pathlib.Path) -> str:
        """Return why a person demoted the ensemble ``folder``; empty if it was not demoted."""
        if self._is_behind():
            return ""
        with self.tracker.records() as records:
            version = records.version_of(folder.name)
        return "" if version is None else str(version.tags.get(DEMOTED_TAG, ""))

    def decide(self, folder: pathlib.Path, promoted: bool, reason: str) -> pathlib.Path:
        """Promote or refuse ``folder`` and record the reason; return the folder of the ensemble in use."""
        present = self.champion()
        if promoted or present is None:
            # if MLflow is away, it may have a champion that is not known here
            is_guess = present is None and self._is_behind()
            self.tracker.call("promote", artifact=folder.name, because=reason, only_as_first=is_guess)
            self._write_copy(folder.name, reason)
            return folder
        self.tracker.call("refuse", artifact=folder.name, because=reason)
        return present

    def versions(self) -> list[Any]:
        """Return all versions, newest first."""
        with self.tracker.records() as records:
            return records.versions()

    def promote(self, number: str, because: str) -> pathlib.Path:
        """Use a version, as decided by a person; return its folder.

        Raises:
            DataError: the version does not exist, or its artifact is missing.
        """
        version = next((each for each in self.versions() if str(each.version) == number), None)
        if version is None:
            raise DataError(tracking_uri(self.tracker.home), f"has no version {number}; `make registry` lists them")
        folder = _frozen_folder(version, self.tracker.home)
        self.tracker.call("promote", artifact=folder.name, because=because)
        self._write_copy(folder.name, because)
        return folder

    def rollback(self, because: str) -> pathlib.Path:
        """Use the previous version again, and demote the present one: only a person can promote it again.

        Nothing changes if the previous version cannot be used. Deleted versions are skipped.

        Raises:
            DataError: there is no previous version, or its artifact is missing.
        """
        with self.tracker.records() as records:
            history, present = records.history(), records.champion()
            versions = {str(version.version): version for version in records.versions()}
        earlier = [
            number for number in history if number in versions and number != str(getattr(present, "version", ""))
        ]
        if not earlier or present is None:
            raise DataError(
                tracking_uri(self.tracker.home), "knows no ensemble that was in use before; `make registry` lists all"
            )
        _frozen_folder(versions[earlier[-1]], self.tracker.home)
        self.tracker.call("demote", artifact=present.tags["artifact"], because=because)
        return self.promote(earlier[-1], f"rolled back from version {present.version}: {because}")

    def _is_behind(self) -> bool:
        """Return whether the registry lacks calls of this home, or is away."""
        return bool(self.tracker.pending.files()) or not is_reachable(tracking_uri(self.tracker.home))

    def _write_copy(self, artifact: str, because: str) -> None:
        write_json(self._copy, {"artifact": artifact, "because": because})


def main(arguments: list[str] | None = None) -> int:
    """Run a command of the registry; return the exit status."""
    parser = argparse.ArgumentParser(
        prog="python -m pipelines.tracking.registry", description=__doc__.partition("\n")[0]
    )
    commands = parser.add_subparsers(dest="command", required=True)
    commands.add_parser("list", help="list the versions, newest first")
    promote = commands.add_parser("promote", help="use a version")
    promote.add_argument("version")
    promote.add_argument("--because", required=True, help="reason, stored with the version")
    rollback = commands.add_parser("rollback", help="use the previous version again")
    rollback.add_argument("--because", default="no reason given", help="reason, stored with the version")
    commands.add_parser("replay", help="send the MLflow calls that are pending")
    options = parser.parse_args(arguments)
    return run_command(lambda: _run(options))


def _run(options: argparse.Namespace) -> int:
    registry = EnsembleRegistry(MlflowTracker(prepare_home()))
    registry.tracker.replay()
    uri = tracking_uri(registry.tracker.home)
    if not is_reachable(uri):
        print(f"MLflow cannot be reached at {uri}; nothing was changed", file=sys.stderr)
        return 1
    if options.command == "promote":
        _report_to_dagster(registry, registry.promote(options.version, options.because), options.because)
    elif options.command == "rollback":
        _report_to_dagster(registry, registry.rollback(options.because), f"rolled back: {options.because}")
    _print(registry)
    return 0


def _report_to_dagster(registry: EnsembleRegistry, folder: pathlib.Path, because: str) -> None:
    """Report a new version of the asset `champion`, so that downstream assets become stale."""
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
    for version in registry.versions():
        decisions = [f"{tag.replace('_', ' ')}: {version.tags[tag]}" for tag in _DECISION_TAGS if tag in version.tags]
        aliases = ", ".join(sorted(version.aliases))
        print(f"{version.version:>4}  {aliases:<11} {version.tags.get('artifact', '?')}  {'; '.join(decisions)}")
    if pending := registry.tracker.pending.files():
        print(f"{len(pending)} calls are pending in {registry.tracker.pending.folder}")


def _frozen_folder(version: Any, home: pathlib.Path) -> pathlib.Path:
    """Return the frozen folder of a version; if it is missing here, download and verify it.

    Raises:
        DataError: another project registered the version, or its artifact is missing or damaged.
    """
    import mlflow

    from deltasafe.perception.artifact.frozen_ensemble import artifact_name, verify_artifact

    name = version.tags.get("artifact", "")
    folder = home / "frozen" / name
    if not re.fullmatch(r"ensemble-[0-9a-f]{16}", name):
        raise DataError(f"version {version.version}", f"was not registered by this project (tag artifact: {name!r})")
    if not folder.is_dir():
        with atomic_folder(folder) as temporary:
            download = temporary / "download"  # without dst_path, a registry in files returns its own files
            download.mkdir()
            artifact = f"models:/{version.name}/{version.version}/artifacts/{name}"
            try:
                fetched = mlflow.artifacts.download_artifacts(artifact, dst_path=str(download))
            except (mlflow.MlflowException, OSError) as error:
                if not is_reachable(tracking_uri(home)):
                    raise
                raise DataError(
                    folder, f"is missing, and so is its copy in MLflow ({error}); freeze it again, or use another one"
                ) from error
            for path in pathlib.Path(fetched).iterdir():
                path.replace(temporary / path.name)
            shutil.rmtree(download)
            verify_artifact(temporary)
            if artifact_name(temporary) != name:
                raise DataError(f"version {version.version}", f"contains {artifact_name(temporary)}, not {name}")
    return folder


if __name__ == "__main__":
    sys.exit(main())
