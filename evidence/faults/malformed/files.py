"""What can be wrong with any file: it is not there, is something else, or may not be read."""

import os
import pathlib
from collections.abc import Callable
from random import Random

from evidence.faults.judging import Spoil, rewrite

__all__ = ["at", "file_spoils", "filled", "linked_out", "unreadable"]


def at(name: str, change: Callable[[pathlib.Path, Random], None]) -> Spoil:
    """Change the file ``name`` of the input, or the input itself where it is a file; the culprit is that file."""

    def spoil(given: pathlib.Path, random: Random) -> str:
        path = given / name if given.is_dir() else given
        change(path, random)
        return path.name

    return spoil


def filled(data: bytes) -> Callable[[pathlib.Path, Random], None]:
    """The file holds these bytes."""
    return lambda path, _: rewrite(path, data)


def file_spoils() -> dict[str, Callable[[pathlib.Path, Random], None]]:
    """Ways of spoiling whatever file."""
    return {
        "missing": lambda path, _: path.unlink(),
        "empty": filled(b""),
        "zeros": filled(bytes(1000)),
        "text": filled(b"not at all what you think\n"),
        "random bytes": lambda path, random: rewrite(path, random.randbytes(2000)),
        "half of it": lambda path, _: rewrite(path, path.read_bytes()[: path.stat().st_size // 2]),
        "a folder": _folder,
        "a pipe": _pipe,
        "a link to nowhere": _nowhere,
        "a link to itself": _loop,
        "may not be read": unreadable,
    }


def linked_out(name: str) -> Spoil:
    """The file ``name`` lies outside of the folder, which holds a link to it."""

    def spoil(given: pathlib.Path, random: Random) -> str:
        outside = (given / name).rename(given.parent / f"outside-{name}")
        (given / name).symlink_to(outside)
        return name

    return spoil


def unreadable(path: pathlib.Path, random: Random) -> None:
    """Permissions that forbid reading."""
    rewrite(path, path.read_bytes())
    path.chmod(0)


def _folder(path: pathlib.Path, random: Random) -> None:
    path.unlink()
    path.mkdir()


def _pipe(path: pathlib.Path, random: Random) -> None:
    path.unlink()
    os.mkfifo(path)


def _nowhere(path: pathlib.Path, random: Random) -> None:
    path.unlink()
    path.symlink_to("nowhere")


def _loop(path: pathlib.Path, random: Random) -> None:
    path.unlink()
    path.symlink_to(path.name)
