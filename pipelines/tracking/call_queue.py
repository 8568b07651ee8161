"""Calls to a tracking server that may be away: written down first, made in order, removed once they are made."""

import logging
import pathlib
import re
import time
import uuid
from collections.abc import Callable, Mapping
from typing import Any

from deltasafe.io.storage import read_json, write_json

__all__ = ["PendingCalls"]

_log = logging.getLogger("deltasafe.tracking")
_PASSING = re.compile(
    r"disk is full|disk I/O|No space left|too large|is locked"
    r"|readonly database|unable to open|Permission denied|Read-only"
)


class PendingCalls:
    """A folder with one file a call, named by the time at which it was asked for.

    A call is made again if the process died between making it and removing its file, so making a call twice must
    do what making it once does.

    Args:
        folder: below the home; calls that can never be made are set aside in ``refused/`` with the reason.
    """

    def __init__(self, folder: pathlib.Path) -> None:
        self.folder = folder

    def add(self, name: str, arguments: Mapping[str, Any]) -> pathlib.Path:
        """Write the call down, whole or not at all."""
        file = self.folder / f"{time.time_ns():020d}-{uuid.uuid4().hex[:8]}.json"
        write_json(file, {"call": name, "arguments": dict(arguments)})
        return file

    def files(self) -> list[pathlib.Path]:
        """Calls that were not made yet, oldest first."""
        return sorted(path for path in self.folder.glob("*.json") if not path.name.startswith("."))

    def make_all(
        self, make: Callable[[str, dict[str, Any]], Any], reachable: Callable[[], bool]
    ) -> dict[pathlib.Path, Any]:
        """Make the calls in order until the server is away; what each returned, by file.

        Args:
            make: makes one call, given its name and arguments.
            reachable: asked after a failure: if the server is there, the call itself is at fault, and is set aside;
                unless the fault is one that passes (no room, no permission, a locked database).
        """
        made: dict[pathlib.Path, Any] = {}
        for file in self.files():
            try:
                call = read_json(file)
                made[file] = make(call["call"], call["arguments"])
            except Exception as error:  # whatever it is, a training must not die of it
                if not reachable() or _PASSING.search(f"{error} {error.__cause__}"):
                    _log.warning("%d calls wait in %s: %s", len(self.files()), self.folder, error)
                    break
                self._set_aside(file, error)
            else:
                file.unlink()
        return made

    def _set_aside(self, file: pathlib.Path, error: Exception) -> None:
        refused = self.folder / "refused" / file.name
        refused.parent.mkdir(exist_ok=True)
        refused.with_suffix(".txt").write_text(f"{type(error).__name__}: {error}\n", encoding="utf-8")
        file.replace(refused)
        _log.warning("could not be recorded and was set aside in %s: %s", refused, error)
