"""Folders in an object store, or in anything else that fsspec reaches; for teams, chosen by `$DELTASAFE_STORE`.

blobs/01/0123...       bytes of a file, named by their SHA-256: none is sent twice, and an interrupted upload goes on
manifests/4567...json  names, sizes and digests of a folder's files, named by its own SHA-256
folders/NAME.json      the manifest of the folder with that name, as last published
pointers/...           what the I/O manager remembers

Objects are written in this order, so that whatever can be found is complete. The only module that imports fsspec.
"""

import concurrent.futures
import functools
import hashlib
import json
import os
import pathlib
import shutil
from collections.abc import Callable, Iterable
from typing import Any, TypeVar

from deltasafe.errors import DataError, DeltasafeError, SettingsError
from deltasafe.io.storage import atomic_file, atomic_folder, parse_json, sha256_of_file

__all__ = [
    "STORE_VARIABLE",
    "ObjectError",
    "SharedStore",
    "StoreAwayError",
    "chosen_store",
    "digest_of_manifest",
    "manifest_of_folder",
]

STORE_VARIABLE = "DELTASAFE_STORE"

_ATTEMPTS = 6
_FIRST_WAIT_S, _LONGEST_WAIT_S = 0.5, 10.0
_AT_ONCE = 8
_FOR_GOOD = (FileNotFoundError, PermissionError, IsADirectoryError, NotADirectoryError, DeltasafeError, TypeError)

T = TypeVar("T")
Manifest = dict[str, Any]


class ObjectError(DataError):
    """An object of the store is missing or damaged.

    Attributes:
        address: of the object.
    """

    def __init__(self, address: str, reason: str) -> None:
        super().__init__(address, reason)
        self.address = address
        self.args = (f"{address}: {reason}",)

    def __reduce__(self) -> tuple[type, tuple[Any, ...]]:
        return type(self), (self.address, self.reason)


class StoreAwayError(DeltasafeError, OSError):
    """The store does not answer, or refuses; what it held before is as it was."""


class SharedStore:
    """A place below an address of fsspec, e.g. ``s3://bucket/prefix``, ``file:///mnt/team`` or ``memory://test``.

    Keys and endpoints are taken from the environment, as the library behind the protocol does. What fails by chance is
    tried again, six times in about 15 seconds.

    Args:
        address: without any secret in it, since errors name it.

    Raises:
        SettingsError: nothing is installed that could reach such an address.
    """

    def __init__(self, address: str) -> None:
        self.address = address.rstrip("/")
        try:
            import tenacity  # noqa: F401
            from fsspec.core import url_to_fs

            # attempts are counted here; an endpoint that is not there is said after seconds
            once = {"retries": {"max_attempts": 1}, "connect_timeout": 5, "read_timeout": 60}
            options = {"config_kwargs": once, "use_listings_cache": False} if address.startswith("s3") else {}
            self._files, self._root = url_to_fs(self.address, **options)
        except (ImportError, ValueError) as error:
            raise SettingsError(f"{STORE_VARIABLE}={address} cannot be used ({error}); run: make team") from error

    def publish(self, folder: pathlib.Path, name: str) -> str:
        """Upload a complete folder, and let it be found by its name; returns the digest of its manifest.

        Raises:
            StoreAwayError: it could not be uploaded; nothing refers to what was.
        """
        manifest = manifest_of_folder(folder)
        self._each(lambda item: self._send(folder / item[0], item[1]), manifest["files"].items())
        text = _text_of(manifest)
        digest = hashlib.sha256(text).hexdigest()
        self._write(f"manifests/{digest}.json", text)
        self.write_json(f"folders/{name}.json", {"manifest": digest})
        return digest

    def published(self, name: str) -> str | None:
        """Digest of the manifest of the folder that was last published under ``name``."""
        found = self.read_json(f"folders/{name}.json")
        return None if found is None else str(found["manifest"])

    def fetch(self, digest: str, destination: pathlib.Path) -> None:
        """The folder with that manifest, written whole or not at all, every file of it verified.

        Raises:
            ObjectError: an object is missing or damaged.
            StoreAwayError: the store does not answer.
        """
        manifest = self._manifest(digest)
        with atomic_folder(destination) as temporary:
            for name in manifest["folders"]:
                _inside(temporary, name).mkdir(parents=True, exist_ok=True)
            self._each(lambda item: self._receive(item[1], _inside(temporary, item[0])), manifest["files"].items())

    def read_json(self, name: str) -> Any | None:
        """A small object; None if there is none.

        Raises:
            ObjectError: it is not JSON.
        """
        data = self._read(name)
        try:
            return None if data is None else parse_json(data)
        except ValueError as error:
            raise ObjectError(
                self._shown(name), f"is not valid JSON ({error}); materialize again what it is of"
            ) from error

    def write_json(self, name: str, value: Any) -> None:
        """A small object, replaced in one step."""
        self._write(name, _text_of(value))

    def _manifest(self, digest: str) -> Manifest:
        name = f"manifests/{digest}.json"
        data = self._read(name)
        if data is None or hashlib.sha256(data).hexdigest() != digest:
            raise ObjectError(self._shown(name), f"is {'missing' if data is None else 'damaged'}; {_REMEDY}")
        manifest: Manifest = parse_json(data)
        return manifest

    def _send(self, path: pathlib.Path, entry: Manifest) -> None:
        name = _blob(entry["sha256"])
        if self._size(name) != entry["bytes"]:
            self._tried(name, lambda: self._put(path, self._place(name)))

    def _put(self, path: pathlib.Path, place: str) -> None:
        from fsspec.implementations.local import LocalFileSystem

        if isinstance(self._files, LocalFileSystem):  # which would write in place
            with atomic_file(place) as temporary:
                shutil.copyfile(path, temporary)
        else:
            self._files.put_file(str(path), place)

    def _receive(self, entry: Manifest, path: pathlib.Path) -> None:
        name = _blob(entry["sha256"])
        path.parent.mkdir(parents=True, exist_ok=True)
        try:
            self._tried(name, lambda: self._files.get_file(self._place(name), str(path)))
        except FileNotFoundError:
            raise ObjectError(self._shown(name), f"is missing; {_REMEDY}") from None
        if sha256_of_file(path) != entry["sha256"]:
            raise ObjectError(self._shown(name), f"is damaged; remove it, and {_REMEDY}")

    def _size(self, name: str) -> int | None:
        try:
            return int(self._tried(name, lambda: self._files.info(self._place(name)))["size"])
        except FileNotFoundError:
            return None

    def _read(self, name: str) -> bytes | None:
        try:
            data: bytes = self._tried(name, lambda: self._files.cat_file(self._place(name)))
        except FileNotFoundError:
            return None
        return data

    def _write(self, name: str, data: bytes) -> None:
        from fsspec.implementations.local import LocalFileSystem

        def write() -> None:
            if isinstance(self._files, LocalFileSystem):
                with atomic_file(self._place(name)) as temporary:
                    temporary.write_bytes(data)
            else:
                self._files.pipe_file(self._place(name), data)

        self._tried(name, write)

    def _tried(self, name: str, call: Callable[[], T]) -> T:
        import tenacity

        attempts = tenacity.Retrying(
            stop=tenacity.stop_after_attempt(_ATTEMPTS),
            wait=tenacity.wait_exponential(_FIRST_WAIT_S, _LONGEST_WAIT_S) + tenacity.wait_random(0, _FIRST_WAIT_S),
            retry=tenacity.retry_if_not_exception_type(_FOR_GOOD),
            reraise=True,
        )
        try:
            return attempts(call)
        except (FileNotFoundError, DeltasafeError):
            raise
        except Exception as error:  # of whichever library is behind the protocol
            why = f"{type(error).__name__}: {error}".rstrip(": ")
            raise StoreAwayError(
                f"{self._shown(name)} cannot be reached ({why}); is the store there, and may these keys use it?"
            ) from error

    def _each(self, do: Callable[[Any], None], items: Iterable[Any]) -> None:
        with concurrent.futures.ThreadPoolExecutor(_AT_ONCE) as pool:
            begun = [pool.submit(do, item) for item in items]
            try:
                for one in begun:
                    one.result()
            finally:
                pool.shutdown(cancel_futures=True)

    def _place(self, name: str) -> str:
        return f"{self._root}/{name}"

    def _shown(self, name: str) -> str:
        return f"{self.address}/{name}"


