"""Why something could not be written, in words: a full disk says so in as many ways as there are writers."""

import contextlib
import errno
import os
import pathlib
import re
from collections.abc import Iterator

from deltasafe.errors import WriteError

__all__ = ["naming"]

_NO_ROOM = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
_NOT_ALLOWED = (errno.EACCES, errno.EPERM, errno.EROFS)
_WORDS = {
    **{re.compile(rf"os error {number}\b"): number for number in _NO_ROOM + _NOT_ALLOWED},
    re.compile(r"No space left|requested and \d+ written|disk is full"): errno.ENOSPC,
}
"""What other errors than those of Python's own calls contain (safetensors, numpy, SQLite)."""


@contextlib.contextmanager
def naming(destination: pathlib.Path) -> Iterator[None]:
    """Errors for want of room or permission come out as such, with the name of what was to be written.

    Raises:
        WriteError: of ``destination``.
    """
    try:
        yield
    except Exception as error:
        number = _number(error, destination)
        if number is None:
            raise
        remedy = "free room there" if number in _NO_ROOM else "make its folder writable"
        reason = f"cannot be written ({os.strerror(number)}); {remedy}, or choose another place"
        raise WriteError(destination, reason) from error


def _number(error: Exception, destination: pathlib.Path) -> int | None:
    """The system's number of the reason; None if it is another one, or if it is about another place."""
    if isinstance(error, WriteError):
        inner = error.__cause__
        return _number(inner, destination) if isinstance(inner, Exception) and _is_at(error.path, destination) else None
    if isinstance(error, OSError) and error.errno is not None:
        about = [pathlib.Path(os.fsdecode(name)) for name in (error.filename, error.filename2) if name is not None]
        concerns = not about or any(_is_at(path, destination) for path in about)
        return error.errno if concerns and error.errno in _NO_ROOM + _NOT_ALLOWED else None
    return next((number for words, number in _WORDS.items() if words.search(str(error))), None)


def _is_at(path: pathlib.Path, destination: pathlib.Path) -> bool:
    return path.absolute().is_relative_to(destination.parent.absolute()) or destination.is_relative_to(path)
