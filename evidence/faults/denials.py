"""Deny writers disk space, permission, the tracking server or its database.

A writer must either raise a `WriteError` with a remedy or queue the call, and must keep the previous version.
"""

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
from deltasafe.io.temporary_files import find_temporary_files
from evidence.faults.children import Child, Writer, ignore, run_in_child
from evidence.faults.rejection import unprivileged
from evidence.faults.writers import REGISTRY_ALIAS, prepared_writers
from evidence.reporting import command_parser, finish, print_progress
from pipelines.home import TRACKING_VARIABLE

Denial = Callable[[], AbstractContextManager[object]]
COMMITTED = " | committed before: "
"""Separates the error from the version that a writer of two artifacts (execution, then log) had committed by then."""
UNREACHABLE_SERVER = "http://127.0.0.1:9"
PROCESSES = 4


@contextmanager
def no_space(limit_bytes: int) -> Iterator[None]:
    """Limit the size of every file. Like a full disk, except for the error number (EFBIG)."""
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
    """Make everything below ``home`` read-only, also for root."""
    folders = [home, *(path for path in home.rglob("*") if path.is_dir() and not path.is_symlink())]
    for folder in folders:
        folder.chmod(0o555)
    try:
        with unprivileged():
            yield
    finally:
        for folder in folders:
            folder.chmod(0o755)


@contextmanager
def unreachable_server() -> Iterator[None]:
    """Name a tracking server that does not answer."""
    os.environ[TRACKING_VARIABLE] = UNREACHABLE_SERVER
    try:
        yield
    finally:
        del os.environ[TRACKING_VARIABLE]


@contextmanager
def locked_database(home: pathlib.Path) -> Iterator[None]:
    """Hold an exclusive lock on MLflow's database."""
    with sqlite3.connect(home / "mlflow" / "mlflow.db") as other:
        other.execute("BEGIN EXCLUSIVE")
        yield
        other.rollback()


def deny(writer: Writer, home: pathlib.Path, name: str, denial: Denial) -> str:
    """Write one version, deny the next, then write it without denial; return what is wrong, or an empty string."""
    home.mkdir(parents=True)
    following = 1 + writer.per_run
    if failure := run_in_child(partial(writer.write, home, 1, ignore)):
        return f"{writer.name} cannot be written without a denial: {failure}"
    before = run_in_child(lambda: str(writer.read(home)))
    error, _, committed = run_in_child(partial(_write_denied, writer, home, following, denial)).partition(COMMITTED)
    during = run_in_child(lambda: str(writer.read(home)))
    temporary = [path.name for path in find_temporary_files(home)]
    after = run_in_child(partial(_write_and_read, writer, home, following))
    expected = str(following + writer.per_run - 1)
    checks = {
        f"not a WriteError with a remedy: {error}": error and not (error.startswith("WriteError: ") and "; " in error),
        f"no error, but version {during} is stored": not error and during != expected,
        f"version {before} was stored, now {during}": error and during not in (before, committed),
        f"left behind: {temporary}": temporary,
        f"after the denial: {after}": after != expected,
    }
    return "".join(f"{writer.name}, {name}: {text}. " for text, failed in checks.items() if failed)


def _write_denied(writer: Writer, home: pathlib.Path, number: int, denial: Denial) -> str:
    # imports and caches must be loaded with privileges: the interpreter may be unreadable without them
    practice = home.with_name(f"{home.name} practice")
    writer.write(practice, 1, ignore)
    shutil.rmtree(practice)
    committed: list[int] = []
    try:
        with denial():
            writer.write(home, number, committed.append)
    except WriteError as error:
        return f"WriteError: {error}{COMMITTED}{committed[-1] if committed else ''}"
    return ""


def _write_and_read(writer: Writer, home: pathlib.Path, number: int) -> str:
    writer.write(home, number, ignore)
    return str(writer.read(home))


def denials_of(writer: Writer, home: pathlib.Path, seed: int, count: int) -> Iterator[tuple[str, Denial]]:
    """Yield ``count`` random file size limits, a read-only folder, and for the registry two failures of MLflow."""
    random = Random(f"{seed} {writer.name}")
    for _ in range(count):
        limit_bytes = int(10 ** random.uniform(0.0, 5.0))
        yield f"at most {limit_bytes} bytes per file", partial(no_space, limit_bytes)
    yield "no permission", partial(no_permission, home)
    if writer.name == REGISTRY_ALIAS:
        yield "unreachable server", unreachable_server
        yield "locked database", partial(locked_database, home)


def record_concurrently(home: pathlib.Path, processes: int, calls: int) -> str:
    """Record members from several processes in one MLflow database; return what is wrong, or an empty string."""
    from assets.interfaces import TrainedMember
    from pipelines.tracking.tracker import MlflowTracker

    def record(process: int, send: object) -> None:
        for call in range(calls):
            name = f"member_{process}_{call}"
            member = TrainedMember(name, {"seed": call}, [0.5, 0.4], 2, [1.0], {"set": "b" * 64}, home / "none")
            MlflowTracker(home).member("a" * 64, member)

    for child in [Child(partial(record, process)) for process in range(processes)]:
        child.wait()
        child.close()
    return run_in_child(partial(_missing_runs, home, processes * calls))


def _missing_runs(home: pathlib.Path, expected: int) -> str:
    from pipelines.tracking.tracker import MlflowTracker

    tracker = MlflowTracker(home)
    tracker.replay()
    with tracker.records() as records:
        runs = records.client.search_runs([records.experiment], max_results=10 * expected)
    members = [run.info.run_name for run in runs if "mlflow.parentRunId" in run.data.tags]
    if len(members) == len({*members}) == expected and not tracker.pending.files():
        return ""
    return f"{expected} members were recorded concurrently, but {len({*members})} distinct of {len(members)} are stored"


def main(arguments: list[str] | None = None) -> int:
    """Run ``python -m evidence.faults.denials``."""
    parser = command_parser("faults.denials", __doc__, seeded=True)
    parser.add_argument("--count", type=int, default=6, help="file size limits per writer (default 6)")
    options = parser.parse_args(arguments)
    progress, failures, tried = print_progress(1), list[str](), 0
    with prepared_writers() as (home, writers):
        for writer in writers:
            for name, denial in denials_of(writer, home / writer.name, options.seed, options.count):
                began_s = time.monotonic()
                failures.append(deny(writer, home / writer.name, name, denial))
                shutil.rmtree(home / writer.name)
                tried += 1
                took_s = time.monotonic() - began_s
                progress(tried, tried, f"{writer.name}, {name}: {took_s:.1f} s {failures[-1]}")
        failures.append(record_concurrently(home / "concurrent", PROCESSES, 5))
    failures = [failure for failure in failures if failure]
    figures = {"denials": tried, "denials_failed": len(failures), "writers_at_once": PROCESSES}
    return finish(options, figures, failures)


if __name__ == "__main__":
    sys.exit(main())
