"""No pickle is loaded: an audit hook listens while every kind of input is read once, and a motion is planned.

Python announces each class that a pickle asks for (``pickle.find_class``); pickles that ask for none are counted where
they are opened. The one exception is numba, whose cache of compiled functions consists of pickles. It lies beside the
installed package (or in ``NUMBA_CACHE_DIR``), and who can write there can change the package itself.
"""

import argparse
import pathlib
import pickle
import shutil
import sys
import tempfile
from collections.abc import Callable
from types import FrameType
from typing import Any

from evidence.faults.inputs import all_cases
from evidence.faults.malformed.tasks import FREE, OTHER
from evidence.faults.reporting import conclude, parser

__all__ = ["Listener", "main", "read_everything"]

ALLOWED = ("numba.core.caching", "numba.core.serialize")
OPENERS = ("load", "loads")


class Listener:
    """Hears of pickles, for the life of the process.

    Attributes:
        heard: what was loaded, and by which module, other than by numba for its cache.
        of_numba: how often numba did.
    """

    def __init__(self) -> None:
        self.heard: list[str] = []
        self.of_numba = 0
        sys.addaudithook(self._hear)
        for name in OPENERS:
            setattr(pickle, name, self._opening(getattr(pickle, name)))

    def _hear(self, event: str, arguments: tuple[Any, ...]) -> None:
        if event == "pickle.find_class":
            self._note(".".join(map(str, arguments)))

    def _opening(self, opener: Callable[..., Any]) -> Callable[..., Any]:
        def open_noticed(*arguments: Any, **options: Any) -> Any:
            self._note(opener.__name__)
            return opener(*arguments, **options)

        return open_noticed

    def _note(self, what: str) -> None:
        frame: FrameType | None = sys._getframe(2)
        callers = []
        while frame is not None:
            callers.append(frame.f_globals.get("__name__", "?"))
            frame = frame.f_back
        if any(caller in ALLOWED for caller in callers):
            self.of_numba += 1
        else:
            self.heard.append(f"{what}, by {' < '.join(callers[:4])}")


def read_everything(home: pathlib.Path) -> tuple[list[str], Listener]:
    """Read a sound input of each kind; returns which there were, and who listened."""
    from deltasafe.planning import MotionSettings, plan_motion
    from deltasafe.scene import Sphere, grid_from_shapes

    doors = {case.door.name: case.door for case in all_cases(home) if case.door.name != "task"}
    listener = Listener()
    for name, door in doors.items():
        out = home / f"out-{name}"
        out.mkdir()
        door.read(door.sound, out)
    field = grid_from_shapes([Sphere((0.0, 0.0, 0.03), 0.03)], 0.01, (-0.2, -0.15, 0.0), (0.2, 0.15, 0.07), 0.005)
    plan_motion(field, FREE, OTHER, 0.0, MotionSettings(n_iterations=300), 0)
    return [*doors, "planning"], listener


def _control(listener: Listener) -> bool:
    """Whether the listener hears a pickle."""
    opened = getattr(pickle, OPENERS[-1])(pickle.dumps(argparse.Namespace(a=1)))
    return opened.a == 1 and any("Namespace" in each for each in listener.heard)


def main(arguments: list[str] | None = None) -> int:
    """``python -m evidence.faults.pickles``; listens for the life of the process, so best in one of its own."""
    options = parser(__doc__).parse_args(arguments)
    home = pathlib.Path(tempfile.mkdtemp(prefix="deltasafe-faults-"))
    try:
        kinds, listener = read_everything(home)
    finally:
        shutil.rmtree(home)
    found = list(listener.heard)
    failures = [f"unpickled: {each}" for each in found]
    if not _control(listener):
        failures.append("a pickle that was loaded on purpose was not heard")
    figures = {"kinds_read": len(kinds), "pickles_loaded": len(found), "pickles_of_numba": listener.of_numba}
    return conclude("pickles", figures, options, failures, kinds=kinds)


if __name__ == "__main__":
    sys.exit(main())