def chosen_store() -> SharedStore | None:
    """The store that `$DELTASAFE_STORE` names, once a process; None if it is not set."""
    address = os.environ.get(STORE_VARIABLE)
    return _opened(address, os.getpid()) if address else None


@functools.lru_cache(maxsize=4)
def _opened(address: str, pid: int) -> SharedStore:
    return SharedStore(address)


def manifest_of_folder(folder: pathlib.Path) -> Manifest:
    """Names, sizes and digests of the files of a folder, without hidden ones; and the names of its folders.

    Raises:
        DataError: it is no folder, or has a link to a folder in it, which would be followed by some and not by others.
    """
    if not folder.is_dir():
        raise DataError(folder, "is no folder, and only folders are shared")
    files, folders = {}, []
    for path in sorted(folder.rglob("*")):
        name = path.relative_to(folder)
        if any(part.startswith(".") for part in name.parts):
            continue
        if path.is_dir():
            if path.is_symlink():
                raise DataError(path, "is a link to a folder; put the folder itself there")
            folders.append(name.as_posix())
        else:
            files[name.as_posix()] = {"sha256": sha256_of_file(path), "bytes": path.stat().st_size}
    return {"files": files, "folders": folders}


def digest_of_manifest(manifest: Manifest) -> str:
    """The name under which `SharedStore` keeps it."""
    return hashlib.sha256(_text_of(manifest)).hexdigest()


def _text_of(value: Any) -> bytes:
    return json.dumps(value, sort_keys=True, separators=(",", ":"), allow_nan=False).encode() + b"\n"


def _blob(digest: str) -> str:
    return f"blobs/{digest[:2]}/{digest}"


def _inside(folder: pathlib.Path, name: str) -> pathlib.Path:
    parts = pathlib.PurePosixPath(name)
    if parts.is_absolute() or ".." in parts.parts:
        raise DataError(folder / name, "would lie outside its folder; the manifest was made by somebody else")
    return folder / name


_REMEDY = "restore it from a backup, or materialize again what it belongs to"
