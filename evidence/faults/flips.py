"""Changes of single bytes in a frozen ensemble: all must be noticed before anything is made of its content.

A byte at a random place of a random file is changed, removed or added, or two files are exchanged, and the ensemble is
loaded. Whatever would read weights, arrays or a program is replaced by something that says so when it is entered.
"""

import contextlib
import pathlib
import sys
import tempfile
from collections.abc import Iterator
from random import Random
from unittest import mock

from deltasafe.errors import ArtifactError
from deltasafe.perception.artifact import load_ensemble
from deltasafe.progress import Progress, silent
from evidence.faults.ensemble import tiny_ensemble
from evidence.faults.reporting import conclude, parser, progress_every

__all__ = ["exchange_files", "flip_bytes", "main", "nothing_is_made", "resize_files"]

READERS = (
    "safetensors.safe_open",
    "safetensors.torch.load_file",
    "torch.load",
    "torch.from_numpy",
    "numpy.load",
    "onnxruntime.InferenceSession",
    "deltasafe.perception.member.build_network",
)


class EnteredError(BaseException):
    """Something was made of a file that nobody had verified."""


@contextlib.contextmanager
def nothing_is_made() -> Iterator[None]:
    """Whoever reads weights, arrays or programs meanwhile raises `EnteredError`."""
    with contextlib.ExitStack() as stack:
        for name in READERS:
            stack.enter_context(mock.patch(name, side_effect=EnteredError(name)))
        yield


def flip_bytes(frozen: pathlib.Path, count: int, seed: int, progress: Progress = silent) -> list[str]:
    """Change one byte ``count`` times, each time of the sound ensemble; returns what was not noticed."""
    random, missed = Random(seed), []
    files = sorted(frozen.iterdir())
    for done in range(1, count + 1):
        path = random.choice(files)
        place, change = random.randrange(path.stat().st_size), random.randrange(1, 256)
        with path.open("r+b", buffering=0) as file:
            file.seek(place)
            sound = file.read(1)
            file.seek(place)
            file.write(bytes([sound[0] ^ change]))
            if not _noticed(frozen):
                missed.append(f"{path.name}: byte {place} changed by {change}")
            file.seek(place)
            file.write(sound)
        progress(done, count, "bytes changed")
    return missed


def resize_files(frozen: pathlib.Path, count: int, seed: int, progress: Progress = silent) -> list[str]:
    """Remove a byte, or add one, ``count`` times."""
    random, missed = Random(seed), []
    files = sorted(frozen.iterdir())
    for done in range(1, count + 1):
        path = random.choice(files)
        sound = path.read_bytes()
        place = random.randrange(len(sound))
        added = random.randbytes(1) if random.random() < 0.5 else b""
        path.write_bytes(sound[:place] + added + sound[place + (not added) :])
        if not _noticed(frozen):
            missed.append(f"{path.name}: {'added at' if added else 'removed'} byte {place}")
        path.write_bytes(sound)
        progress(done, count, "bytes removed or added")
    return missed


def exchange_files(frozen: pathlib.Path) -> tuple[int, list[str]]:
    """Exchange every two files; how many pairs, and those that were not noticed."""
    files, missed, count = sorted(frozen.iterdir()), [], 0
    kept = frozen.with_name(f"kept-{frozen.name}")
    for n, first in enumerate(files):
        for second in files[:n]:
            count += 1
            for _ in _exchanged(first, second, kept):
                if not _noticed(frozen):
                    missed.append(f"{first.name} and {second.name} exchanged")
    return count, missed


def _exchanged(first: pathlib.Path, second: pathlib.Path, kept: pathlib.Path) -> Iterator[None]:
    def exchange() -> None:
        first.rename(kept)
        second.rename(first)
        kept.rename(second)

    exchange()
    yield
    exchange()


def _noticed(frozen: pathlib.Path) -> bool:
    try:
        load_ensemble(frozen)
    except ArtifactError:
        return True
    except (EnteredError, Exception):  # entered, or another error than the one that callers are promised
        return False
    return False


def main(arguments: list[str] | None = None) -> int:
    """``python -m evidence.faults.flips``."""
    made = parser(__doc__)
    made.add_argument("--count", type=int, default=10_000, help="bytes to change (default 10000)")
    made.add_argument("--resized", type=int, default=500, help="bytes to remove or add (default 500)")
    options = made.parse_args(arguments)
    with tempfile.TemporaryDirectory(prefix="deltasafe-faults-") as home:
        frozen = tiny_ensemble(pathlib.Path(home), options.seed)
        load_ensemble(frozen)
        with nothing_is_made():
            missed = flip_bytes(frozen, options.count, options.seed, progress_every(1000))
            resized = resize_files(frozen, options.resized, options.seed, progress_every(100))
            exchanges, exchanged = exchange_files(frozen)
        load_ensemble(frozen)  # all of it was put back
    failures = [*missed, *resized, *exchanged]
    figures = {
        "flips": options.count,
        "flips_missed": len(missed),
        "resized": options.resized,
        "resized_missed": len(resized),
        "exchanges": exchanges,
        "exchanges_missed": len(exchanged),
    }
    return conclude("flips", figures, options, failures)


if __name__ == "__main__":
    sys.exit(main())
