"""Where long work is done: one verb, behind which stand processes of this machine or those of a cluster.

Studies (`batches`) and trainings (`perception.ensemble_training`) know no more of a machine than this. What asks all
members of an ensemble at once is called an executor as well (`perception.executor`) and is something else.
"""

import collections
import dataclasses
import os
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from typing import Any, Protocol

from deltasafe.compute.workers import ERROR, LOST, REPORT, RESULT, Workers
from deltasafe.errors import SettingsError, WorkerLostError

__all__ = ["LOCAL", "RETRIES", "Executor", "LocalExecutor", "Needs", "Task", "in_order", "lost"]

RETRIES = 2
"""How often a task is done again whose worker was lost: killed, out of memory, its machine gone."""


@dataclasses.dataclass(frozen=True)
class Task:
    """A call to be made somewhere: ``work(*arguments)``. It starts no processes by `multiprocessing` itself.

    Attributes:
        name: how errors call it.
        work: a function of a module. If ``hear`` is given, its first argument is a callable that takes a report.
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
        """Do all tasks; yield the position and the result of each as it ends.

        A task whose worker is lost is done again, ``RETRIES`` times at most. After an error no further task is begun.
        Closing the generator, or an interrupt, ends the tasks under way; close it with `contextlib.closing`.

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


def in_order(finished: Iterable[tuple[int, Any]]) -> Iterator[Any]:
    """Yield the results of `Executor.run` in the order of the tasks; results that come early are kept."""
    early: dict[int, Any] = {}
    n_yielded = 0
    for index, result in finished:
        early[index] = result
        while n_yielded in early:
            yield early.pop(n_yielded)
            n_yielded += 1


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
        """See `Executor`. All workers have ended when this returns or raises."""
        if workers < 1:
            raise SettingsError(f"workers must be at least 1, got {workers}")
        if not needs.apart and min(workers, len(tasks)) <= 1:
            for index, task in enumerate(tasks):
                yield index, task.work(*([] if hear is None else [hear]), *task.arguments)
            return
        started = Workers(min(workers, len(tasks)))
        try:
            yield from _all(tasks, started, hear)
        finally:
            try:
                started.end()
            except BaseException:  # a second interrupt, in the moment before interrupts are delayed
                started.end()
                raise


LOCAL = LocalExecutor()


def _all(tasks: Sequence[Task], workers: Workers, hear: Callable[[Any], None] | None) -> Iterator[tuple[int, Any]]:
    waiting = collections.deque(range(len(tasks)))
    tries = [0] * len(tasks)
    failure: BaseException | None = None
    while workers.busy() or (waiting and failure is None):
        while waiting and failure is None and (worker := workers.idle()) is not None:
            task = tasks[waiting[0]]
            worker.begin(waiting.popleft(), task.work, hear is not None, task.arguments)
        for index, kind, value in workers.messages():
            if kind == REPORT and hear is not None:
                hear(value)
            elif kind == RESULT:
                yield index, value
            elif kind == ERROR:  # what is under way is finished and yielded first
                failure = failure or value
            elif kind == LOST:
                tries[index] += 1
                if tries[index] > RETRIES:
                    failure = failure or lost(tasks[index])
                else:
                    waiting.appendleft(index)
    if failure is not None:
        raise failure
