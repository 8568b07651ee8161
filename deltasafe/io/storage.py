"""Writing so that a reader sees the whole thing or nothing: temporary sibling, fsync, rename. And digests."""

import contextlib
import dataclasses
import errno
import hashlib
import json
import math
import os
import pathlib
import shutil
from collections.abc import Callable, Iterator
from typing import Any

from deltasafe.errors import DataError
from deltasafe.io.temporary_files import RETIRED, exchange, temporary_file, temporary_folder
from deltasafe.io.write_errors import naming

__all__ = [
    "atomic_file",
    "atomic_folder",
    "digest_of",
    "parse_json",
    "read_json",
    "sha256_of_file",
    "write_json",
]


@contextlib.contextmanager
def atomic_file(destination: str | pathlib.Path) -> Iterator[pathlib.Path]:
    """Yield a temporary sibling of ``destination``; on success it is synced to disk and takes its place.

    On an exception the temporary file is removed and ``destination`` is left as it was.
    The sibling keeps the suffix of ``destination``, so that writers which choose a format by suffix work.

    Raises:
        WriteError: no room, or no permission.
    """
    destination = pathlib.Path(destination)
    with naming(destination):
        destination.parent.mkdir(parents=True, exist_ok=True)
        temporary = temporary_file(destination)
        try:
            yield temporary
            _sync(temporary)
            temporary.chmod(0o644)
            temporary.replace(destination)
            _sync(destination.parent)
        finally:
            temporary.unlink(missing_ok=True)


@contextlib.contextmanager
def atomic_folder(
    destination: str | pathlib.Path, named: Callable[[pathlib.Path], str] | None = None
) -> Iterator[pathlib.Path]:
    """Yield an empty temporary sibling folder; on success it takes the place of ``destination`` as a whole.

    An existing ``destination`` is replaced, in one step where the file system can exchange two names (Linux); on an
    exception it is left as it was.

    Args:
        named: tells the name after all, once the content is complete; for folders that are named by it.

    Raises:
        WriteError: no room, or no permission.
    """
    destination = pathlib.Path(destination)
    with naming(destination):
        destination.parent.mkdir(parents=True, exist_ok=True)
        temporary = temporary_folder(destination)
        try:
            yield temporary
            if named is not None:
                destination = destination.with_name(named(temporary))
            for path in (*temporary.rglob("*"), temporary):
                if path.is_file() or path.is_dir():
                    _sync(path)
            temporary.chmod(0o755)
            _put(temporary, destination)
            _sync(destination.parent)
        finally:
            if temporary.exists():
                shutil.rmtree(temporary)


def _put(temporary: pathlib.Path, destination: pathlib.Path) -> None:
    try:
        temporary.replace(destination)
        return
    except OSError as error:  # somebody was faster perhaps, so it is not asked before
        if error.errno not in (errno.ENOTEMPTY, errno.EEXIST):
            raise
    if not exchange(temporary, destination):
        retired = temporary_folder(destination, RETIRED)
        destination.replace(retired)
        temporary.replace(destination)
        shutil.rmtree(retired)


def write_json(destination: str | pathlib.Path, value: Any) -> None:
    """Write ``value`` as indented JSON with sorted keys, atomically; NaN and infinities are refused."""
    text = json.dumps(value, indent=1, sort_keys=True, allow_nan=False, default=_plain)
    with atomic_file(destination) as temporary:
        temporary.write_text(text + "\n", encoding="utf-8")


def read_json(path: str | pathlib.Path) -> Any:
    """Read a JSON file, as strictly as all readers of JSON agree on it: no key twice, no number that is not finite.

    Raises:
        DataError: the file is missing, cannot be read, or is not such JSON.
    """
    path = pathlib.Path(path)
    try:
        if path.exists() and not path.is_file():  # a pipe would be waited for
            raise DataError(path, "is no file; restore it")
        text = path.read_text(encoding="utf-8")
    except FileNotFoundError:
        raise DataError(path, "is missing; restore the file") from None
    except UnicodeDecodeError as error:
        raise DataError(path, f"is not valid JSON ({error}); restore the file") from error
    except OSError as error:
        raise DataError(path, f"cannot be read ({error.strerror}); restore the file, or its permissions") from error
    try:
        return parse_json(text)
    except ValueError as error:
        raise DataError(path, f"is not valid JSON ({error}); restore the file") from error


def parse_json(text: str | bytes) -> Any:
    """Strict JSON, as by `read_json`.

    Raises:
        ValueError: it is none.
    """
    try:
        return json.loads(text, object_pairs_hook=_object, parse_float=_finite, parse_constant=_finite)
    except RecursionError:
        raise ValueError("nested too deeply") from None


def sha256_of_file(path: str | pathlib.Path) -> str:
    """SHA-256 of a file's bytes, in hexadecimal."""
    with pathlib.Path(path).open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def digest_of(value: Any) -> str:
    """SHA-256 of a JSON-like value (dataclasses included), independent of key order."""
    text = json.dumps(value, sort_keys=True, separators=(",", ":"), allow_nan=False, default=_plain)
    return hashlib.sha256(text.encode("utf-8")).hexdigest()


def _object(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    found = dict(pairs)
    if len(found) < len(pairs):
        keys = [key for key, _ in pairs]
        raise ValueError(f"key {next(key for key in keys if keys.count(key) > 1)!r} occurs twice")
    return found


def _finite(text: str) -> float:
    value = float(text)
    if not math.isfinite(value):
        raise ValueError(f"{text} is not a finite number")
    return value


def _plain(value: Any) -> Any:
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return dataclasses.asdict(value)
    if isinstance(value, pathlib.PurePath):
        return value.as_posix()
    if hasattr(value, "tolist"):  # numpy arrays and scalars
        return value.tolist()
    raise TypeError(f"{type(value).__name__} has no JSON form")


def _sync(path: pathlib.Path) -> None:
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)
