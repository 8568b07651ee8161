"""Where folders are and what refers to them: below the home alone, or in a store that several homes share."""

import logging
import pathlib
from typing import Any, Protocol

from deltasafe.errors import DataError
from deltasafe.io.locks import FileLock
from deltasafe.io.storage import read_json, write_json
from pipelines.home import DATASETS
from pipelines.storage.shared_store import (
    ObjectError,
    SharedStore,
    StoreAwayError,
    chosen_store,
    digest_of_manifest,
    manifest_of_folder,
)

__all__ = ["Places", "places_of"]

_log = logging.getLogger("deltasafe.store")

Entry = dict[str, Any]

_MADE = ("store", "frozen")
"""Folders of the home that only this project writes to; what is changed there may be replaced by what was published."""


class Places(Protocol):
    """What the I/O manager asks for: entries by name, and the folders that entries tell of."""

    def read(self, name: str) -> Entry | None:
        """An entry; None if there is none."""

    def write(self, name: str, entry: Entry) -> None:
        """Replace an entry in one step."""

    def put(self, folder: pathlib.Path) -> Entry:
        """Make a complete folder available to whoever reads the entry."""

    def take(self, entry: Entry, again: str) -> pathlib.Path:
        """The folder of an entry, on this machine; ``again`` says what to do if it is gone."""

    def recall(self, folder: pathlib.Path) -> None:
        """Bring a folder that was made elsewhere, if it is not here and there is one."""

    def missing(self, name: str, reason: str) -> DataError:
        """What to raise if an entry that is needed is not there."""


class HomePlaces:
    """Below the home, and nowhere else."""

    def __init__(self, home: pathlib.Path) -> None:
        self.home = home

    def read(self, name: str) -> Entry | None:
        path = self._path(name)
        if not path.is_file():
            return None
        entry: Entry = read_json(path)
        return entry

    def write(self, name: str, entry: Entry) -> None:
        write_json(self._path(name), entry)

    def put(self, folder: pathlib.Path) -> Entry:
        """Relative to the home where it lies below it, so that a home can be moved."""
        try:
            return {"folder": folder.resolve().relative_to(self.home.resolve()).as_posix()}
        except ValueError:
            return {"folder": folder.resolve().as_posix()}

    def take(self, entry: Entry, again: str) -> pathlib.Path:
        folder = self.home / entry["folder"]
        if not folder.exists():
            raise DataError(folder, f"was removed: {again}")
        return folder

    def recall(self, folder: pathlib.Path) -> None:
        """There is no elsewhere."""

    def missing(self, name: str, reason: str) -> DataError:
        return DataError(self._path(name), reason)

    def _path(self, name: str) -> pathlib.Path:
        return self.home / "pointers" / f"{name}.json"


class SharedPlaces:
    """In the store; the home keeps what was made or fetched here.

    Folders of the home have the same name on every machine. Packaged inputs are everywhere and are told by their name
    and digest; all other folders are somebody else's (images of a user, or watched): they are copied, and read below
    ``inputs/``.
    """

    def __init__(self, home: pathlib.Path, store: SharedStore) -> None:
        self.home, self.store = home, store

    def read(self, name: str) -> Entry | None:
        return self.store.read_json(f"pointers/{name}.json")

    def write(self, name: str, entry: Entry) -> None:
        self.store.write_json(f"pointers/{name}.json", entry)

    def put(self, folder: pathlib.Path) -> Entry:
        whole = folder.resolve()
        if whole.is_relative_to(DATASETS):
            digest = digest_of_manifest(manifest_of_folder(whole))
            return {"packaged": whole.relative_to(DATASETS).as_posix(), "manifest": digest}
        if any(whole.is_relative_to(self.home.resolve() / made) for made in _MADE):
            name = whole.relative_to(self.home.resolve()).as_posix()
        else:
            name = f"inputs/{folder.name}-{digest_of_manifest(manifest_of_folder(whole))[:16]}"
        return {"folder": name, "manifest": self.store.publish(whole, name)}

    def take(self, entry: Entry, again: str) -> pathlib.Path:
        if "packaged" in entry:
            packaged: pathlib.Path = DATASETS / entry["packaged"]
            if not _is(packaged, entry["manifest"]):
                raise DataError(packaged, "differs from that of the machine which used it; use the same version there")
            return packaged
        folder = self.home / entry["folder"]
        if not any(folder.resolve().is_relative_to(self.home.resolve() / made) for made in (*_MADE, "inputs")):
            place = f"{self.store.address}/pointers"
            raise ObjectError(place, f"lead to {entry['folder']}, where nothing is ever put; {again}")
        self._bring(entry["manifest"], folder)
        return folder

    def recall(self, folder: pathlib.Path) -> None:
        if folder.exists():
            return
        try:
            digest = self.store.published(folder.relative_to(self.home).as_posix())
            if digest is not None:
                self._bring(digest, folder)
        except (ObjectError, StoreAwayError) as error:  # then it is made once more
            _log.warning("%s", error)

    def missing(self, name: str, reason: str) -> DataError:
        return ObjectError(f"{self.store.address}/pointers/{name}.json", reason)

    def _bring(self, digest: str, folder: pathlib.Path) -> None:
        with FileLock(self.home / "locks" / digest):
            if not _is(folder, digest):
                _log.info("fetching %s from %s", folder.name, self.store.address)
                self.store.fetch(digest, folder)


def places_of(home: pathlib.Path) -> Places:
    """For a home: shared if `$DELTASAFE_STORE` is set."""
    store = chosen_store()
    return HomePlaces(home) if store is None else SharedPlaces(home, store)


def _is(folder: pathlib.Path, digest: str) -> bool:
    return folder.is_dir() and digest_of_manifest(manifest_of_folder(folder)) == digest
