"""The backend of an ensemble, created on first use: one per process, shared by its threads."""

import os
import threading
import weakref
from collections.abc import Callable

import torch

from deltasafe.perception.inference.backends import InferenceBackend


class LazyBackend:
    """Holds a backend, which cannot be forked, pickled or copied; each copy creates its own.

    A forked process has none of its parent's threads, so a call that waits for one of them blocks forever. After a fork
    the child therefore drops its parent's backends. It also limits torch to one thread, as OpenMP's pool is lost too.
    """

    def __init__(self) -> None:
        self._backend: InferenceBackend | None = None
        _INSTANCES.add(self)
        _Process.has_ensemble = True

    def get(self, create: Callable[[], InferenceBackend]) -> InferenceBackend:
        """Return the backend; call ``create`` first if this process has none yet."""
        backend = self._backend
        if backend is None:
            with _Process.creation_lock:
                backend = self._backend = self._backend or create()
        return backend

    def __reduce__(self) -> tuple[type["LazyBackend"], tuple[()]]:
        return LazyBackend, ()

    def drop(self) -> None:
        """Drop the backend but keep it alive: its destructor would wait for threads that a fork did not copy."""
        if self._backend is not None:
            _DROPPED.append(self._backend)
        self._backend = None


_INSTANCES: weakref.WeakSet[LazyBackend] = weakref.WeakSet()
_DROPPED: list[InferenceBackend] = []


class _Process:
    creation_lock = threading.Lock()
    has_ensemble = False
    """Children of a process without an ensemble, such as Dagster's fork server, keep their threads."""


def _reset_after_fork() -> None:
    _Process.creation_lock = threading.Lock()  # another thread of the parent may have held it
    if _Process.has_ensemble:
        torch.set_num_threads(1)
        for each in _INSTANCES:
            each.drop()


os.register_at_fork(after_in_child=_reset_after_fork)
