"""Folders that people and machines write into: seen as changed only when they are at rest."""

import dataclasses
import json
import os
import pathlib

from deltasafe.io.storage import digest_of, sha256_of_file

__all__ = [
    "HANDS_VARIABLE",
    "SCENES_VARIABLE",
    "Watched",
    "digest_of_folder",
    "watched_hands",
    "watched_scenes",
]


HANDS_VARIABLE = "DELTASAFE_WATCHED_HANDS"
SCENES_VARIABLE = "DELTASAFE_WATCHED_SCENES"


def watched_hands(home: pathlib.Path) -> pathlib.Path:
    """Where labeled images arrive: `$DELTASAFE_WATCHED_HANDS`, or ``incoming/hands`` below the home."""
    return pathlib.Path(os.environ.get(HANDS_VARIABLE) or home / "incoming" / "hands").expanduser()


def watched_scenes(home: pathlib.Path) -> pathlib.Path:
    """Where logged scenes arrive: `$DELTASAFE_WATCHED_SCENES`, or ``incoming/scenes`` below the home."""
    return pathlib.Path(os.environ.get(SCENES_VARIABLE) or home / "incoming" / "scenes").expanduser()


def digest_of_folder(folder: pathlib.Path) -> str:
    """SHA-256 over names and contents of all files that are not hidden; empty if there are none.

    A file that disappears while it is read counts as unreadable: the next look sees the folder without it.
    """
    entries = {}
    for path in sorted(folder.rglob("*")):
        name = path.relative_to(folder)
        if path.is_file() and not any(part.startswith(".") for part in name.parts):
            try:
                entries[name.as_posix()] = sha256_of_file(path)
            except OSError:
                entries[name.as_posix()] = "unreadable"
    return digest_of(entries) if entries else ""


@dataclasses.dataclass
class Watched:
    """What a sensor remembers: digests that it saw last, and digests that it has acted upon, by name."""

    seen: dict[str, str]
    done: dict[str, str]

    @classmethod
    def from_cursor(cls, cursor: str | None) -> "Watched":
        return cls(**json.loads(cursor)) if cursor else cls({}, {})

    def cursor(self) -> str:
        return json.dumps(dataclasses.asdict(self), sort_keys=True)

    def ripe(self, now: dict[str, str]) -> list[str]:
        """Names whose digest is new and was the same at the last look: nobody is writing there any more."""
        ripe = [name for name, digest in now.items() if self.done.get(name) != digest == self.seen.get(name)]
        self.seen = dict(now)
        return ripe
