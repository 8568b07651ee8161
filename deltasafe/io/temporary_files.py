"""Temporary files and folders beside their destination, and the removal of those that a killed process left.

The name is hidden and contains the machine, the PID and the start time of the process that writes. The first write of
a process into a folder removes the leftovers of ended processes there. If it cannot tell whether the process has ended
(another machine), it removes what is older than a week.
"""

import contextlib
import ctypes
import errno
import functools
import hashlib
import os
import pathlib
import platform
import re
import shutil
import tempfile
import time

from deltasafe.compute.processes import start_ticks

BACKUP = "retired"
"""Purpose of a temporary folder: the previous version, moved aside while it is replaced."""
_NEW = "new"
_NAME = re.compile(
    r"^\.(?P<destination>.+)~(?P<purpose>\w+)\.(?P<machine>[0-9a-f]{8})\.(?P<pid>\d+)\.(?P<start>\d+)\.\w+(\..+)?$"
)
_WEEK_S = 7 * 24 * 3600.0
_AT_FDCWD, _RENAME_EXCHANGE = -100, 2
_UNSUPPORTED = (errno.EINVAL, errno.ENOSYS, errno.ENOTSUP, errno.EXDEV)


def temporary_file(destination: pathlib.Path) -> pathlib.Path:
    """Create an empty hidden file beside ``destination``, with its suffix: some libraries choose a format by it."""
    remove_leftovers(destination.parent)
    name = destination.name.removesuffix(destination.suffix)
    handle, path = tempfile.mkstemp(prefix=_prefix(name, _NEW), suffix=destination.suffix, dir=destination.parent)
    os.close(handle)
    return pathlib.Path(path)


def temporary_folder(destination: pathlib.Path, purpose: str = _NEW) -> pathlib.Path:
    """Create an empty hidden folder beside ``destination``."""
    remove_leftovers(destination.parent)
    return pathlib.Path(tempfile.mkdtemp(prefix=_prefix(destination.name, purpose), dir=destination.parent))


def swap_names(one: pathlib.Path, other: pathlib.Path) -> bool:
    """Exchange the names of two folders atomically; return False if the system or the file system cannot.

    Raises:
        OSError: the exchange failed for another reason.
    """
    rename = _renameat2()
    if rename is None:
        return False
    if rename(_AT_FDCWD, os.fsencode(one), _AT_FDCWD, os.fsencode(other), _RENAME_EXCHANGE) == 0:
        return True
    code = ctypes.get_errno()
    if code in _UNSUPPORTED:
        return False
    raise OSError(code, os.strerror(code), str(one), None, str(other))


def find_temporary_files(folder: pathlib.Path) -> list[pathlib.Path]:
    """Find all temporary files and folders below ``folder``, also those in use."""
    return sorted(path for path in folder.rglob(".*") if _NAME.match(path.name))


def remove_leftovers(folder: pathlib.Path) -> None:
    """Remove the temporary files in ``folder`` whose process has ended; once per process and folder.

    A backup is renamed to its destination if that is missing.
    """
    _remove_once(os.path.abspath(folder), os.getpid())  # noqa: PTH100 - resolve() would follow links


@functools.lru_cache(maxsize=4096)
def _remove_once(folder: str, pid: int) -> None:
    try:
        with os.scandir(folder) as entries:
            found = [(pathlib.Path(entry.path), match) for entry in entries if (match := _NAME.match(entry.name))]
    except OSError:
        return
    for path, match in found:
        with contextlib.suppress(OSError):  # without permission to remove it, leave it
            if not _is_abandoned(path, match):
                continue
            destination = path.with_name(match["destination"])
            if match["purpose"] == BACKUP and not destination.exists():
                path.replace(destination)
            elif path.is_dir() and not path.is_symlink():
                shutil.rmtree(path)
            else:
                path.unlink()


def _is_abandoned(path: pathlib.Path, match: re.Match[str]) -> bool:
    try:
        start = start_ticks(int(match["pid"])) if match["machine"] == _machine() else None
    except ProcessLookupError:
        return True
    if start is None:
        return time.time() - path.lstat().st_mtime > _WEEK_S
    return start != int(match["start"])


def _prefix(name: str, purpose: str) -> str:
    return f".{name}~{purpose}.{_process(os.getpid())}."


@functools.lru_cache(1)
def _process(pid: int) -> str:
    return f"{_machine()}.{pid}.{start_ticks(pid) or 0}"


@functools.cache
def _machine() -> str:
    """Identify this machine, or this container."""
    return hashlib.sha256(platform.node().encode()).hexdigest()[:8]


@functools.cache
def _renameat2():  # type: ignore[no-untyped-def]
    if platform.system() != "Linux":
        return None
    return getattr(ctypes.CDLL(None, use_errno=True), "renameat2", None)
