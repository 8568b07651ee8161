"""Temporary siblings of files and folders that are being written, and what becomes of them when the writer is killed.

A sibling is hidden and bears its writer's machine, process and start. Whoever first writes into a folder removes those
there whose writer is gone; where nobody can know (another machine), those older than a week.
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

__all__ = ["RETIRED", "exchange", "left_behind", "sweep", "temporary_file", "temporary_folder"]

RETIRED = "retired"
_NAME = re.compile(r"^\.(?P<of>.+)~(?P<what>\w+)\.(?P<where>[0-9a-f]{8})\.(?P<pid>\d+)\.(?P<start>\d+)\.\w+(\..+)?$")
_WEEK_S = 7 * 24 * 3600.0
_AT_FDCWD, _RENAME_EXCHANGE = -100, 2
_UNSUPPORTED = (errno.EINVAL, errno.ENOSYS, errno.ENOTSUP, errno.EXDEV)


def temporary_file(destination: pathlib.Path) -> pathlib.Path:
    """An empty hidden sibling with the suffix of ``destination``, so that writers which go by suffix work."""
    sweep(destination.parent)
    name = destination.name.removesuffix(destination.suffix)
    handle, made = tempfile.mkstemp(prefix=_prefix(name, "new"), suffix=destination.suffix, dir=destination.parent)
    os.close(handle)
    return pathlib.Path(made)


def temporary_folder(destination: pathlib.Path, what: str = "new") -> pathlib.Path:
    """An empty hidden sibling folder."""
    sweep(destination.parent)
    return pathlib.Path(tempfile.mkdtemp(prefix=_prefix(destination.name, what), dir=destination.parent))


def exchange(one: pathlib.Path, other: pathlib.Path) -> bool:
    """Let two folders take each other's name in one step; False where system or file system cannot."""
    rename = _renameat2()
    if rename is None:
        return False
    if rename(_AT_FDCWD, os.fsencode(one), _AT_FDCWD, os.fsencode(other), _RENAME_EXCHANGE) == 0:
        return True
    number = ctypes.get_errno()
    if number in _UNSUPPORTED:
        return False
    raise OSError(number, os.strerror(number), str(one), None, str(other))


def left_behind(folder: pathlib.Path) -> list[pathlib.Path]:
    """All siblings below ``folder``, whoever left them or still writes to them."""
    return sorted(path for path in folder.rglob(".*") if _NAME.match(path.name))


def sweep(folder: pathlib.Path) -> None:
    """Remove what killed writers left in ``folder``; once in a process for each folder.

    A folder that was retired and never replaced takes its place again.
    """
    _sweep_once(os.path.abspath(folder), os.getpid())  # noqa: PTH100 - links are kept


@functools.lru_cache(maxsize=4096)
def _sweep_once(folder: str, pid: int) -> None:
    try:
        with os.scandir(folder) as entries:
            found = [(pathlib.Path(entry.path), match) for entry in entries if (match := _NAME.match(entry.name))]
    except OSError:
        return
    for path, match in found:
        with contextlib.suppress(OSError):  # whoever may not remove it, need not
            if not _is_abandoned(path, match):
                continue
            whole = path.with_name(match["of"])
            if match["what"] == RETIRED and not whole.exists():
                path.replace(whole)
            elif path.is_dir() and not path.is_symlink():
                shutil.rmtree(path)
            else:
                path.unlink()


def _is_abandoned(path: pathlib.Path, match: re.Match[str]) -> bool:
    try:
        start = start_ticks(int(match["pid"])) if match["where"] == _where() else None
    except ProcessLookupError:
        return True
    if start is None:
        return time.time() - path.lstat().st_mtime > _WEEK_S
    return start != int(match["start"])


def _prefix(name: str, what: str) -> str:
    return f".{name}~{what}.{_writer(os.getpid())}."


@functools.lru_cache(1)
def _writer(pid: int) -> str:
    return f"{_where()}.{pid}.{start_ticks(pid) or 0}"


@functools.cache
def _where() -> str:
    """Names this machine, or this container."""
    return hashlib.sha256(platform.node().encode()).hexdigest()[:8]


@functools.cache
def _renameat2():  # type: ignore[no-untyped-def]
    if platform.system() != "Linux":
        return None
    return getattr(ctypes.CDLL(None, use_errno=True), "renameat2", None)
