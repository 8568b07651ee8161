"""Read every kind of input once and plan a motion while an audit hook records every pickle that is loaded.

Python raises the audit event ``pickle.find_class`` for every class that a pickle names. Pickles without classes are
counted by wrapping the functions that load them. The one exception is numba, whose cache of compiled functions
consists of pickles. It lies beside the installed package (or in ``NUMBA_CACHE_DIR``), and a user who can write there
can change the package itself.
"""

import argparse
import pathlib
import pickle
import sys
from collections.abc import Callable
from types import FrameType
from typing import Any

from evidence.faults.inputs import all_cases, input_kinds
from evidence.faults.malformed.tasks import GOAL, START, ball_grid
from evidence.fixtures import temporary_home
from evidence.reporting import command_parser, finish

NUMBA_CACHE = ("numba.core.caching", "numba.core.serialize")
LOADERS = ("load", "loads")


class PickleMonitor:
    """Records pickles for the rest of the process, because audit hooks cannot be removed.

    Attributes:
        loaded: what was loaded and by which modules, without numba's cache.
        by_numba: number of loads by numba's cache.
    """

    def __init__(self) -> None:
        self.loaded: list[str] = []
        self.by_numba = 0
        sys.addaudithook(self._audit)
        for name in LOADERS:
            setattr(pickle, name, self._wrap(getattr(pickle, name)))

    def _audit(self, event: str, arguments: tuple[Any, ...]) -> None:
        if event == "pickle.find_class":
            self._record(".".join(map(str, arguments)))

    def _wrap(self, loader: Callable[..., Any]) -> Callable[..., Any]:
        def recorded(*arguments: Any, **options: Any) -> Any:
            self._record(loader.__name__)
            return loader(*arguments, **options)

        return recorded

    def _record(self, name: str) -> None:
        frame: FrameType | None = sys._getframe(2)
        callers = []
        while frame is not None:
            callers.append(frame.f_globals.get("__name__", "?"))
            frame = frame.f_back
        if any(caller in NUMBA_CACHE for caller in callers):
            self.by_numba += 1
        else:
            self.loaded.append(f"{name}, by {' < '.join(callers[:4])}")


def read_everything(home: pathlib.Path) -> tuple[list[str], PickleMonitor]:
    """Read a valid input of each kind and plan a motion; return the kinds and the monitor."""
    from deltasafe.planning import MotionSettings, plan_motion

    kinds = input_kinds(all_cases(home))
    monitor = PickleMonitor()
    for kind in kinds:
        out = home / f"out-{kind.name}"
        out.mkdir()
        kind.read(kind.valid, out)
    plan_motion(ball_grid(), START, GOAL, MotionSettings(n_iterations=300), 0)
    return [*(kind.name for kind in kinds), "planning"], monitor


def _detects_a_pickle(monitor: PickleMonitor) -> bool:
    loaded = getattr(pickle, LOADERS[-1])(pickle.dumps(argparse.Namespace(a=1)))
    return loaded.a == 1 and any("Namespace" in each for each in monitor.loaded)


def main(arguments: list[str] | None = None) -> int:
    """Run ``python -m evidence.faults.pickles``. The monitor stays active until the process exits."""
    options = command_parser("faults.pickles", __doc__).parse_args(arguments)
    with temporary_home() as home:
        kinds, monitor = read_everything(home)
    loaded = list(monitor.loaded)
    failures = [f"unpickled: {each}" for each in loaded]
    if not _detects_a_pickle(monitor):
        failures.append("the monitor did not detect a pickle that was loaded on purpose")
    figures = {"kinds_read": len(kinds), "pickles_loaded": len(loaded), "pickles_of_numba": monitor.by_numba}
    return finish(options, figures, failures, kinds=kinds)


if __name__ == "__main__":
    sys.exit(main())
