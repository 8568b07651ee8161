"""A queue on disk for calls to a tracking server that may be away: one file per call, replayed in order."""

import logging
import pathlib
import re
import time
import uuid
from collections.abc import Callable, Mapping
from typing import Any

from deltasafe.io.storage import read_json, write_json

_log = logging.getLogger("deltasafe.tracking")
_TRANSIENT = re.compile(
    r"disk is full|disk I/O|No space left|too large|is locked"
    r"|readonly database|unable to open|Permission denied|Read-only"
)


class CallQueue:
    """A folder with one file per pending call, named by the time of the call.

    If a process ends after a call and before the file is removed, the call is made again: calls must be idempotent.

    Args:
        folder: below the home; calls that fail permanently are moved to ``refused/`` with the reason.
    """

    def __init__(self, folder: pathlib.Path) -> None:
        self.folder = folder

    def add(self, name: str, arguments: Mapping[str, Any]) -> pathlib.Path:
        """Write a call to its file, atomically."""
        file = self.folder / f"{time.time_ns():020d}-{uuid.uuid4().hex[:8]}.json"
        write_json(file, {"call": name, "arguments": dict(arguments)})
        return file

    def files(self) -> list[pathlib.Path]:
        """Return the files of pending calls, oldest first."""
        return sorted(path for path in self.folder.glob("*.json") if not path.name.startswith("."))

    def replay(
        self, make: Callable[[str, dict[str, Any]], Any], is_reachable: Callable[[], bool]
    ) -> dict[pathlib.Path, Any]:
        """Make the pending calls in order until the server is away; return their results by file.

        Args:
            make: makes one call, given its name and arguments.
            is_reachable: returns whether the server answers. If it does, a failed call is refused, except for
                transient failures: no space, no permission, a locked database.
        """
        results: dict[pathlib.Path, Any] = {}
        for file in self.files():
            try:
                call = read_json(file)
                results[file] = make(call["call"], call["arguments"])
            except Exception as error:  # a failure to record must never end a training
                if not is_reachable() or _TRANSIENT.search(f"{error} {error.__cause__}"):
                    _log.warning("%d calls wait in %s: %s", len(self.files()), self.folder, error)
                    break
                self._refuse(file, error)
            else:
                file.unlink()
        return results

    def _refuse(self, file: pathlib.Path, error: Exception) -> None:
        refused = self.folder / "refused" / file.name
        refused.parent.mkdir(exist_ok=True)
        refused.with_suffix(".txt").write_text(f"{type(error).__name__}: {error}\n", encoding="utf-8")
        file.replace(refused)
        _log.warning("a call failed permanently and was moved to %s: %s", refused, error)
