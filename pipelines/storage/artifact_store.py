"""The artifact store: where folders of assets are kept, and the pointers to them.

Without `$DELTASAFE_STORE`, both are below the home only; with it, several homes share them.
"""

import logging
import pathlib
from typing import Any

from deltasafe.errors import DataError
from deltasafe.io.locks import FileLock
from deltasafe.io.storage import read_json, write_json
from pipelines.home import DATASETS
from pipelines.storage.shared_store import (
    ObjectError,
    SharedStore,
    StoreAwayError,
    digest_of_manifest,
    manifest_of_folder,
    store_from_environment,
)

_log = logging.getLogger("deltasafe.store")

Pointer = dict[str, Any]

_MANAGED = ("store", "frozen")
"""Folders of the home that only this project writes to. If their content differs from the pointer, it is replaced."""


class ArtifactStore:
    """An artifact store below the home of one machine."""

    def __init__(self, home: pathlib.Path) -> None:
        self.home = home

    def read_pointer(self, name: str) -> Pointer | None:
        """Return a pointer; None if it does not exist."""
        path = self._pointer_file(name)
        return read_json(path) if path.is_file() else None

    def write_pointer(self, name: str, pointer: Pointer) -> None:
        """Replace a pointer atomically."""
        write_json(self._pointer_file(name), pointer)

    def publish(self, folder: pathlib.Path) -> Pointer:
        """Make a complete folder available to readers; return a pointer to it.

        Paths below the home and of packaged inputs are relative, so that home and checkout can be moved.
        """
        resolved = folder.resolve()
        for key, base in {"folder": self.home.resolve(), "packaged": DATASETS}.items():
            if resolved.is_relative_to(base):
                return {key: resolved.relative_to(base).as_posix()}
        return {"folder": resolved.as_posix()}

    def fetch(self, pointer: Pointer, remedy: str) -> pathlib.Path:
        """Return the folder of a pointer on this machine.

        Raises:
            DataError: the folder is missing or damaged; the message ends with ``remedy``.
        """
        folder: pathlib.Path = (
            DATASETS / pointer["packaged"] if "packaged" in pointer else self.home / pointer["folder"]
        )
        if not folder.exists():
            raise DataError(folder, f"was removed: {remedy}")
        return folder

    def restore(self, folder: pathlib.Path) -> None:
        """Fetch a folder that another machine has published, if it is missing here."""

    def missing_pointer(self, name: str, reason: str) -> DataError:
        """Create the error for a pointer that does not exist."""
        return DataError(self._pointer_file(name), reason)

    def _pointer_file(self, name: str) -> pathlib.Path:
        return self.home / "pointers" / f"{name}.json"


class SharedArtifactStore(ArtifactStore):
    """An artifact store in a `SharedStore`; the home caches the folders that were made or fetched there.

    Managed folders have the same name on every machine. A pointer to a packaged input consists of name and digest.
    Other folders (images of a user, watched folders) are copied, and fetched into ``inputs/``.
    """

    def __init__(self, home: pathlib.Path, store: SharedStore) -> None:
        super().__init__(home)
        self.store = store

    def read_pointer(self, name: str) -> Pointer | None:
        return self.store.read_json(f"pointers/{name}.json")

    def write_pointer(self, name: str, pointer: Pointer) -> None:
        self.store.write_json(f"pointers/{name}.json", pointer)

    def publish(self, folder: pathlib.Path) -> Pointer:
        resolved = folder.resolve()
        if resolved.is_relative_to(DATASETS):
            digest = digest_of_manifest(manifest_of_folder(resolved))
            return {"packaged": resolved.relative_to(DATASETS).as_posix(), "manifest": digest}
        if self._is_below(resolved, _MANAGED):
            name = resolved.relative_to(self.home.resolve()).as_posix()
        else:
            name = f"inputs/{folder.name}-{digest_of_manifest(manifest_of_folder(resolved))[:16]}"
        return {"folder": name, "manifest": self.store.publish(resolved, name)}

    def fetch(self, pointer: Pointer, remedy: str) -> pathlib.Path:
        if "packaged" in pointer:
            packaged: pathlib.Path = DATASETS / pointer["packaged"]
            if not _has_digest(packaged, pointer["manifest"]):
                raise DataError(packaged, "differs from that of the machine which used it; use the same version there")
            return packaged
        folder = self.home / pointer["folder"]
        if not self._is_below(folder.resolve(), (*_MANAGED, "inputs")):
            address = f"{self.store.address}/pointers"
            raise ObjectError(address, f"lead to {pointer['folder']}, where nothing is ever stored; {remedy}")
        self._download(pointer["manifest"], folder)
        return folder

    def restore(self, folder: pathlib.Path) -> None:
        if folder.exists():
            return
        try:
            digest = self.store.published(folder.relative_to(self.home).as_posix())
            if digest is not None:
                self._download(digest, folder)
        except (ObjectError, StoreAwayError) as error:  # then the caller makes the folder again
            _log.warning("%s", error)

    def missing_pointer(self, name: str, reason: str) -> DataError:
        return ObjectError(f"{self.store.address}/pointers/{name}.json", reason)

    def _is_below(self, folder: pathlib.Path, parents: tuple[str, ...]) -> bool:
        return any(folder.is_relative_to(self.home.resolve() / parent) for parent in parents)

    def _download(self, digest: str, folder: pathlib.Path) -> None:
        with FileLock(self.home / "locks" / digest):
            if not _has_digest(folder, digest):
                _log.info("fetching %s from %s", folder.name, self.store.address)
                self.store.fetch(digest, folder)


def artifact_store(home: pathlib.Path) -> ArtifactStore:
    """Return the artifact store of a home: shared if `$DELTASAFE_STORE` is set."""
    store = store_from_environment()
    return ArtifactStore(home) if store is None else SharedArtifactStore(home, store)


def _has_digest(folder: pathlib.Path, digest: str) -> bool:
    return folder.is_dir() and digest_of_manifest(manifest_of_folder(folder)) == digest
