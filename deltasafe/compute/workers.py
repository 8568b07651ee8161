"""Worker processes that can be ended at any time, with one pipe and one task each.

`concurrent.futures.ProcessPoolExecutor` was rejected: on exit it waits for running tasks, and progress reports would
need a manager process.
"""

import contextlib
import multiprocessing
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from multiprocessing import resource_tracker
from multiprocessing.connection import Connection, wait
from multiprocessing.context import SpawnContext
from multiprocessing.pool import ExceptionWithTraceback  # type: ignore[attr-defined]
from multiprocessing.reduction import ForkingPickler
from typing import Any

from deltasafe.compute.interrupts import interrupts_delayed, sigint_blocked
from deltasafe.compute.parent_watchdog import end_with_parent

REPORT, RESULT, ERROR, LOST = "report", "result", "error", "lost"
"""Kinds of messages from a worker. ``LOST``: its process ended before its task did."""
_GRACE_S = 2.0
"""From SIGTERM to SIGKILL. Tasks write atomically, and long ones have checkpoints."""


class Workers:
    """Up to ``count`` worker processes, started on demand. The loss of a process affects only its own task."""

    def __init__(self, count: int) -> None:
        self._count = count
        self._context = multiprocessing.get_context("spawn")
        self._workers: list[Worker] = []

    def idle(self) -> "Worker | None":
        """Return a worker without a task; None if all are busy."""
        for worker in self._workers:
            if worker.index is None:
                return worker
        if len(self._workers) == self._count:
            return None
        with interrupts_delayed():
            self._workers.append(Worker(self._context))
        return self._workers[-1]

    def busy(self) -> "list[Worker]":
        """Return the workers with a task."""
        return [worker for worker in self._workers if worker.index is not None]

    def messages(self) -> Iterator[tuple[int, str, Any]]:
        """Wait for messages; yield at most one per busy worker: index of its task, kind, value."""
        busy = self.busy()
        wait([each for worker in busy for each in (worker.pipe, worker.process.sentinel)])
        for worker in busy:
            message = worker.receive()
            if message is None:
                continue
            index, (kind, value) = worker.index, message
            assert index is not None
            if kind != REPORT:
                worker.index = None
            if kind == LOST:
                _end([worker])
                self._workers.remove(worker)
            yield index, kind, value

    def end(self) -> None:
        """End all workers. Call it again if an interrupt raises an exception before it has finished."""
        _end(self._workers)


class Worker:
    """A process that runs one task at a time.

    Attributes:
        index: index of the running task; None if the worker is idle.
        pipe: the parent's end of the pipe.
    """

    def __init__(self, context: SpawnContext) -> None:
        self.index: int | None = None
        self.pipe, theirs = context.Pipe()
        # daemon: as a last resort, multiprocessing ends it at exit
        self.process = context.Process(target=_serve, args=(theirs,), name="worker", daemon=True)
        resource_tracker.ensure_running()  # the first process would start it, and that unblocks SIGINT
        with contextlib.closing(theirs), sigint_blocked():
            self.process.start()

    def begin(self, index: int, work: Callable[..., Any], reports: bool, arguments: tuple[Any, ...]) -> None:
        """Send a task; with ``reports``, its first argument is a callable that sends a report."""
        self.index = index
        with contextlib.suppress(BrokenPipeError, ConnectionResetError):  # the process was killed; `receive` reports it
            self.pipe.send((work, reports, arguments))

    def receive(self) -> tuple[str, Any] | None:
        """Return the next message, kind and value; None if there is none yet."""
        is_alive = self.process.is_alive()  # checked first: the last message may arrive just before the end
        try:
            if self.pipe.poll():
                message: tuple[str, Any] = self.pipe.recv()
                return message
        except (EOFError, OSError):
            return LOST, None
        return None if is_alive else (LOST, None)


def _end(workers: "Sequence[Worker]") -> None:
    """Send SIGTERM, after ``_GRACE_S`` SIGKILL, and wait for all, with interrupts delayed."""
    with interrupts_delayed():
        for worker in workers:
            worker.process.terminate()
        until_s = time.monotonic() + _GRACE_S
        for worker in workers:
            worker.process.join(max(0.0, until_s - time.monotonic()))
        for worker in workers:
            worker.process.kill()
            worker.process.join(_GRACE_S)
            worker.pipe.close()


def _serve(pipe: Connection) -> None:
    """Run tasks until the parent ends this process or closes the pipe."""
    end_with_parent()
    sending = threading.Lock()

    def send(kind: str, value: Any) -> None:
        with sending:
            pipe.send((kind, value))

    def report(value: Any) -> None:
        send(REPORT, value)

    with contextlib.suppress(EOFError, OSError):  # the parent has ended
        while True:
            sent = pipe.recv_bytes()
            try:
                work, reports, arguments = ForkingPickler.loads(sent)
                send(RESULT, work(*([report] if reports else []), *arguments))
            except BaseException as error:
                send(ERROR, _sendable(error))


def _sendable(error: BaseException) -> Any:
    """Return the error with its traceback as the cause, or its text if pickling does not preserve it."""
    try:
        wrapped = ExceptionWithTraceback(error, error.__traceback__)
        ForkingPickler.loads(ForkingPickler.dumps(wrapped))
    except Exception:
        return RuntimeError(f"{type(error).__name__}: {error}")
    return wrapped
