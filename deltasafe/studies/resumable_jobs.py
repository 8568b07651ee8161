"""Work in batches that are files: finished ones are found again, the others are done side by side."""

import contextlib
import dataclasses
import pathlib
import time
import zipfile
from collections.abc import Callable, Mapping, Sequence
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from deltasafe.compute.code_digest import digest_of_code
from deltasafe.compute.executor import LOCAL, Executor, Task
from deltasafe.compute.progress import Progress, silent
from deltasafe.errors import DataError, SettingsError
from deltasafe.io.storage import atomic_file, digest_of

__all__ = ["Batch", "Effort", "run_batches"]

Batch: TypeAlias = Mapping[str, NDArray[Any]]


@dataclasses.dataclass(frozen=True)
class Effort:
    """What all batches took, those included that were found.

    Attributes:
        minutes: by the clock if all were made in one go; else the sum over batches by how many are done side by side.
        cpu_minutes: of all processes together, without their start.
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
    """``work(*arguments)`` for every job ``(name, arguments)``, in the order of the jobs, and what that took.

    A batch is stored as `NAME-DIGEST.npz`, the digest being that of its arguments and of the code that makes it: a run
    that was interrupted goes on where it stopped, and one with other settings or other code begins anew.

    Args:
        work: a function of a module, whose arguments have a JSON form.
        workers: processes; with one, the work is done in this process.
        executor: where the work is done.

    Raises:
        WorkerLostError: names a batch whose process was lost again and again.
        DataError: a file is there and is no batch.
    """
    if workers < 1:
        raise SettingsError(f"workers must be at least 1, got {workers}")
    began_s = time.monotonic()
    folder, code = pathlib.Path(folder), digest_of_code(work)
    files = [
        folder / f"{name}-{digest_of([work.__module__, work.__qualname__, code, arguments])[:16]}.npz"
        for name, arguments in jobs
    ]
    missing = [index for index, file in enumerate(files) if not file.is_file()]
    found = done = len(jobs) - len(missing)
    progress(done, len(jobs), "batches were already there" if done else "batches to do")

    def left(name: str) -> str:
        minutes = (time.monotonic() - began_s) / (done - found) * (len(jobs) - done) / 60
        return f"{name}; about {minutes:.0f} min left" if done < len(jobs) else name

    tasks = [Task(jobs[index][0], _timed, (work, jobs[index][1])) for index in missing]
    with contextlib.closing(executor.run(tasks, workers)) as finished:
        for position, arrays in finished:
            with atomic_file(files[missing[position]]) as temporary:
                np.savez_compressed(temporary, **arrays)
            done += 1
            progress(done, len(jobs), left(tasks[position].name))
    batches = [_read(file) for file in files]
    minutes = (time.monotonic() - began_s) / 60
    if len(missing) < len(jobs):
        minutes = sum(float(batch["wall_s"]) for batch in batches) / 60 / executor.width(workers)
    return batches, Effort(minutes, sum(float(batch["cpu_s"]) for batch in batches) / 60)


def _timed(work: Callable[..., Batch], arguments: tuple[Any, ...]) -> dict[str, NDArray[Any]]:
    wall_s, cpu_s = time.monotonic(), time.process_time()
    arrays = dict(work(*arguments))
    arrays["wall_s"], arrays["cpu_s"] = np.array(time.monotonic() - wall_s), np.array(time.process_time() - cpu_s)
    return arrays


def _read(file: pathlib.Path) -> Batch:
    try:
        with file.open("rb") as stream, np.load(stream, allow_pickle=False) as arrays:
            return {name: arrays[name] for name in arrays.files}
    except (OSError, EOFError, ValueError, zipfile.BadZipFile) as error:
        raise DataError(file, f"is not a finished batch ({error}); delete it, and it is made again") from error
