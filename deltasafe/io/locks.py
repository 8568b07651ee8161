"""Locks between processes. The kernel releases them when the process that holds them ends, however it ends."""

import contextlib
import fcntl
import math
import os
import pathlib
import platform
import time

from deltasafe.errors import LockedError
from deltasafe.io.write_errors import translated_write_errors

_POLL_S = 0.05


class FileLock:
    """Exclusive lock between processes (flock), held inside a `with` block. The lock file is removed at the end.

    Args:
        path: the lock file; it contains PID and host name of the process that holds the lock.
        timeout_s: how long to wait for the lock.

    Raises:
        LockedError: another process still holds the lock after ``timeout_s``.
        WriteError: the lock file cannot be created.
    """

    def __init__(self, path: pathlib.Path, timeout_s: float = math.inf) -> None:
        self.path = path
        self.timeout_s = timeout_s

    def __enter__(self) -> "FileLock":
        until_s = time.monotonic() + self.timeout_s
        while not self._try():
            if time.monotonic() > until_s:
                raise LockedError(
                    self.path.parent, f"is in use by {self._holder()}; wait for it, or end it, and run this again"
                )
            time.sleep(_POLL_S)
        return self

    def __exit__(self, *exception: object) -> None:
        try:
            with contextlib.suppress(OSError):  # a lock file that remains locks nothing
                self.path.unlink()  # before the release: afterwards another process may hold the lock
        finally:
            os.close(self._handle)

    def _try(self) -> bool:
        with translated_write_errors(self.path):
            self.path.parent.mkdir(parents=True, exist_ok=True)
            handle = os.open(self.path, os.O_RDWR | os.O_CREAT, 0o644)
            try:
                fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
                # the previous holder may have removed the file between open and flock: then this lock is void
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
