"""Translate failed writes to one typed error. Every library reports a full disk in its own way."""

import contextlib
import errno
import os
import pathlib
import re
from collections.abc import Iterator

from deltasafe.errors import WriteError

_NO_SPACE = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
_NO_PERMISSION = (errno.EACCES, errno.EPERM, errno.EROFS)
_MESSAGES = {
    **{re.compile(rf"os error {code}\b"): code for code in _NO_SPACE + _NO_PERMISSION},
    re.compile(r"No space left|requested and \d+ written|disk is full"): errno.ENOSPC,
}
"""Messages of exceptions without errno (safetensors, numpy, SQLite), and the errno that they mean."""


@contextlib.contextmanager
def translated_write_errors(destination: pathlib.Path) -> Iterator[None]:
    """Raise a `WriteError` that names ``destination`` if the block fails for lack of space or permission.

    Raises:
        WriteError: ``destination`` cannot be written.
    """
    try:
        yield
    except Exception as error:
        code = _errno_of(error, destination)
        if code is None:
            raise
        remedy = "free space there" if code in _NO_SPACE else "make its folder writable"
        reason = f"cannot be written ({os.strerror(code)}); {remedy}, or choose another place"
        raise WriteError(destination, reason) from error


def _errno_of(error: Exception, destination: pathlib.Path) -> int | None:
    """Return the errno of a failed write; None for other failures, and for failures at another place."""
    if isinstance(error, WriteError):
        cause = error.__cause__
        if not isinstance(cause, Exception) or not _is_at(error.path, destination):
            return None
        return _errno_of(cause, destination)
    if isinstance(error, OSError) and error.errno is not None:
        paths = [pathlib.Path(os.fsdecode(name)) for name in (error.filename, error.filename2) if name is not None]
        is_here = not paths or any(_is_at(path, destination) for path in paths)
        return error.errno if is_here and error.errno in _NO_SPACE + _NO_PERMISSION else None
    return next((code for message, code in _MESSAGES.items() if message.search(str(error))), None)


def _is_at(path: pathlib.Path, destination: pathlib.Path) -> bool:
    return path.absolute().is_relative_to(destination.parent.absolute()) or destination.is_relative_to(path)
