"""Locks between processes that the kernel releases when the holder ends, however it ends."""

import contextlib
import fcntl
import math
import os
import pathlib
import platform
import time

from deltasafe.errors import LockedError
from deltasafe.io.write_errors import naming

__all__ = ["FileLock"]

_POLL_S = 0.05


class FileLock:
    """Exclusive lock between processes (flock), held inside a `with` block; its file is removed afterwards.

    Args:
        path: the lock file; it holds PID and host of the holder.
        patience_s: how long to wait for another holder.

    Raises:
        LockedError: another process still holds it after ``patience_s``.
        WriteError: the file cannot be made.
    """

    def __init__(self, path: pathlib.Path, patience_s: float = math.inf) -> None:
        self.path = path
        self.patience_s = patience_s

    def __enter__(self) -> "FileLock":
        until_s = time.monotonic() + self.patience_s
        while not self._try():
            if time.monotonic() > until_s:
                raise LockedError(
                    self.path.parent, f"is in use by {self._holder()}; wait for it, or end it, and run this again"
                )
            time.sleep(_POLL_S)
        return self

    def __exit__(self, *exception: object) -> None:
        try:
            with contextlib.suppress(OSError):  # a file that stays behind locks nothing
                self.path.unlink()  # before the release: afterwards it may be the next holder's
        finally:
            os.close(self._handle)

    def _try(self) -> bool:
        with naming(self.path):
            self.path.parent.mkdir(parents=True, exist_ok=True)
            handle = os.open(self.path, os.O_RDWR | os.O_CREAT, 0o644)
            try:
                fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
                # the holder before may have removed the file between open and flock: then this lock is void
                if os.path.samestat(os.fstat(handle), self.path.stat()):
                    os.truncate(handle, 0)
                    os.write(handle, f"process {os.getpid()} of {platform.node()}\n".encode())
                    self._handle = handle
                    return True
            except (BlockingIOError, FileNotFoundError):
                pass
            except BaseException:
                os.close(handle)
                raise
            os.close(handle)
            return False

    def _holder(self) -> str:
        with contextlib.suppress(OSError, UnicodeDecodeError):
            return self.path.read_text(encoding="utf-8").strip() or "another process"
        return "another process"
