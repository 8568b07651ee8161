"""Folders in which new data arrive, and the cursor of a sensor that watches them."""

import dataclasses
import json
import os
import pathlib

from deltasafe.io.storage import digest_of, sha256_of_file

HANDS_VARIABLE = "DELTASAFE_WATCHED_HANDS"
SCENES_VARIABLE = "DELTASAFE_WATCHED_SCENES"


def watched_hands(home: pathlib.Path) -> pathlib.Path:
    """Return the folder of new labeled images: `$DELTASAFE_WATCHED_HANDS`, or ``incoming/hands`` below the home."""
    return pathlib.Path(os.environ.get(HANDS_VARIABLE) or home / "incoming" / "hands").expanduser()


def watched_scenes(home: pathlib.Path) -> pathlib.Path:
    """Return the folder of new logged scenes: `$DELTASAFE_WATCHED_SCENES`, or ``incoming/scenes`` below the home."""
    return pathlib.Path(os.environ.get(SCENES_VARIABLE) or home / "incoming" / "scenes").expanduser()


def digest_of_folder(folder: pathlib.Path) -> str:
    """Return a SHA-256 over names and contents of all files that are not hidden; empty if there are none.

    A file that disappears while it is read counts as unreadable; the next tick sees the folder without it.
    """
    digests = {}
    for path in sorted(folder.rglob("*")):
        name = path.relative_to(folder)
        if path.is_file() and not any(part.startswith(".") for part in name.parts):
            try:
                digests[name.as_posix()] = sha256_of_file(path)
            except OSError:
                digests[name.as_posix()] = "unreadable"
    return digest_of(digests) if digests else ""


@dataclasses.dataclass
class WatchCursor:
    """Cursor of a sensor: folder digests by name.

    Attributes:
        seen: digests at the last tick.
        done: digests that the sensor has acted on.
        n_requests: number of requested runs.
    """

    seen: dict[str, str]
    done: dict[str, str]
    n_requests: int = 0

    @classmethod
    def from_json(cls, cursor: str | None) -> "WatchCursor":
        return cls(**json.loads(cursor)) if cursor else cls({}, {})

    def to_json(self) -> str:
        return json.dumps(dataclasses.asdict(self), sort_keys=True)

    def settled(self, digests: dict[str, str]) -> list[str]:
        """Return the names whose digest is new but unchanged since the last tick: writing there has finished."""
        settled = [name for name, digest in digests.items() if self.done.get(name) != digest == self.seen.get(name)]
        self.seen = dict(digests)
        return settled

    def run_key(self, name: str) -> str:
        """Return a new run key. Dagster never repeats a key, but a folder may return to an earlier content."""
        self.n_requests += 1
        return f"{name} {self.done[name]} {self.n_requests}"
