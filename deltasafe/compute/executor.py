"""Run tasks in worker processes: the executor protocol, and the executor for one machine.

The executor for a Ray cluster is in `deltasafe.compute.ray_executor`.
"""

import collections
import dataclasses
import os
from collections.abc import Callable, Generator, Iterator, Sequence
from typing import Any, Protocol

from deltasafe.compute.workers import ERROR, LOST, REPORT, RESULT, Workers
from deltasafe.errors import SettingsError, WorkerLostError

RETRIES = 2
"""How often a task is retried after its worker process was lost (killed, out of memory, machine failure)."""


@dataclasses.dataclass(frozen=True)
class Task:
    """A call of ``work(*arguments)`` in some process. It must not start processes with `multiprocessing`.

    Attributes:
        name: name of the task in error messages.
        work: a module-level function. If `Executor.run` has ``on_report``, its first argument is a report callback.
        arguments: pickled, like the result. Keep both small, and pass paths instead of data.
    """

    name: str
    work: Callable[..., Any]
    arguments: tuple[Any, ...] = ()


@dataclasses.dataclass(frozen=True)
class Needs:
    """Resources of each of several tasks.

    Attributes:
        threads: number of threads that a task uses.
        gpu: whether a task uses a GPU, or the configured fraction of one.
        own_process: run in a separate process even if there is only one task, because it changes its process.
    """

    threads: int = 1
    gpu: bool = False
    own_process: bool = False


class Executor(Protocol):
    """Runs tasks. The results do not depend on which executor runs them."""

    def rounds(self, n_tasks: int, workers: int) -> Sequence[tuple[int, int]]:
        """Split trainings into rounds: number of parallel trainings and threads of each, for every round.

        Args:
            n_tasks: number of trainings.
            workers: number of parallel trainings wanted on one machine.
        """
        ...

    def n_parallel(self, workers: int) -> int:
        """Return how many single-threaded tasks run in parallel if ``workers`` are wanted on one machine."""
        ...

    def run(
        self,
        tasks: Sequence[Task],
        workers: int,
        needs: Needs = ...,
        on_report: Callable[[Any], None] | None = None,
    ) -> Generator[tuple[int, Any], None, None]:
        """Run all tasks; yield the index and the result of each task when it finishes.

        A task whose worker process is lost is retried up to ``RETRIES`` times. After an error, no further task starts.
        Closing the generator, or an interrupt, ends the running tasks; close it with `contextlib.closing`.

        Args:
            on_report: called in this process with the reports of running tasks, between results.

        Raises:
            WorkerLostError: a task lost its worker process on every attempt.
        """
        ...


def worker_lost_error(task: Task, reason: str = "") -> WorkerLostError:
    """Create the error of a task that lost its worker process on every attempt."""
    return WorkerLostError(
        f"{task.name}: the process that ran it was lost {RETRIES + 1} times{reason and f' ({reason})'}; find out what "
        "ends it. Too little memory: run again with fewer workers, finished work is kept. A script that starts workers "
        'needs the guard `if __name__ == "__main__":`'
    )


class LocalExecutor:
    """Runs tasks in processes of this machine; with one worker, in this process."""

    def rounds(self, n_tasks: int, workers: int) -> list[tuple[int, int]]:
        """Split into rounds of ``workers`` tasks that share the cores; the tasks of a smaller last round get more."""
        cores = os.cpu_count() or 1
        sizes = [min(workers, n_tasks - first) for first in range(0, n_tasks, workers)]
        return [(size, max(1, cores // size)) for size in sizes]

    def n_parallel(self, workers: int) -> int:
        """Return ``workers``."""
        return workers

    def run(
        self,
        tasks: Sequence[Task],
        workers: int,
        needs: Needs = Needs(),
        on_report: Callable[[Any], None] | None = None,
    ) -> Generator[tuple[int, Any], None, None]:
        """Run all tasks, as `Executor.run`. All worker processes have ended when this returns or raises."""
        if workers < 1:
            raise SettingsError(f"workers must be at least 1, got {workers}")
        if not needs.own_process and min(workers, len(tasks)) <= 1:
            for index, task in enumerate(tasks):
                yield index, task.work(*([] if on_report is None else [on_report]), *task.arguments)
            return
        pool = Workers(min(workers, len(tasks)))
        try:
            yield from _run_all(tasks, pool, on_report)
        finally:
            try:
                pool.end()
            except BaseException:  # a second interrupt, just before interrupts are delayed
                pool.end()
                raise


LOCAL = LocalExecutor()


def _run_all(
    tasks: Sequence[Task], pool: Workers, on_report: Callable[[Any], None] | None
) -> Iterator[tuple[int, Any]]:
    waiting = collections.deque(range(len(tasks)))
    n_losses = [0] * len(tasks)
    failure: BaseException | None = None
    while pool.busy() or (waiting and failure is None):
        while waiting and failure is None and (worker := pool.idle()) is not None:
            task = tasks[waiting[0]]
            worker.begin(waiting.popleft(), task.work, on_report is not None, task.arguments)
        for index, kind, value in pool.messages():
            if kind == REPORT and on_report is not None:
                on_report(value)
            elif kind == RESULT:
                yield index, value
            elif kind == ERROR:  # raised after the running tasks have finished and their results were yielded
                failure = failure or value
            elif kind == LOST:
                n_losses[index] += 1
                if n_losses[index] > RETRIES:
                    failure = failure or worker_lost_error(tasks[index])
                else:
                    waiting.appendleft(index)
    if failure is not None:
        raise failure
