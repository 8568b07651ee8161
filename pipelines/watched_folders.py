"""Folders in which new data arrive, and what a sensor remembers of them between two ticks.

A folder is walked at every tick. It is read only after size, times or inode of a file changed and then stayed the same
for one tick, and then only the changed files are read.
"""

import contextlib
import dataclasses
import json
import math
import os
import pathlib
import time
from collections.abc import Iterator

from deltasafe.errors import DataError
from deltasafe.io.folder_entries import is_clutter
from deltasafe.io.storage import digest_of, read_json, sha256_of_file, write_json

HANDS_VARIABLE = "DELTASAFE_WATCHED_HANDS"
SCENES_VARIABLE = "DELTASAFE_WATCHED_SCENES"


def watched_hands(home: pathlib.Path) -> pathlib.Path:
    """Return the folder of new labeled images: `$DELTASAFE_WATCHED_HANDS`, or ``incoming/hands`` below the home."""
    return pathlib.Path(os.environ.get(HANDS_VARIABLE) or home / "incoming" / "hands").expanduser()


def watched_scenes(home: pathlib.Path) -> pathlib.Path:
    """Return the folder of new logged scenes: `$DELTASAFE_WATCHED_SCENES`, or ``incoming/scenes`` below the home."""
    return pathlib.Path(os.environ.get(SCENES_VARIABLE) or home / "incoming" / "scenes").expanduser()


def stamp_of_folder(folder: pathlib.Path) -> str:
    """Return a digest of name, size, times and inode of all files that are not hidden; empty if there are none.

    The change time (ctime) is included: a program can set back the modification time, but not this one.
    """
    stamps = {path.relative_to(folder).as_posix(): stamp for path, stamp in _files(folder)}
    return digest_of(stamps) if stamps else ""


def digest_of_folder(
    folder: pathlib.Path, memory: pathlib.Path | None = None, budget_s: float = math.inf
) -> str | None:
    """Return a SHA-256 over names and contents of all files that are not hidden; empty if there are none.

    A file that disappears while it is read counts as unreadable; the next tick sees the folder without it.

    Args:
        memory: file with digests of an earlier call: files with the same stamp are not read again.
        budget_s: time after which the call saves its memory and returns None; the next call continues.
    """
    known: dict[str, list] = {}
    if memory is not None:
        with contextlib.suppress(DataError):  # missing or damaged: all files are read again
            known = read_json(memory)
    digests, found, until_s = {}, {}, time.monotonic() + budget_s
    is_complete, n_read = True, 0
    for path, stamp in _files(folder):
        name = path.relative_to(folder).as_posix()
        kept = known.get(name, [None])
        if kept[0] != stamp:
            is_complete = n_read == 0 or time.monotonic() < until_s
            if not is_complete:
                break
            n_read += 1
            try:
                kept = [stamp, sha256_of_file(path)]
            except OSError:
                kept = [None, "unreadable"]
        found[name], digests[name] = kept, kept[1]
    if memory is not None and found != known:
        write_json(memory, found if is_complete else {**known, **found})
    if not is_complete:
        return None
    return digest_of(digests) if digests else ""


def _files(folder: pathlib.Path) -> Iterator[tuple[pathlib.Path, list[int]]]:
    """Yield the files below ``folder`` except clutter, sorted by path, with size, times in ns, and inode."""
    for path in sorted(folder.rglob("[!.]*")):
        if is_clutter(*path.relative_to(folder).parts):
            continue
        with contextlib.suppress(OSError):
            if path.is_file():
                stat = path.stat()
                yield path, [stat.st_size, stat.st_mtime_ns, stat.st_ctime_ns, stat.st_ino]


@dataclasses.dataclass
class WatchState:
    """What a sensor remembers of watched folders, by name.

    It is stored in a file that the cursor names: Dagster keeps the cursor of every tick, so a cursor must stay small.

    Attributes:
        seen: stamps at the last tick.
        done: stamps that the sensor has acted on.
        digests: digests of the content that the sensor has acted on.
        defects: errors of folders that cannot be used as they are.
        n_requests: number of requested runs.
    """

    seen: dict[str, str] = dataclasses.field(default_factory=dict)
    done: dict[str, str] = dataclasses.field(default_factory=dict)
    digests: dict[str, str] = dataclasses.field(default_factory=dict)
    defects: dict[str, str] = dataclasses.field(default_factory=dict)
    n_requests: int = 0

    @classmethod
    def load(cls, cursor: str | None, folder: pathlib.Path) -> "WatchState":
        """Read the state that ``cursor`` names; a new one if the cursor was reset or the file is gone."""
        given = json.loads(cursor) if cursor else {}
        state = cls(n_requests=given.get("n_requests", 0))
        if "state" not in given:
            return state
        with contextlib.suppress(DataError):
            state = cls(**read_json(folder / f"{given['state']}.json"))
        return state

    def save(self, folder: pathlib.Path, previous: str | None) -> str:
        """Write the state; return the cursor. The state of the cursor ``previous`` stays: this tick may still fail."""
        name = digest_of(self)[:16]
        kept = {name, json.loads(previous).get("state") if previous else None}
        if not (folder / f"{name}.json").is_file():
            write_json(folder / f"{name}.json", self)
        for file in folder.glob("*.json"):
            if file.stem not in kept:
                file.unlink(missing_ok=True)
        return json.dumps({"state": name, "n_requests": self.n_requests})

    def settled(self, stamps: dict[str, str]) -> list[str]:
        """Return the names whose stamp is new but unchanged since the last tick: writing there has finished."""
        settled = [name for name, stamp in stamps.items() if self.done.get(name) != stamp == self.seen.get(name)]
        self.seen = dict(stamps)
        return settled

    def is_new(self, name: str, stamp: str, digest: str) -> bool:
        """Remember that a folder was read; return whether its content differs from the one acted on last."""
        self.done[name] = stamp
        if self.digests.get(name) == digest:
            return False
        self.digests[name] = digest
        self.defects.pop(name, None)
        return True

    def run_key(self, name: str) -> str:
        """Return a new run key. Dagster never repeats a key, but a folder may return to an earlier content."""
        self.n_requests += 1
        return f"{name} {self.digests[name]} {self.n_requests}"
