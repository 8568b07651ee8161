"""Folders in an object store, or in any other storage that fsspec supports; `$DELTASAFE_STORE` holds its address.

blobs/01/0123...       content of a file, named by its SHA-256: never uploaded twice, so interrupted uploads resume
manifests/4567...json  names, sizes and digests of the files of a folder, named by the SHA-256 of the manifest
folders/NAME.json      the manifest of the latest folder of that name
pointers/...           pointers of the I/O manager

Objects are written in this order, so every object that can be found is complete. The only module that imports fsspec.
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
from deltasafe.io.folder_entries import is_clutter
from deltasafe.io.storage import atomic_file, atomic_folder, parse_json, sha256_of_file

STORE_VARIABLE = "DELTASAFE_STORE"

_ATTEMPTS = 6
_FIRST_WAIT_S, _LONGEST_WAIT_S = 0.5, 10.0
_THREADS = 8
_NOT_RETRIED = (FileNotFoundError, PermissionError, IsADirectoryError, NotADirectoryError, DeltasafeError, TypeError)
_REMEDY = "restore it from a backup, or materialize its asset again"

T = TypeVar("T")
Manifest = dict[str, Any]


class ObjectError(DataError):
    """An object of the store is missing or damaged.

    Attributes:
        address: address of the object.
    """

    def __init__(self, address: str, reason: str) -> None:
        super().__init__(address, reason)
        self.address = address
        self.args = (f"{address}: {reason}",)

    def __reduce__(self) -> tuple[type, tuple[Any, ...]]:
        return type(self), (self.address, self.reason)


class StoreAwayError(DeltasafeError, OSError):
    """The store does not answer, or denies access; its content is unchanged."""


class SharedStore:
    """A store at an address of fsspec, e.g. ``s3://bucket/prefix``, ``file:///mnt/team`` or ``memory://test``.

    The library behind the protocol reads keys and endpoints from the environment. Transient failures are retried: six
    attempts in about 15 seconds.

    Args:
        address: without secrets, because errors contain it.

    Raises:
        SettingsError: no installed library supports the address.
    """

    def __init__(self, address: str) -> None:
        self.address = address.rstrip("/")
        try:
            import tenacity  # noqa: F401
            from fsspec.core import url_to_fs

            # retries are done here, so that a missing endpoint is reported after seconds
            once = {"retries": {"max_attempts": 1}, "connect_timeout": 5, "read_timeout": 60}
            options = {"config_kwargs": once, "use_listings_cache": False} if address.startswith("s3") else {}
            self._files, self._root = url_to_fs(self.address, **options)
        except (ImportError, ValueError) as error:
            raise SettingsError(f"{STORE_VARIABLE}={address} cannot be used ({error}); run: make team") from error

    def publish(self, folder: pathlib.Path, name: str) -> str:
        """Upload a complete folder under a name; return the digest of its manifest.

        Raises:
            StoreAwayError: the upload failed; no manifest refers to the uploaded blobs.
        """
        manifest = manifest_of_folder(folder)
        self._in_parallel(lambda item: self._upload(folder / item[0], item[1]), manifest["files"].items())
        text = _encode(manifest)
        digest = hashlib.sha256(text).hexdigest()
        self._write(f"manifests/{digest}.json", text)
        self.write_json(f"folders/{name}.json", {"manifest": digest})
        return digest

    def published(self, name: str) -> str | None:
        """Return the manifest digest of the latest folder that was published under ``name``; None if there is none."""
        found = self.read_json(f"folders/{name}.json")
        return None if found is None else str(found["manifest"])

    def fetch(self, digest: str, destination: pathlib.Path) -> None:
        """Download the folder of a manifest, verify all files, and write it atomically.

        Raises:
            ObjectError: an object is missing or damaged.
            StoreAwayError: the store does not answer.
        """
        manifest = self._manifest(digest)
        with atomic_folder(destination) as temporary:
            for name in manifest["folders"]:
                _inside(temporary, name).mkdir(parents=True, exist_ok=True)
            self._in_parallel(
                lambda item: self._download(item[1], _inside(temporary, item[0])), manifest["files"].items()
            )

    def read_json(self, name: str) -> Any | None:
        """Read a JSON object; None if it does not exist.

        Raises:
            ObjectError: the object is not valid JSON.
        """
        data = self._read(name)
        try:
            return None if data is None else parse_json(data)
        except ValueError as error:
            reason = f"is not valid JSON ({error}); materialize its asset again"
            raise ObjectError(self._address(name), reason) from error

    def write_json(self, name: str, value: Any) -> None:
        """Replace a JSON object atomically."""
        self._write(name, _encode(value))

    def _manifest(self, digest: str) -> Manifest:
        name = f"manifests/{digest}.json"
        data = self._read(name)
        if data is None or hashlib.sha256(data).hexdigest() != digest:
            raise ObjectError(self._address(name), f"is {'missing' if data is None else 'damaged'}; {_REMEDY}")
        manifest: Manifest = parse_json(data)
        return manifest

    def _upload(self, path: pathlib.Path, entry: Manifest) -> None:
        name = _blob(entry["sha256"])
        if self._size(name) != entry["bytes"]:
            self._retry(name, lambda: self._put(path, self._path(name)))

    def _put(self, path: pathlib.Path, destination: str) -> None:
        from fsspec.implementations.local import LocalFileSystem

        if isinstance(self._files, LocalFileSystem):  # its own put is not atomic
            with atomic_file(destination) as temporary:
                shutil.copyfile(path, temporary)
        else:
            self._files.put_file(str(path), destination)

    def _download(self, entry: Manifest, path: pathlib.Path) -> None:
        name = _blob(entry["sha256"])
        path.parent.mkdir(parents=True, exist_ok=True)
        try:
            self._retry(name, lambda: self._files.get_file(self._path(name), str(path)))
        except FileNotFoundError:
            raise ObjectError(self._address(name), f"is missing; {_REMEDY}") from None
        if sha256_of_file(path) != entry["sha256"]:
            raise ObjectError(self._address(name), f"is damaged; remove it, and {_REMEDY}")

    def _size(self, name: str) -> int | None:
        try:
            return int(self._retry(name, lambda: self._files.info(self._path(name)))["size"])
        except FileNotFoundError:
            return None

    def _read(self, name: str) -> bytes | None:
        try:
            data: bytes = self._retry(name, lambda: self._files.cat_file(self._path(name)))
        except FileNotFoundError:
            return None
        return data

    def _write(self, name: str, data: bytes) -> None:
        from fsspec.implementations.local import LocalFileSystem

        def write() -> None:
            if isinstance(self._files, LocalFileSystem):
                with atomic_file(self._path(name)) as temporary:
                    temporary.write_bytes(data)
            else:
                self._files.pipe_file(self._path(name), data)

        self._retry(name, write)

    def _retry(self, name: str, call: Callable[[], T]) -> T:
        import tenacity

        attempts = tenacity.Retrying(
            stop=tenacity.stop_after_attempt(_ATTEMPTS),
            wait=tenacity.wait_exponential(_FIRST_WAIT_S, _LONGEST_WAIT_S) + tenacity.wait_random(0, _FIRST_WAIT_S),
            retry=tenacity.retry_if_not_exception_type(_NOT_RETRIED),
            reraise=True,
        )
        try:
            return attempts(call)
        except (FileNotFoundError, DeltasafeError):
            raise
        except Exception as error:  # each storage library has its own exceptions
            reason = f"{type(error).__name__}: {error}".rstrip(": ")
            raise StoreAwayError(
                f"{self._address(name)} cannot be reached ({reason}); check that the store runs and accepts the keys"
            ) from error

    def _in_parallel(self, call: Callable[[Any], None], items: Iterable[Any]) -> None:
        with concurrent.futures.ThreadPoolExecutor(_THREADS) as pool:
            futures = [pool.submit(call, item) for item in items]
            try:
                for future in futures:
                    future.result()
            finally:
                pool.shutdown(cancel_futures=True)

    def _path(self, name: str) -> str:
        return f"{self._root}/{name}"

    def _address(self, name: str) -> str:
        return f"{self.address}/{name}"


def store_from_environment() -> SharedStore | None:
    """Return the store of `$DELTASAFE_STORE`, opened once per process; None if the variable is not set."""
    address = os.environ.get(STORE_VARIABLE)
    return _opened(address, os.getpid()) if address else None


@functools.lru_cache(maxsize=4)
def _opened(address: str, pid: int) -> SharedStore:
    return SharedStore(address)


def manifest_of_folder(folder: pathlib.Path) -> Manifest:
    """Return names, sizes and digests of the files of a folder, and the names of its folders; hidden ones are skipped.

    Raises:
        DataError: ``folder`` is not a folder, or contains a link to a folder, which not all tools follow.
    """
    if not folder.is_dir():
        raise DataError(folder, "is not a folder, and only folders are shared")
    files, folders = {}, []
    for path in sorted(folder.rglob("*")):
        name = path.relative_to(folder)
        if is_clutter(*name.parts):
            continue
        if path.is_dir():
            if path.is_symlink():
                raise DataError(path, "is a link to a folder; replace it by the folder itself")
            folders.append(name.as_posix())
        else:
            files[name.as_posix()] = {"sha256": sha256_of_file(path), "bytes": path.stat().st_size}
    return {"files": files, "folders": folders}


def digest_of_manifest(manifest: Manifest) -> str:
    """Return the digest under which a `SharedStore` keeps a manifest."""
    return hashlib.sha256(_encode(manifest)).hexdigest()


def _encode(value: Any) -> bytes:
    return json.dumps(value, sort_keys=True, separators=(",", ":"), allow_nan=False).encode() + b"\n"


def _blob(digest: str) -> str:
    return f"blobs/{digest[:2]}/{digest}"


def _inside(folder: pathlib.Path, name: str) -> pathlib.Path:
    parts = pathlib.PurePosixPath(name)
    if parts.is_absolute() or ".." in parts.parts:
        raise DataError(folder / name, "would be outside its folder; the manifest was not written by this project")
    return folder / name
