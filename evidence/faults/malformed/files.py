"""Corruptions of any file: missing, of another type, truncated or unreadable. Helpers to combine corruptions."""

import os
import pathlib
from collections.abc import Callable, Mapping
from random import Random

from evidence.faults.rejection import Case, Change, Corruption, InputKind, rewrite

NOT_A_FILE = ("missing", "a folder", "a pipe", "a broken link", "a link to itself")
"""Names of the changes that leave no regular file."""


def at(name: str, change: Change) -> Corruption:
    """Change the file ``name`` of an input, or the input itself if it is a file; the error must name that file."""

    def corrupt(given: pathlib.Path, random: Random) -> str:
        path = given / name if given.is_dir() else given
        change(path, random)
        return path.name

    return corrupt


def blaming_folder(corruption: Corruption) -> Corruption:
    """Require that the error names the folder of the input instead of the file."""

    def corrupt(given: pathlib.Path, random: Random) -> str:
        corruption(given, random)
        return given.name

    return corrupt


def prefixed(
    prefix: str, changes: Mapping[str, Change], target: Callable[[Change], Corruption]
) -> dict[str, Corruption]:
    """Turn named changes into corruptions of one target, with the prefix in their names."""
    return {f"{prefix}: {name}": target(change) for name, change in changes.items()}


def cases_of(kind: InputKind, corruptions: Mapping[str, Corruption]) -> list[Case]:
    """Create one case per corruption."""
    return [Case(name, kind, corruption) for name, corruption in corruptions.items()]


def file_cases(kind: InputKind, changes: Mapping[str, Change]) -> list[Case]:
    """Create one case per change of an input that is a single file."""
    return cases_of(kind, {name: at("", change) for name, change in changes.items()})


def filled(data: bytes) -> Change:
    """Replace the content of a file."""
    return lambda path, _: rewrite(path, data)


def truncated(path: pathlib.Path, random: Random) -> None:
    """Cut a file to half of its size."""
    rewrite(path, path.read_bytes()[: path.stat().st_size // 2])


def file_changes() -> dict[str, Change]:
    """Return the changes that apply to any file."""
    return {
        "missing": lambda path, _: path.unlink(),
        "empty": filled(b""),
        "zeros": filled(bytes(1000)),
        "text": filled(b"not the expected content\n"),
        "random bytes": lambda path, random: rewrite(path, random.randbytes(2000)),
        "truncated": truncated,
        "a folder": _replaced(pathlib.Path.mkdir),
        "a pipe": _replaced(os.mkfifo),
        "a broken link": _replaced(lambda path: path.symlink_to("nowhere")),
        "a link to itself": _replaced(lambda path: path.symlink_to(path.name)),
        "unreadable": _unreadable,
    }


def edited(culprit: str, action: Callable[[pathlib.Path], object]) -> Corruption:
    """Apply an action to the path of the input; the error must name ``culprit``, or the input itself if empty."""

    def corrupt(given: pathlib.Path, random: Random) -> str:
        action(given)
        return culprit or given.name

    return corrupt


def with_text(name: str) -> Corruption:
    """Add a text file that does not belong to the input."""
    return edited(pathlib.PurePath(name).name, lambda given: (given / name).write_text("x"))


def linked_outside(name: str) -> Corruption:
    """Move the file ``name`` out of the folder and leave a link to it."""
    return edited(
        name, lambda given: (given / name).symlink_to((given / name).rename(given.parent / f"outside-{name}"))
    )


def _unreadable(path: pathlib.Path, random: Random) -> None:
    rewrite(path, path.read_bytes())
    path.chmod(0)


def _replaced(create: Callable[[pathlib.Path], object]) -> Change:
    def change(path: pathlib.Path, random: Random) -> None:
        path.unlink()
        create(path)

    return change
