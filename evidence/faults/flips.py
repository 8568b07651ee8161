"""Change, remove or add single bytes in a frozen ensemble, and exchange its files: loading must detect every change.

Detection must come before any content is used. Functions that parse weights, arrays or programs are therefore patched
to raise `EnteredError` when they are called.
"""

import contextlib
import itertools
import pathlib
import sys
from collections.abc import Callable, Iterator
from random import Random
from unittest import mock

from deltasafe.compute.progress import Progress, silent
from deltasafe.errors import ArtifactError
from deltasafe.perception.artifact.frozen_ensemble import load_ensemble
from evidence.fixtures import temporary_home, tiny_ensemble
from evidence.reporting import command_parser, finish, print_progress

PARSERS = (
    "safetensors.safe_open",
    "safetensors.torch.load_file",
    "torch.load",
    "torch.from_numpy",
    "numpy.load",
    "onnxruntime.InferenceSession",
    "deltasafe.perception.training.member.build_network",
)

ByteChange = Callable[[bytes, int, Random], tuple[str, bytes]]
"""Changes data at an offset; returns the name of the change and the new data."""


class EnteredError(BaseException):
    """A parser was called."""


@contextlib.contextmanager
def parsers_raise() -> Iterator[None]:
    """Make every function that parses weights, arrays or programs raise `EnteredError`."""
    with contextlib.ExitStack() as stack:
        for name in PARSERS:
            stack.enter_context(mock.patch(name, side_effect=EnteredError(name)))
        yield


def change_bytes(
    frozen: pathlib.Path, count: int, seed: int, change: ByteChange, progress: Progress = silent
) -> list[str]:
    """Apply one change at a time to a random file, ``count`` times; return the changes that were not detected."""
    random, missed = Random(seed), []
    files = sorted(frozen.iterdir())
    for done in range(1, count + 1):
        path = random.choice(files)
        original = path.read_bytes()
        offset = random.randrange(len(original))
        name, content = change(original, offset, random)
        path.write_bytes(content)
        if not _is_detected(frozen):
            missed.append(f"{path.name}: byte {offset} {name}")
        path.write_bytes(original)
        progress(done, count, "bytes changed")
    return missed


def flipped(data: bytes, offset: int, random: Random) -> tuple[str, bytes]:
    """Change the value of one byte."""
    value = data[offset] ^ random.randrange(1, 256)
    return f"set to {value}", data[:offset] + bytes([value]) + data[offset + 1 :]


def resized(data: bytes, offset: int, random: Random) -> tuple[str, bytes]:
    """Add or remove one byte."""
    if random.random() < 0.5:
        return "added", data[:offset] + random.randbytes(1) + data[offset:]
    return "removed", data[:offset] + data[offset + 1 :]


def exchange_files(frozen: pathlib.Path) -> tuple[int, list[str]]:
    """Exchange every pair of files; return the number of pairs and those that were not detected."""
    pairs, missed = list(itertools.combinations(sorted(frozen.iterdir()), 2)), []
    for first, second in pairs:
        _exchange(first, second)
        if not _is_detected(frozen):
            missed.append(f"{first.name} and {second.name} exchanged")
        _exchange(first, second)
    return len(pairs), missed


def _exchange(first: pathlib.Path, second: pathlib.Path) -> None:
    temporary = first.parent.with_name(f"exchanged-{first.name}")
    first.rename(temporary)
    second.rename(first)
    temporary.rename(second)


def _is_detected(frozen: pathlib.Path) -> bool:
    try:
        load_ensemble(frozen)
    except ArtifactError:
        return True
    except (EnteredError, Exception):  # a parser was called, or the error is not the documented one
        return False
    return False


def main(arguments: list[str] | None = None) -> int:
    """Run ``python -m evidence.faults.flips``."""
    parser = command_parser("faults.flips", __doc__, seeded=True)
    parser.add_argument("--count", type=int, default=10_000, help="bytes to change (default 10000)")
    parser.add_argument("--resized", type=int, default=500, help="bytes to remove or add (default 500)")
    options = parser.parse_args(arguments)
    with temporary_home() as home:
        frozen = tiny_ensemble(home, options.seed)
        load_ensemble(frozen)
        with parsers_raise():
            missed = change_bytes(frozen, options.count, options.seed, flipped, print_progress(1000))
            missed_sizes = change_bytes(frozen, options.resized, options.seed, resized, print_progress(100))
            exchanges, exchanged = exchange_files(frozen)
        load_ensemble(frozen)  # every change was undone
    figures = {
        "flips": options.count,
        "flips_missed": len(missed),
        "resized": options.resized,
        "resized_missed": len(missed_sizes),
        "exchanges": exchanges,
        "exchanges_missed": len(exchanged),
    }
    return finish(options, figures, [*missed, *missed_sizes, *exchanged])


if __name__ == "__main__":
    sys.exit(main())
