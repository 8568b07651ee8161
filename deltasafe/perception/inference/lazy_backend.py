"""The backend of an ensemble, created on first use: one per process, shared by its threads."""

import os
import threading
import weakref
from collections.abc import Callable

import torch

from deltasafe.perception.inference.backends import InferenceBackend

__all__ = ["LazyEngine"]


class LazyEngine:
    """Holds a backend that does not survive fork, pickle or deepcopy; each copy creates a backend of its own.

    A forked child has none of its parent's threads, and a call that waits for them never returns. So the child drops
    the backends of its parent and limits torch to one thread, since OpenMP's thread pool is lost as well.
    """

    def __init__(self) -> None:
        self._engine: InferenceBackend | None = None
        _LIVE.add(self)
        _Process.has_ensemble = True

    def get(self, create: Callable[[], InferenceBackend]) -> InferenceBackend:
        """Return the backend; call ``create`` first if this process has none yet."""
        backend = self._engine
        if backend is None:
            with _Process.creation:
                backend = self._engine = self._engine or create()
        return backend

    def __reduce__(self) -> tuple[type["LazyEngine"], tuple[()]]:
        return LazyEngine, ()

    def abandon(self) -> None:
        """Forget the backend, without destroying it: its destructor would wait for threads that do not exist here."""
        if self._engine is not None:
            _ABANDONED.append(self._engine)
        self._engine = None


_LIVE: weakref.WeakSet[LazyEngine] = weakref.WeakSet()
_ABANDONED: list[InferenceBackend] = []


class _Process:
    creation = threading.Lock()
    has_ensemble = False
    """Set with the first ensemble. Children of a process without one, as Dagster's fork server, keep their threads."""


def _reset_after_fork() -> None:
    _Process.creation = threading.Lock()  # another thread of the parent may have held it
    if _Process.has_ensemble:
        torch.set_num_threads(1)
        for each in _LIVE:
            each.abandon()


os.register_at_fork(after_in_child=_reset_after_fork)
