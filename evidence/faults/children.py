"""Forked child processes that run one function, and the SIGKILL of a writer at a random instant.

Writers run in children forked from a process that computes nothing itself, so that an attempt costs no imports.
Half of the children are killed from outside after a random time. The other half kill themselves at a random file
operation, because the short moments between two file operations are the critical ones.
"""

import contextlib
import dataclasses
import importlib
import os
import pathlib
import select
import signal
import sys
import time
from collections.abc import Callable
from random import Random

from deltasafe.io.temporary_files import find_temporary_files

FILE_OPERATIONS = frozenset(
    ("open", "os.rename", "os.mkdir", "os.remove", "os.rmdir", "os.chmod", "os.scandir", "shutil.rmtree", "os.link")
)
TIMEOUT_S = 300.0

Send = Callable[[str], object]
Commit = Callable[[int], None]


def ignore(number: int) -> None:
    """No-op commit callback."""


@dataclasses.dataclass(frozen=True)
class Writer:
    """Writes numbered versions of one artifact, starting at 1.

    Attributes:
        name: of the artifact.
        write: writes version ``number`` below a folder; calls back with each number that is committed.
        read: reads and verifies everything, and returns the number of the stored version (0 for none). Raises an
            exception if the content is torn.
        per_run: number of versions that one call of ``write`` goes through.
    """

    name: str
    write: Callable[[pathlib.Path, int, Commit], None]
    read: Callable[[pathlib.Path], int]
    per_run: int = 1


@dataclasses.dataclass(frozen=True)
class KillOutcome:
    """Result of one kill.

    Attributes:
        interrupted: whether the writer was still running when it was killed.
        failure: what is wrong, or an empty string.
        number: the version that is stored now.
    """

    interrupted: bool
    failure: str
    number: int


class Child:
    """A forked process that runs ``work(send)`` with stdout and stderr discarded, and exits with 0 on success."""

    def __init__(self, work: Callable[[Send], object]) -> None:
        self._pipe, write_end = os.pipe()
        self.output = ""
        self._pid = os.fork()
        if self._pid == 0:
            status = 1
            try:
                os.close(self._pipe)
                for stream in (1, 2):
                    os.dup2(os.open(os.devnull, os.O_WRONLY), stream)
                work(lambda text: os.write(write_end, text.encode()))
                status = 0
            finally:
                os._exit(status)
        os.close(write_end)

    def wait(self, seconds: float = TIMEOUT_S) -> bool:
        """Collect output until the child exits; False if it still runs after ``seconds``."""
        deadline = time.monotonic() + seconds
        while (left := deadline - time.monotonic()) > 0:
            if select.select([self._pipe], [], [], left)[0]:
                data = os.read(self._pipe, 65536)
                if not data:
                    return True
                self.output += data.decode(errors="replace")
        return False

    def close(self) -> int:
        """Kill the child if it still runs, and return its exit status (negative for a signal)."""
        if not self.wait(0.01):
            os.kill(self._pid, signal.SIGKILL)
            self.wait(10.0)
        os.close(self._pipe)
        return os.waitstatus_to_exitcode(os.waitpid(self._pid, 0)[1])


def run_in_child(work: Callable[[], str | None]) -> str:
    """Return the result of ``work``, run in a child; ``0 `` and the error if it fails or exceeds the timeout."""

    def answer(send: Send) -> None:
        try:
            result = work()
        except BaseException as error:
            result = f"0 {type(error).__name__}: {error}"
        send(result or "")

    child = Child(answer)
    finished = child.wait()
    child.close()
    return child.output if finished else f"0 no answer after {TIMEOUT_S:g} s"


def preload_imports(work: Callable[[], object]) -> str:
    """Import in this process what ``work`` imports in a child, so that later children are killed while they write.

    Returns the error of ``work``, or an empty string.
    """

    def module_names() -> str:
        work()
        return "\n".join(sys.modules)

    answer = run_in_child(module_names)
    if answer.startswith("0 "):
        return answer
    for name in answer.split():
        with contextlib.suppress(Exception):  # some modules are created at run time and have no file
            importlib.import_module(name)
    return ""


def kill_once(writer: Writer, home: pathlib.Path, number: int, typical_s: float, random: Random) -> KillOutcome:
    """Write versions from ``number`` until the kill; then read, write the next version, and read again."""
    operation = random.randrange(1, 60) if random.random() < 0.5 else None
    wait_s = random.uniform(0.0, 2.0 * typical_s)

    def write_versions(send: Send) -> None:
        def commit(done: int) -> None:
            send(f"{done} ")

        if operation is not None:
            _kill_self_at(operation)
        for first in range(number, number + 50 * writer.per_run, writer.per_run):
            writer.write(home, first, commit)

    child = Child(write_versions)
    child.wait(TIMEOUT_S if operation is not None else wait_s)
    interrupted = child.close() == -signal.SIGKILL
    committed = int((child.output.split() or [str(number - 1)])[-1])
    stored, _, failure = run_in_child(lambda: _recover(writer, home, committed)).partition(" ")
    return KillOutcome(interrupted, failure, int(stored))


def _recover(writer: Writer, home: pathlib.Path, committed: int) -> str:
    stored = writer.read(home)
    if not committed <= stored <= committed + 1:
        return f"{stored} version {committed} was committed, but version {stored} is stored"
    following = stored - stored % writer.per_run + 1 if writer.per_run > 1 else stored + 1
    writer.write(home, following, ignore)
    now = writer.read(home)
    if now < following:
        return f"{now} the next run wrote version {following}, but version {now} is stored"
    if temporary := find_temporary_files(home):
        return f"{now} left behind: {temporary[0].relative_to(home)}"
    return f"{now} "


def _kill_self_at(operation: int) -> None:
    """SIGKILL this process at its ``operation``-th file operation that is not a read-only open."""
    left = operation

    def hook(event: str, arguments: tuple[object, ...]) -> None:
        nonlocal left
        read_only = event == "open" and not int(str(arguments[2])) & (os.O_WRONLY | os.O_RDWR)
        if event in FILE_OPERATIONS and not read_only:
            left -= 1
            if left == 0:
                os.kill(os.getpid(), signal.SIGKILL)

    sys.addaudithook(hook)
