"""Kill a writer at a random instant, look at what stands there, and let the next run go on.

Writers work in forked children of a process that computes nothing itself, so that a try costs no imports. Half of the
children are killed from outside after a random time, half kill themselves at a random operation on files, since the
moments between two of those are short, and are the ones that matter. What they import is imported before they begin.
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
from collections.abc import Callable, Iterator
from random import Random

from deltasafe.siblings import left_behind

__all__ = ["Killed", "Writer", "import_beforehand", "kill_once", "run_alone", "start_alone"]

OPERATIONS = frozenset(
    ("open", "os.rename", "os.mkdir", "os.remove", "os.rmdir", "os.chmod", "os.scandir", "shutil.rmtree", "os.link")
)
LONGEST_S, LONGEST_ANSWER = 300.0, 1_000_000


@dataclasses.dataclass(frozen=True)
class Writer:
    """Something that writes one version after another, numbered from 1.

    Attributes:
        name: what it writes.
        write: writes version ``number`` below a folder; calls back with every number from which on nothing may be lost.
        read: reads and verifies all of it; the number of the version that stands there, 0 for none. Raises if torn.
        per_run: numbers that one call of ``write`` goes through.
    """

    name: str
    write: Callable[[pathlib.Path, int, Callable[[int], None]], None]
    read: Callable[[pathlib.Path], int]
    per_run: int = 1


@dataclasses.dataclass(frozen=True)
class Killed:
    """One kill: whether the writer was still at work then, what is wrong, and the version that stands there now."""

    at_work: bool
    wrong: str
    number: int


def kill_once(writer: Writer, home: pathlib.Path, number: int, typical_s: float, random: Random) -> Killed:
    """Let versions from ``number`` on be written until the kill; then read, write the next one, and read again."""
    operation = random.randrange(1, 60) if random.random() < 0.5 else None
    committed, at_work = _killed(writer, home, number, operation, random.uniform(0.0, 2.0 * typical_s))
    said = run_alone(lambda: _look(writer, home, committed if committed else number - 1))
    found, _, wrong = said.partition(" ")
    return Killed(at_work, wrong, int(found))


def import_beforehand(work: Callable[[], object]) -> str:
    """Import here what a forked child imports at ``work``, so that those to come are killed at work, not before it.

    All else that the child does stays with it. Returns what went wrong, or nothing.
    """

    def imported() -> str:
        work()
        return "\n".join(sys.modules)

    said = run_alone(imported)
    if said.startswith("0 "):
        return said
    for name in said.split():
        with contextlib.suppress(Exception):  # some are made by others, and have no file
            importlib.import_module(name)
    return ""


def run_alone(work: Callable[[], str | None]) -> str:
    """What ``work`` returns, done by a forked child; ``0 `` and the error if it ends in another way."""
    reads, writes = os.pipe()
    pid = os.fork()
    if pid == 0:
        with _as_child():
            os.close(reads)
            try:
                said: str | None = work()
            except BaseException as error:
                said = f"0 {type(error).__name__}: {error}"
            os.write(writes, (said or "").encode()[:LONGEST_ANSWER])
    os.close(writes)
    ended, answer = _read_until(reads, LONGEST_S)
    os.close(reads)
    os.kill(pid, signal.SIGKILL)
    os.waitpid(pid, 0)
    return answer.decode() if ended else f"0 nothing was heard of it for {LONGEST_S:g} s"


def start_alone(work: Callable[[], None]) -> int:
    """A forked child at ``work``; its number. It ends with 0 if the work came to its end."""
    pid = os.fork()
    if pid == 0:
        with _as_child():
            work()
    return pid


def _killed(writer: Writer, home: pathlib.Path, number: int, operation: int | None, wait_s: float) -> tuple[int, bool]:
    """The last number that the child committed, and whether it was killed before it had come to an end."""
    reads, writes = os.pipe()
    pid = os.fork()
    if pid == 0:
        with _as_child():
            os.close(reads)
            if operation is not None:
                _die_at(operation)

            def say(done: int) -> None:
                os.write(writes, f"{done} ".encode())

            for first in range(number, number + 50 * writer.per_run, writer.per_run):
                writer.write(home, first, say)
    os.close(writes)
    ended, said = _read_until(reads, LONGEST_S if operation is not None else wait_s)
    if not ended:
        os.kill(pid, signal.SIGKILL)
        said += _read_until(reads, 10.0)[1]
    os.close(reads)
    status = os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1])
    return int((said.split() or [b"0"])[-1]), status == -signal.SIGKILL


def _look(writer: Writer, home: pathlib.Path, committed: int) -> str:
    found = writer.read(home)
    if not committed <= found <= committed + 1:
        return f"{found} {committed} was committed, {found} stands there"
    following = found - found % writer.per_run + 1 if writer.per_run > 1 else found + 1
    writer.write(home, following, lambda done: None)
    now = writer.read(home)
    if now < following:
        return f"{now} the next run wrote {following}, {now} stands there"
    if left := left_behind(home):
        return f"{now} left behind: {left[0].relative_to(home)}"
    return f"{now} "


def _die_at(operation: int) -> None:
    left = operation

    def hook(event: str, arguments: tuple[object, ...]) -> None:
        nonlocal left
        if event in OPERATIONS and not (event == "open" and _only_read(arguments)):
            left -= 1
            if left == 0:
                os.kill(os.getpid(), signal.SIGKILL)

    sys.addaudithook(hook)


def _only_read(arguments: tuple[object, ...]) -> bool:
    return not int(str(arguments[2])) & (os.O_WRONLY | os.O_RDWR)


@contextlib.contextmanager
def _as_child() -> Iterator[None]:
    """A forked child never comes back from here, and says nothing; it ends with 0 if nothing was raised."""
    status = 1
    try:
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, 1)
        os.dup2(nowhere, 2)
        yield
        status = 0
    finally:
        os._exit(status)


def _read_until(pipe: int, seconds: float) -> tuple[bool, bytes]:
    """Whether the other end was closed within the time, and what came through."""
    until, said = time.monotonic() + seconds, b""
    while (left := until - time.monotonic()) > 0:
        if select.select([pipe], [], [], left)[0]:
            piece = os.read(pipe, 65536)
            if not piece:
                return True, said
            said += piece
    return False, said
