"""Atomic writes (temporary file, fsync, rename), strict JSON, and digests."""

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
from deltasafe.io.temporary_files import BACKUP, swap_names, temporary_file, temporary_folder
from deltasafe.io.write_errors import translated_write_errors


@contextlib.contextmanager
def atomic_file(destination: str | pathlib.Path) -> Iterator[pathlib.Path]:
    """Yield a temporary file; on success, sync it to disk and rename it to ``destination``.

    On an exception, the temporary file is removed and ``destination`` is unchanged. The temporary file has the suffix
    of ``destination``, because some libraries choose a format by suffix.

    Raises:
        WriteError: no space or no permission.
    """
    destination = pathlib.Path(destination)
    with translated_write_errors(destination):
        destination.parent.mkdir(parents=True, exist_ok=True)
        temporary = temporary_file(destination)
        try:
            yield temporary
            _sync(temporary)
            temporary.chmod(0o666 & ~_umask())
            temporary.replace(destination)
            _sync(destination.parent)
        finally:
            temporary.unlink(missing_ok=True)


@contextlib.contextmanager
def atomic_folder(
    destination: str | pathlib.Path, named: Callable[[pathlib.Path], str] | None = None
) -> Iterator[pathlib.Path]:
    """Yield an empty temporary folder; on success, sync it to disk and rename it to ``destination``.

    An existing ``destination`` is replaced, atomically where the file system can exchange two names (Linux). On an
    exception it is unchanged.

    Args:
        named: returns the final name of the complete folder, for folders that are named by their content.

    Raises:
        WriteError: no space or no permission.
    """
    destination = pathlib.Path(destination)
    with translated_write_errors(destination):
        destination.parent.mkdir(parents=True, exist_ok=True)
        temporary = temporary_folder(destination)
        try:
            yield temporary
            if named is not None:
                destination = destination.with_name(named(temporary))
            for path in (*temporary.rglob("*"), temporary):
                if path.is_file() or path.is_dir():
                    _sync(path)
            temporary.chmod(0o777 & ~_umask())
            _replace_folder(temporary, destination)
            _sync(destination.parent)
        finally:
            if temporary.exists():
                shutil.rmtree(temporary)


def _replace_folder(temporary: pathlib.Path, destination: pathlib.Path) -> None:
    try:
        temporary.replace(destination)
        return
    except OSError as error:  # no check beforehand: another process may create the folder in between
        if error.errno not in (errno.ENOTEMPTY, errno.EEXIST):
            raise
    if not swap_names(temporary, destination):
        backup = temporary_folder(destination, BACKUP)
        destination.replace(backup)
        temporary.replace(destination)
        shutil.rmtree(backup)


def write_json(destination: str | pathlib.Path, value: Any) -> None:
    """Write ``value`` atomically as indented JSON with sorted keys.

    Raises:
        ValueError: ``value`` contains NaN or infinity.
        WriteError: no space or no permission.
    """
    text = json.dumps(value, indent=1, sort_keys=True, allow_nan=False, default=_plain)
    with atomic_file(destination) as temporary:
        temporary.write_text(text + "\n", encoding="utf-8")


def read_json(path: str | pathlib.Path) -> Any:
    """Read a file of strict JSON: no duplicate keys, finite numbers only.

    Raises:
        DataError: the file is missing, cannot be read, or is not strict JSON.
    """
    path = pathlib.Path(path)
    try:
        if path.exists() and not path.is_file():  # reading a named pipe would block
            raise DataError(path, "is not a file; restore it")
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
    """Parse strict JSON: no duplicate keys, finite numbers only.

    Raises:
        ValueError: ``text`` is not strict JSON.
    """
    try:
        return json.loads(text, object_pairs_hook=_object, parse_float=_finite, parse_constant=_finite)
    except RecursionError:
        raise ValueError("nested too deeply") from None


def sha256_of_file(path: str | pathlib.Path) -> str:
    """Return the SHA-256 of a file in hexadecimal."""
    with pathlib.Path(path).open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def digest_of(value: Any) -> str:
    """Return the SHA-256 of a JSON-like value (dataclasses included), independent of the order of keys."""
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


def _umask() -> int:
    """Return the umask of this process. Temporary files are private; a finished one has the mode of any other file."""
    with contextlib.suppress(OSError, ValueError, IndexError):
        status = pathlib.Path("/proc/self/status").read_text(encoding="ascii")
        return int(status.partition("Umask:")[2].split()[0], 8)
    mask = os.umask(0o077)  # without /proc it can be read only by setting it
    os.umask(mask)
    return mask


def _sync(path: pathlib.Path) -> None:
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)
