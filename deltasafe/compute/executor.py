"""Where long work is done: one verb, behind which stand processes of this machine or those of a cluster.

Studies (`batches`) and trainings (`perception.ensemble_training`) know no more of a machine than this. What asks all
members of an ensemble at once is called an executor as well (`perception.executor`) and is something else.
"""

import collections
import concurrent.futures
import contextlib
import dataclasses
import multiprocessing
import os
import queue
from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent.futures.process import BrokenProcessPool
from multiprocessing.managers import SyncManager
from typing import Any, Protocol

from deltasafe.compute.parent_watchdog import end_with_parent
from deltasafe.errors import SettingsError, WorkerLostError

__all__ = ["LOCAL", "RETRIES", "Executor", "LocalExecutor", "Needs", "Task", "lost"]

RETRIES = 2
"""How often a task is done again whose worker was lost: killed, out of memory, its machine gone."""


@dataclasses.dataclass(frozen=True)
class Task:
    """A call to be made somewhere: ``work(*arguments)``.

    Attributes:
        name: how errors call it.
        work: a function of a module. Where somebody listens, its first argument is a callable that takes a report.
        arguments: they and the result are sent between processes, and are therefore small; paths are read there.
    """

    name: str
    work: Callable[..., Any]
    arguments: tuple[Any, ...] = ()


@dataclasses.dataclass(frozen=True)
class Needs:
    """What each of some tasks needs.

    Attributes:
        threads: that it uses.
        gpu: a share of one, where the executor gives shares and has been told how large they are.
        apart: a process of its own, though it be the only one; for work that changes the process that it is done in.
    """

    threads: int = 1
    gpu: bool = False
    apart: bool = False


class Executor(Protocol):
    """A place where tasks are done. What they return does not depend on it."""

    def rounds(self, n_tasks: int, workers: int) -> Sequence[tuple[int, int]]:
        """How many trainings are side by side, round after round, and with how many threads each.

        Args:
            workers: how many are wanted side by side on one machine.
        """
        ...

    def width(self, workers: int) -> int:
        """How many tasks of one thread are done side by side, if ``workers`` are wanted of one machine."""
        ...

    def run(
        self,
        tasks: Sequence[Task],
        workers: int,
        needs: Needs = ...,
        hear: Callable[[Any], None] | None = None,
    ) -> Generator[tuple[int, Any], None, None]:
        """Do all tasks; the position and the result of each as it ends. To be closed by whoever stops listening.

        A task whose worker is lost is done again, ``RETRIES`` times at most. After an error no further task is begun.

        Args:
            hear: takes what tasks report underway; called here, between results.

        Raises:
            WorkerLostError: names the task that loses its workers.
        """
        ...


def lost(task: Task, reason: str = "") -> WorkerLostError:
    """The error of a task that lost its worker once too often."""
    return WorkerLostError(
        f"{task.name}: the process that did it was lost {RETRIES + 1} times{reason and f' ({reason})'}; look for what "
        "ends it (memory, as a rule) and run it again with fewer workers: what is finished is found"
    )


class LocalExecutor:
    """Processes of this machine; one worker is this process itself."""

    def rounds(self, n_tasks: int, workers: int) -> list[tuple[int, int]]:
        """As many as there are workers, the machine's cores shared among them; a last, smaller round has more each."""
        cores = os.cpu_count() or 1
        sizes = [min(workers, n_tasks - first) for first in range(0, n_tasks, workers)]
        return [(size, max(1, cores // size)) for size in sizes]

    def width(self, workers: int) -> int:
        """Exactly the workers."""
        return workers

    def run(
        self,
        tasks: Sequence[Task],
        workers: int,
        needs: Needs = Needs(),
        hear: Callable[[Any], None] | None = None,
    ) -> Generator[tuple[int, Any], None, None]:
        """See `Executor`."""
        if workers < 1:
            raise SettingsError(f"workers must be at least 1, got {workers}")
        if not needs.apart and min(workers, len(tasks)) <= 1:
            for index, task in enumerate(tasks):
                yield index, task.work(*([] if hear is None else [hear]), *task.arguments)
            return
        context = multiprocessing.get_context("spawn")
        with _reports(context, hear) as reports, _Slots(context, min(workers, len(tasks))) as slots:
            yield from _all(tasks, slots, reports, hear)


LOCAL = LocalExecutor()


class _Slots:
    """Pools of one process each, so that a process which is lost takes no other one's task with it."""

    def __init__(self, context: Any, count: int) -> None:
        self._context = context
        self._pools = [self._pool() for _ in range(count)]
        self.free = list(range(count))

    def __enter__(self) -> "_Slots":
        return self

    def __exit__(self, *exception: object) -> None:
        for pool in self._pools:
            pool.shutdown(cancel_futures=True)

    def submit(self, slot: int, call: Callable[..., Any], *arguments: Any) -> "concurrent.futures.Future[Any]":
        return self._pools[slot].submit(call, *arguments)

    def renew(self, slot: int) -> None:
        self._pools[slot].shutdown()
        self._pools[slot] = self._pool()

    def _pool(self) -> concurrent.futures.ProcessPoolExecutor:
        return concurrent.futures.ProcessPoolExecutor(1, self._context, end_with_parent)


def _all(
    tasks: Sequence[Task], slots: _Slots, reports: Any, hear: Callable[[Any], None] | None
) -> Iterator[tuple[int, Any]]:
    waiting = collections.deque(range(len(tasks)))
    tries = [0] * len(tasks)
    running: dict[concurrent.futures.Future[Any], tuple[int, int]] = {}
    failure: Exception | None = None
    while running or (waiting and failure is None):
        while waiting and slots.free and failure is None:
            index, slot = waiting.popleft(), slots.free.pop()
            task = tasks[index]
            told = () if hear is None else (_Tell(reports),)
            running[slots.submit(slot, task.work, *told, *task.arguments)] = index, slot
        for future in _ended(running, reports, hear):
            index, slot = running.pop(future)
            slots.free.append(slot)
            try:
                result = future.result()
            except BrokenProcessPool:
                slots.renew(slot)
                tries[index] += 1
                if tries[index] > RETRIES:
                    failure = failure or lost(tasks[index])
                else:
                    waiting.appendleft(index)
            except Exception as error:  # what is underway is finished and handed over first
                failure = failure or error
            else:
                yield index, result
    if hear is not None:
        with contextlib.suppress(queue.Empty):
            while True:
                hear(reports.get_nowait())
    if failure is not None:
        raise failure


def _ended(
    running: dict["concurrent.futures.Future[Any]", tuple[int, int]],
    reports: Any,
    hear: Callable[[Any], None] | None,
) -> list["concurrent.futures.Future[Any]"]:
    if hear is None:
        return list(concurrent.futures.wait(running, return_when=concurrent.futures.FIRST_COMPLETED).done)
    with contextlib.suppress(queue.Empty):
        hear(reports.get(timeout=0.5))
    return [future for future in running if future.done()]


@contextlib.contextmanager
def _reports(context: Any, hear: Callable[[Any], None] | None) -> Iterator[Any]:
    """A queue between processes, if somebody listens."""
    if hear is None:
        yield None
        return
    manager = SyncManager(ctx=context)
    manager.start(end_with_parent)
    with manager:
        yield manager.Queue()


@dataclasses.dataclass(frozen=True)
class _Tell:
    reports: Any

    def __call__(self, report: Any) -> None:
        self.reports.put(report)
