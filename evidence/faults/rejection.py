"""Check that the library, and the command that a user would run, reject a malformed input as promised."""

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

REMEDY = re.compile(
    r"\b(must|needs|restore|remove|rename|convert|save|give|pull|freeze|train|export|execute|plan|make|write|copy"
    r"|label|store|are allowed|put|add|use|free|install|choose|calibrate|rectify|simplify)\b"
)
"""A message with a remedy contains an imperative, or says what the value must be."""

UNPRIVILEGED_UID = 65534
TIMEOUT_S = 120
"""Longer than any rejection takes; a read that still blocks would block forever, for example on a pipe."""

Change = Callable[[pathlib.Path, Random], object]
"""Changes one file in place."""
Corruption = Callable[[pathlib.Path, Random], str | None]
"""Changes an input in place, and returns the name that the error message must contain."""


class BlockedError(BaseException):
    """A read blocks. Not an `Exception`, so that no handler takes it for an input error."""


@dataclasses.dataclass(frozen=True)
class InputKind:
    """A kind of input.

    Attributes:
        name: of the kind.
        valid: a valid input; every case corrupts a copy of it.
        read: reads the input, given a folder for output. A returned string is the reason of a refusal; any other
            return value means that the input was accepted.
        command: arguments of ``deltasafe`` that read the input, if there is such a command.
    """

    name: str
    valid: pathlib.Path
    read: Callable[[pathlib.Path, pathlib.Path], object]
    command: Callable[[pathlib.Path, pathlib.Path], list[str]] | None = None


@dataclasses.dataclass(frozen=True)
class Case:
    """One corruption of one kind of input."""

    name: str
    kind: InputKind
    corrupt: Corruption

    def privileges(self) -> contextlib.AbstractContextManager[None]:
        """Drop the privileges of root where the input is unreadable."""
        return unprivileged() if "unreadable" in self.name else contextlib.nullcontext()

    def __str__(self) -> str:
        return f"{self.kind.name}: {self.name}"


@dataclasses.dataclass(frozen=True)
class Failure:
    """A rejection that is not as promised.

    Attributes:
        kind: ``untyped`` (accepted, wrong exception or traceback), ``unnamed`` (no file or no remedy) or ``left``
            (output was left behind).
        text: the case and what happened.
    """

    kind: str
    text: str


def check_rejection(case: Case, seed: int, home: pathlib.Path) -> list[Failure]:
    """Corrupt a copy of the input, read it, and return what is wrong with the rejection."""
    found: list[Failure] = []
    with _copy_of_input(case, home) as (given, out), _time_limit(TIMEOUT_S):
        culprit = case.corrupt(given, Random(f"{seed} {case}"))
        try:
            with case.privileges():
                reason = case.kind.read(given, out)
        except DeltasafeError as error:
            reason = str(error)
        except (BlockedError, Exception) as error:
            return [Failure("untyped", f"{case}: {type(error).__name__}: {error}")]
        if not isinstance(reason, str) or not reason:
            return [Failure("untyped", f"{case}: was accepted")]
        if culprit is not None and culprit not in reason:
            found.append(Failure("unnamed", f"{case}: does not name {culprit}: {reason}"))
        if not REMEDY.search(reason):
            found.append(Failure("unnamed", f"{case}: has no remedy: {reason}"))
        found += _leftovers(f"{case}", out)
        if case.kind.command is not None:
            found += _check_command(case, case.kind.command(given, out), culprit)
            found += _leftovers(f"{case}: the command", out)
    return found


def rewrite(path: pathlib.Path, data: bytes) -> None:
    """Replace the content of a file. Unlinks it first, because files of a copy are hard links to the valid ones."""
    path.unlink(missing_ok=True)
    path.write_bytes(data)


@contextlib.contextmanager
def unprivileged() -> Iterator[None]:
    """Drop the privileges of root, who can read and write everything."""
    is_root = os.geteuid() == 0
    if is_root:
        os.seteuid(UNPRIVILEGED_UID)
    try:
        yield
    finally:
        if is_root:
            os.seteuid(0)


@contextlib.contextmanager
def _time_limit(seconds: int) -> Iterator[None]:
    def give_up(number: int, frame: object) -> None:
        raise BlockedError(f"blocked for more than {seconds} s")

    before = signal.signal(signal.SIGALRM, give_up)
    signal.alarm(seconds)
    try:
        yield
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, before)


@contextlib.contextmanager
def _copy_of_input(case: Case, home: pathlib.Path) -> Iterator[tuple[pathlib.Path, pathlib.Path]]:
    folder = pathlib.Path(tempfile.mkdtemp(prefix="case-", dir=home))
    try:
        given, out = folder / case.kind.valid.name, folder / "out"
        out.mkdir()
        if case.kind.valid.is_dir():
            shutil.copytree(case.kind.valid, given, copy_function=os.link)
        else:
            shutil.copyfile(case.kind.valid, given)
        folder.chmod(0o755)
        yield given, out
    finally:
        shutil.rmtree(folder)


def _leftovers(subject: str, out: pathlib.Path) -> list[Failure]:
    left = sorted(out.rglob("*"))
    return [Failure("left", f"{subject} left {left[0].name}")] if left else []


def _check_command(case: Case, command: list[str], culprit: str | None) -> list[Failure]:
    with tempfile.TemporaryFile() as captured:
        saved = os.dup(2), os.dup(1)
        try:  # redirects the descriptors, because native libraries write to them as well
            os.dup2(captured.fileno(), 2)
            with open(os.devnull, "wb") as discard, contextlib.redirect_stderr(os.fdopen(os.dup(2), "w")) as stream:  # noqa: PTH123
                os.dup2(discard.fileno(), 1)
                with case.privileges():
                    status = cli.main(command)
                stream.close()
        except BaseException as error:
            return [Failure("untyped", f"{case}: the command raised {type(error).__name__}: {error}")]
        finally:
            for number, copy in zip((2, 1), saved, strict=True):
                os.dup2(copy, number)
                os.close(copy)
        captured.seek(0)
        lines = captured.read().decode(errors="replace").splitlines()
    is_list = all(line.startswith("- ") for line in lines[1:])  # of all defects
    if status == 0 or not lines or not lines[0].startswith("deltasafe: ") or not is_list:
        return [Failure("untyped", f"{case}: the command exited with {status} and printed {lines}")]
    if culprit is not None and not any(culprit in line for line in lines):
        return [Failure("unnamed", f"{case}: the command does not name {culprit}: {lines}")]
    return []
