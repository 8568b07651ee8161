"""Is a malformed input refused as it must be? By the library, and by the command that a person would use."""

import contextlib
import dataclasses
import os
import pathlib
import re
import shutil
import signal
import tempfile
from collections.abc import Callable, Iterator
from random import Random

from deltasafe import cli
from deltasafe.errors import DeltasafeError

__all__ = ["Case", "Door", "Failure", "judge", "rewrite"]

REMEDY = re.compile(
    r"\b(must|needs|restore|remove|rename|convert|save|give|pull|freeze|train|export|execute|plan|make|write|copy"
    r"|label|store|are allowed|put|add|use|free|install|choose|calibrate|rectify)\b"
)
"""What a message that says what to do contains: an imperative, or what the value must be."""

UNPRIVILEGED = 65534
WAIT_S = 40
"""Whoever still waits then waits for something that never comes, such as the other end of a pipe."""
Spoil = Callable[[pathlib.Path, Random], str | None]


class StuckError(BaseException):
    """Something waits that nobody will wake; no input error, and not to be taken for one."""


@dataclasses.dataclass(frozen=True)
class Door:
    """Where input comes in.

    Attributes:
        name: what comes in.
        sound: a sound input of that kind; cases get copies of it.
        read: reads the input, given the folder for whatever it writes. Accepting it is the fault; it returns a
            reason where the outcome is a refusal in itself.
        command: arguments of ``deltasafe`` that read the input, where there are such.
    """

    name: str
    sound: pathlib.Path
    read: Callable[[pathlib.Path, pathlib.Path], str | None]
    command: Callable[[pathlib.Path, pathlib.Path], list[str]] | None = None


@dataclasses.dataclass(frozen=True)
class Case:
    """One way of spoiling an input in place; ``spoil`` returns the name of the file that the message must give."""

    name: str
    door: Door
    spoil: Spoil

    @property
    def as_whom(self) -> contextlib.AbstractContextManager[None]:
        """Whoever may read everything has to forgo that, where the point is that it may not be read."""
        return as_reader() if "may not be read" in self.name else contextlib.nullcontext()

    def __str__(self) -> str:
        return f"{self.door.name}: {self.name}"


@dataclasses.dataclass(frozen=True)
class Failure:
    """What was wrong with a refusal.

    Attributes:
        kind: ``untyped`` (accepted, another exception, a traceback), ``unnamed`` (no file or no remedy) or ``left``
            (output was left behind).
        words: the case, and what happened.
    """

    kind: str
    words: str


def judge(case: Case, seed: int, home: pathlib.Path) -> list[Failure]:
    """Spoil a copy, have it read, and look at what comes of it."""
    found: list[Failure] = []
    with _workplace(case, home) as (given, out), _no_longer_than(WAIT_S):
        culprit = case.spoil(given, Random(f"{seed} {case}"))
        try:
            with case.as_whom:
                reason = case.door.read(given, out)
        except DeltasafeError as error:
            reason = str(error)
        except (StuckError, Exception) as error:
            return [Failure("untyped", f"{case}: {type(error).__name__}: {error}")]
        if not reason:
            return [Failure("untyped", f"{case}: was accepted")]
        if culprit is not None and culprit not in reason:
            found.append(Failure("unnamed", f"{case}: does not name {culprit}: {reason}"))
        if not REMEDY.search(reason):
            found.append(Failure("unnamed", f"{case}: says nothing of what to do: {reason}"))
        if left := sorted(out.rglob("*")):
            found.append(Failure("left", f"{case}: left {left[0].name}"))
        if case.door.command is not None:
            found += _judge_command(case, given, out, culprit)
    return found


def rewrite(path: pathlib.Path, data: bytes) -> None:
    """Give a file other content; files of a copy are links to the sound ones."""
    path.unlink(missing_ok=True)
    path.write_bytes(data)


@contextlib.contextmanager
def as_reader() -> Iterator[None]:
    """Without the privilege of reading what may not be read."""
    privileged = os.geteuid() == 0
    if privileged:
        os.seteuid(UNPRIVILEGED)
    try:
        yield
    finally:
        if privileged:
            os.seteuid(0)


@contextlib.contextmanager
def _no_longer_than(seconds: int) -> Iterator[None]:
    def give_up(number: int, frame: object) -> None:
        raise StuckError(f"waited for more than {seconds} s")

    before = signal.signal(signal.SIGALRM, give_up)
    signal.alarm(seconds)
    try:
        yield
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, before)


@contextlib.contextmanager
def _workplace(case: Case, home: pathlib.Path) -> Iterator[tuple[pathlib.Path, pathlib.Path]]:
    place = pathlib.Path(tempfile.mkdtemp(prefix="case-", dir=home))
    try:
        given, out = place / case.door.sound.name, place / "out"
        out.mkdir()
        if case.door.sound.is_dir():
            shutil.copytree(case.door.sound, given, copy_function=os.link)
        else:
            shutil.copyfile(case.door.sound, given)
        place.chmod(0o755)
        yield given, out
    finally:
        shutil.rmtree(place)


def _judge_command(case: Case, given: pathlib.Path, out: pathlib.Path, culprit: str | None) -> list[Failure]:
    assert case.door.command is not None
    with tempfile.TemporaryFile() as said:
        kept = os.dup(2), os.dup(1)
        try:  # the descriptors, since libraries beneath Python write to them as well
            os.dup2(said.fileno(), 2)
            with open(os.devnull, "wb") as nowhere, contextlib.redirect_stderr(os.fdopen(os.dup(2), "w")) as stream:  # noqa: PTH123
                os.dup2(nowhere.fileno(), 1)
                with case.as_whom:
                    status = cli.main(case.door.command(given, out))
                stream.close()
        except BaseException as error:
            return [Failure("untyped", f"{case}: the command raised {type(error).__name__}: {error}")]
        finally:
            for number, copy in zip((2, 1), kept, strict=True):
                os.dup2(copy, number)
                os.close(copy)
        said.seek(0)
        lines = said.read().decode(errors="replace").splitlines()
    found = []
    if status == 0 or len(lines) != 1 or not lines[0].startswith("deltasafe: "):
        found.append(Failure("untyped", f"{case}: the command ended with {status} and said {lines}"))
    elif culprit is not None and culprit not in lines[0]:
        found.append(Failure("unnamed", f"{case}: the command does not name {culprit}: {lines[0]}"))
    if left := sorted(out.rglob("*")):
        found.append(Failure("left", f"{case}: the command left {left[0].name}"))
    return found
