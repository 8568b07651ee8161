"""Writing so that a reader sees the whole thing or nothing: temporary sibling, fsync, rename. And digests."""

import contextlib
import dataclasses
import hashlib
import json
import os
import pathlib
import shutil
import tempfile
from collections.abc import Iterator
from typing import Any

from deltasafe.errors import DataError

__all__ = ["atomic_file", "atomic_folder", "digest_of", "digest_of_code", "read_json", "sha256_of_file", "write_json"]


@contextlib.contextmanager
def atomic_file(destination: str | pathlib.Path) -> Iterator[pathlib.Path]:
    """Yield a temporary sibling of ``destination``; on success it is synced to disk and takes its place.

    On an exception the temporary file is removed and ``destination`` is left as it was.
    The sibling keeps the suffix of ``destination``, so that writers which choose a format by suffix work.
    """
    destination = pathlib.Path(destination)
    destination.parent.mkdir(parents=True, exist_ok=True)
    handle, name = tempfile.mkstemp(prefix=f".{destination.stem}-", suffix=destination.suffix, dir=destination.parent)
    os.close(handle)
    temporary = pathlib.Path(name)
    try:
        yield temporary
        _sync(temporary)
        temporary.chmod(0o644)
        temporary.replace(destination)
        _sync(destination.parent)
    finally:
        temporary.unlink(missing_ok=True)


@contextlib.contextmanager
def atomic_folder(destination: str | pathlib.Path) -> Iterator[pathlib.Path]:
    """Yield an empty temporary sibling folder; on success it takes the place of ``destination`` as a whole.

    An existing ``destination`` is replaced; on an exception it is left as it was.
    """
    destination = pathlib.Path(destination)
    destination.parent.mkdir(parents=True, exist_ok=True)
    temporary = pathlib.Path(tempfile.mkdtemp(prefix=f".{destination.name}-", dir=destination.parent))
    try:
        yield temporary
        for path in temporary.rglob("*"):
            if path.is_file():
                _sync(path)
        temporary.chmod(0o755)
        if destination.exists():
            retired = pathlib.Path(tempfile.mkdtemp(prefix=f".{destination.name}-", dir=destination.parent))
            destination.replace(retired)
            temporary.replace(destination)
            shutil.rmtree(retired)
        else:
            temporary.replace(destination)
        _sync(destination.parent)
    finally:
        if temporary.exists():
            shutil.rmtree(temporary)


def write_json(destination: str | pathlib.Path, value: Any) -> None:
    """Write ``value`` as indented JSON with sorted keys, atomically; NaN and infinities are refused."""
    text = json.dumps(value, indent=1, sort_keys=True, allow_nan=False, default=_plain)
    with atomic_file(destination) as temporary:
        temporary.write_text(text + "\n", encoding="utf-8")


def read_json(path: str | pathlib.Path) -> Any:
    """Read a JSON file.

    Raises:
        DataError: the file is missing or is not JSON.
    """
    try:
        return json.loads(pathlib.Path(path).read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise DataError(path, "is missing") from None
    except (UnicodeDecodeError, json.JSONDecodeError) as error:
        raise DataError(path, f"is not valid JSON ({error})") from error


def sha256_of_file(path: str | pathlib.Path) -> str:
    """SHA-256 of a file's bytes, in hexadecimal."""
    with pathlib.Path(path).open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def digest_of(value: Any) -> str:
    """SHA-256 of a JSON-like value (dataclasses included), independent of key order."""
    text = json.dumps(value, sort_keys=True, separators=(",", ":"), allow_nan=False, default=_plain)
    return hashlib.sha256(text.encode("utf-8")).hexdigest()


def digest_of_code() -> str:
    """SHA-256 over the sources of this package: what made an artifact."""
    root = pathlib.Path(__file__).parent
    return digest_of({path.relative_to(root).as_posix(): sha256_of_file(path) for path in root.rglob("*.py")})


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
