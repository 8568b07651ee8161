"""Resumable jobs: each result is a file, finished ones are reused, the others are computed in parallel."""

import contextlib
import dataclasses
import pathlib
import time
from collections.abc import Callable, Mapping, Sequence
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from deltasafe.compute.code_digest import digest_of_code
from deltasafe.compute.executor import LOCAL, Executor, Task
from deltasafe.compute.progress import Progress, silent
from deltasafe.errors import DataError, SettingsError
from deltasafe.io.arrays import read_npz
from deltasafe.io.storage import atomic_file, digest_of

Batch: TypeAlias = Mapping[str, NDArray[Any]]


@dataclasses.dataclass(frozen=True)
class Effort:
    """Time spent on all batches, reused ones included.

    Attributes:
        minutes: wall time if all batches were computed in one call; else the sum of their wall times, divided by the
            number of parallel tasks.
        cpu_minutes: CPU time of all processes, without their startup.
    """

    minutes: float
    cpu_minutes: float


def run_batches(
    work: Callable[..., Batch],
    jobs: Sequence[tuple[str, tuple[Any, ...]]],
    folder: str | pathlib.Path,
    workers: int = 1,
    progress: Progress = silent,
    *,
    executor: Executor = LOCAL,
) -> tuple[list[Batch], Effort]:
    """Compute ``work(*arguments)`` for every job ``(name, arguments)``; return the results in the order of the jobs.

    A batch is stored as `NAME-DIGEST.npz`. The digest covers its arguments and the code of ``work`` with everything
    that it imports. An interrupted call therefore resumes, and other settings or other code give new files.

    Args:
        work: a function of a module, whose arguments have a JSON form.
        workers: number of processes; with one, the work runs in this process.
        executor: runs the work, locally or on a cluster.

    Raises:
        WorkerLostError: names a batch whose process was lost repeatedly.
        DataError: the file of a batch is damaged.
    """
    if workers < 1:
        raise SettingsError(f"workers must be at least 1, got {workers}")
    started_s = time.monotonic()
    folder, code = pathlib.Path(folder), digest_of_code(work)
    files = [
        folder / f"{name}-{digest_of([work.__module__, work.__qualname__, code, arguments])[:16]}.npz"
        for name, arguments in jobs
    ]
    missing = [index for index, file in enumerate(files) if not file.is_file()]
    reused = done = len(jobs) - len(missing)
    progress(done, len(jobs), "finished batches reused" if done else "batches to do")

    def status(name: str) -> str:
        minutes = (time.monotonic() - started_s) / (done - reused) * (len(jobs) - done) / 60
        return f"{name}; about {minutes:.0f} min left" if done < len(jobs) else name

    tasks = [Task(jobs[index][0], _timed, (work, jobs[index][1])) for index in missing]
    with contextlib.closing(executor.run(tasks, workers)) as finished:
        for position, arrays in finished:
            with atomic_file(files[missing[position]]) as temporary:
                np.savez_compressed(temporary, **arrays)
            done += 1
            progress(done, len(jobs), status(tasks[position].name))
    batches = [_read(file) for file in files]
    minutes = (time.monotonic() - started_s) / 60
    if len(missing) < len(jobs):
        minutes = sum(float(batch["wall_s"]) for batch in batches) / 60 / executor.n_parallel(workers)
    return batches, Effort(minutes, sum(float(batch["cpu_s"]) for batch in batches) / 60)


def _timed(work: Callable[..., Batch], arguments: tuple[Any, ...]) -> dict[str, NDArray[Any]]:
    """Call ``work``; add wall time and CPU time to its result."""
    wall_s, cpu_s = time.monotonic(), time.process_time()
    arrays = dict(work(*arguments))
    arrays["wall_s"], arrays["cpu_s"] = np.array(time.monotonic() - wall_s), np.array(time.process_time() - cpu_s)
    return arrays


def _read(file: pathlib.Path) -> Batch:
    try:
        return read_npz(file)
    except DataError as error:
        raise DataError(file, f"is not a finished batch ({error.reason}); delete it to compute it again") from error
