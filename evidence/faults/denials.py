"""No room, no permission, no tracking server, a locked database: a clear error or a call that waits, the old intact."""

import os
import pathlib
import resource
import shutil
import signal
import sqlite3
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from functools import partial
from random import Random

from deltasafe.errors import WriteError
from deltasafe.siblings import left_behind
from evidence.faults.judging import as_reader
from evidence.faults.killing import Writer, run_alone, start_alone
from evidence.faults.reporting import conclude, parser, progress_every
from evidence.faults.writers import prepared_writers
from pipelines.home import TRACKING_VARIABLE

__all__ = ["deny", "main", "no_permission", "no_room"]

Denial = Callable[[], AbstractContextManager[object]]
ALIAS = "registry alias"
COMMITTED = " | committed before that: "
"""What a writer of two things (an execution, then its log) has finished by then, stays."""
NOBODY = "http://127.0.0.1:9"


@contextmanager
def no_room(limit_bytes: int) -> Iterator[None]:
    """No file can become larger; how a full disk looks to a program, but for the number of the error."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    handler = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (limit_bytes, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
        signal.signal(signal.SIGXFSZ, handler)


@contextmanager
def no_permission(home: pathlib.Path) -> Iterator[None]:
    """Everything below can be read, and nothing written; whoever is privileged forgoes it."""
    folders = [home, *(path for path in home.rglob("*") if path.is_dir() and not path.is_symlink())]
    for folder in folders:
        folder.chmod(0o555)
    try:
        with as_reader():
            yield
    finally:
        for folder in folders:
            folder.chmod(0o755)


@contextmanager
def nobody_answers() -> Iterator[None]:
    """The tracking server is away."""
    os.environ[TRACKING_VARIABLE] = NOBODY
    try:
        yield
    finally:
        del os.environ[TRACKING_VARIABLE]


@contextmanager
def locked_database(home: pathlib.Path) -> Iterator[None]:
    """Somebody else writes to MLflow's database and does not come to an end."""
    with sqlite3.connect(home / "mlflow" / "mlflow.db") as other:
        other.execute("BEGIN EXCLUSIVE")
        yield
        other.rollback()


def deny(writer: Writer, home: pathlib.Path, what: str, denial: Denial) -> str:
    """Write one version, be denied the next, and write it after all; what was wrong, or nothing."""
    home.mkdir(parents=True)
    following = 1 + writer.per_run
    if said := run_alone(partial(writer.write, home, 1, lambda done: None)):
        return f"{writer.name} cannot even be written: {said}"
    before = run_alone(lambda: str(writer.read(home)))
    said, _, committed = run_alone(partial(_denied, writer, home, following, denial)).partition(COMMITTED)
    between = run_alone(lambda: str(writer.read(home)))
    left = [path.name for path in left_behind(home)]
    after = run_alone(partial(_write_and_read, writer, home, following))
    wanted = str(following + writer.per_run - 1)
    wrong = {
        said: bool(said) and not (said.startswith("WriteError: ") and "; " in said),
        f"no error, and {between} stands there": not said and between != wanted,
        f"{before} stood there, and now {between}": bool(said) and between not in (before, committed),
        f"left {left}": bool(left),
        f"afterwards: {after}": after != wanted,
    }
    return "".join(f"{writer.name}, {what}: {words}. " for words, holds in wrong.items() if holds)


def _denied(writer: Writer, home: pathlib.Path, number: int, denial: Denial) -> str:
    # what is imported and read on the way must have been, by who may: the interpreter can be out of others' reach
    writer.write(home.with_name(f"{home.name} before"), 1, lambda done: None)
    shutil.rmtree(home.with_name(f"{home.name} before"))
    committed: list[int] = []
    try:
        with denial():
            writer.write(home, number, committed.append)
    except WriteError as error:
        return f"WriteError: {error}{COMMITTED}{committed[-1] if committed else ''}"
    return ""


def _write_and_read(writer: Writer, home: pathlib.Path, number: int) -> str:
    writer.write(home, number, lambda done: None)
    return str(writer.read(home))


def denials_of(writer: Writer, place: pathlib.Path, seed: int, count: int) -> Iterator[tuple[str, Denial]]:
    """``count`` limits on the size of files, a folder that may not be written, and, of the registry, MLflow away."""
    random = Random(f"{seed} {writer.name}")
    for _ in range(count):
        limit = int(10 ** random.uniform(0.0, 5.0))
        yield f"room for {limit} bytes a file", partial(no_room, limit)
    yield "no permission", partial(no_permission, place)
    if writer.name == ALIAS:
        yield "nobody answers", nobody_answers
        yield "a locked database", partial(locked_database, place)


def write_at_once(home: pathlib.Path, processes: int, calls: int) -> str:
    """Processes that all write to MLflow's database; what was wrong, or nothing."""
    from assets.interfaces import TrainedMember
    from pipelines.tracking import MlflowTracker

    def work(number: int) -> None:
        for call in range(calls):
            name = f"member_{number}_{call}"
            member = TrainedMember(name, {"seed": call}, [0.5, 0.4], 2, [1.0], {"set": "b" * 64}, home / "none")
            MlflowTracker(home).member("a" * 64, member)

    for pid in [start_alone(partial(work, number)) for number in range(processes)]:
        os.waitpid(pid, 0)
    return run_alone(partial(_count_of_runs, home, processes * calls))


def _count_of_runs(home: pathlib.Path, expected: int) -> str:
    from pipelines.tracking import MlflowTracker

    tracker = MlflowTracker(home)
    tracker.replay()
    with tracker.records() as records:
        runs = records.client.search_runs([records.experiment], max_results=10 * expected)
    members = [run.info.run_name for run in runs if "mlflow.parentRunId" in run.data.tags]
    if len(members) == len({*members}) == expected and not tracker.pending.files():
        return ""
    return f"{expected} members were recorded at once, {len({*members})} of {len(members)} runs are found"


def main(arguments: list[str] | None = None) -> int:
    """``python -m evidence.faults.denials``."""
    made = parser(__doc__)
    made.add_argument("--count", type=int, default=6, help="limits on the size of files, for each writer (default 6)")
    options = made.parse_args(arguments)
    progress, failures, tried = progress_every(1), list[str](), 0
    with prepared_writers() as (home, all_of_them):
        for writer in all_of_them:
            place = home / writer.name
            for what, denial in denials_of(writer, place, options.seed, options.count):
                began_s = time.monotonic()
                wrong = deny(writer, place, what, denial)
                shutil.rmtree(place)
                failures += [wrong] if wrong else []
                tried += 1
                progress(tried, tried, f"{writer.name}, {what}: {time.monotonic() - began_s:.1f} s {wrong}")
        wrong = write_at_once(home / "at once", 4, 5)
        failures += [wrong] if wrong else []
    figures = {"denials": tried, "denials_failed": len(failures), "writers_at_once": 4}
    return conclude("denials", figures, options, failures)


if __name__ == "__main__":
    sys.exit(main())
