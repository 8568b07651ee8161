"""A queue on disk for calls to a tracking server that may be away: one file per call, replayed in order."""

import contextlib
import logging
import pathlib
import time
import uuid
from collections.abc import Callable, Mapping
from typing import Any

from deltasafe.errors import DataError
from deltasafe.io.storage import read_json, write_json
from pipelines.addresses import masked

_log = logging.getLogger("deltasafe.tracking")


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
        self, make: Callable[[str, dict[str, Any]], Any], waits: Callable[[Exception], bool]
    ) -> dict[pathlib.Path, Any]:
        """Make the pending calls in order until one has to wait; return their results by file.

        Args:
            make: makes one call, given its name and arguments.
            waits: returns whether a call that failed with an error is kept for later. Otherwise it is refused.
        """
        results: dict[pathlib.Path, Any] = {}
        for file in self.files():
            try:
                call = read_json(file)
                results[file] = make(call["call"], call["arguments"])
            except Exception as error:  # a failure to record must never end a training
                if waits(error):
                    _log.warning("%d calls wait in %s: %s", len(self.files()), self.folder, masked(error))
                    break
                self._refuse(file, error)
            else:
                file.unlink()
        return results

    def refused(self) -> list[tuple[pathlib.Path, str, str]]:
        """Return file, name and reason of all refused calls, oldest first."""
        found = []
        for file in sorted((self.folder / "refused").glob("*.json")):
            reason, name = file.with_suffix(".txt"), "unreadable"
            with contextlib.suppress(DataError, KeyError, TypeError):
                call = read_json(file)
                name = f"{call['call']} of {call['arguments'].get('artifact') or call['arguments'].get('folder', '?')}"
            found.append((file, name, reason.read_text(encoding="utf-8").strip() if reason.is_file() else "?"))
        return found

    def restore_refused(self) -> None:
        """Move the refused calls back to the pending ones; the order by time remains."""
        for file, *_ in self.refused():
            file.replace(self.folder / file.name)
            file.with_suffix(".txt").unlink(missing_ok=True)

    def _refuse(self, file: pathlib.Path, error: Exception) -> None:
        refused, reason = self.folder / "refused" / file.name, masked(f"{type(error).__name__}: {error}")
        refused.parent.mkdir(exist_ok=True)
        refused.with_suffix(".txt").write_text(f"{reason}\n", encoding="utf-8")
        file.replace(refused)
        _log.warning("a call failed permanently and was moved to %s: %s", refused, reason)
