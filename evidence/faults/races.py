"""Two processes write the same artifact at once: the stored version is complete and comes from one of them."""

import pathlib
import sys
import time
from functools import partial
from random import Random

from deltasafe.io.temporary_files import find_temporary_files
from evidence.faults.children import Child, Writer, ignore, run_in_child
from evidence.faults.writers import prepared_writers
from evidence.reporting import command_parser, finish, print_progress


def race(writer: Writer, home: pathlib.Path, number: int, delay_s: float) -> str:
    """Run two processes, the second one ``delay_s`` later; return what is wrong, or an empty string.

    They write consecutive versions. An artifact that grows in steps (a member) is written as the same version by
    both, as two runs of one partition do.
    """
    numbers = (number, number if writer.per_run > 1 else number + 1)
    start_s = time.monotonic() + 0.05
    starts = zip((start_s, start_s + delay_s), numbers, strict=True)
    children = [Child(partial(_write_at, writer, home, version, at_s)) for at_s, version in starts]
    for child in children:
        child.wait()
    if any(statuses := [child.close() for child in children]):
        return f"the two processes exited with {statuses}"
    stored = run_in_child(lambda: str(writer.read(home)))
    if stored not in {str(version + writer.per_run - 1) for version in numbers}:
        return f"versions {numbers} were written, but version {stored} is stored"
    if failure := run_in_child(partial(writer.write, home, max(numbers) + writer.per_run, ignore)):
        return f"the next version cannot be written: {failure}"
    temporary = find_temporary_files(home)
    return f"left behind: {temporary[0].name}" if temporary else ""


def race_writer(writer: Writer, home: pathlib.Path, pairs: int, seed: int) -> list[str]:
    """Run ``pairs`` races in sequence in the same folder; return what is wrong."""
    random, number, failures = Random(f"{seed} {writer.name}"), 1, []
    home.mkdir(parents=True)
    for pair in range(1, pairs + 1):
        delay_s = random.choice((0.0, random.uniform(0.0, 0.05), random.uniform(0.0, 0.5)))
        if failure := race(writer, home, number, delay_s):
            failures.append(f"{writer.name}, pair {pair}: {failure}")
        number += (2 if writer.per_run > 1 else 3) * writer.per_run
    return failures


def _write_at(writer: Writer, home: pathlib.Path, number: int, start_s: float, send: object) -> None:
    time.sleep(max(0.0, start_s - time.monotonic()))
    writer.write(home, number, ignore)


def main(arguments: list[str] | None = None) -> int:
    """Run ``python -m evidence.faults.races``."""
    parser = command_parser("faults.races", __doc__, seeded=True)
    parser.add_argument("--count", type=int, default=102, help="pairs of processes, in total (default 102)")
    options = parser.parse_args(arguments)
    failures, raced, progress = list[str](), 0, print_progress(1)
    with prepared_writers() as (home, writers):
        pairs = -(-options.count // len(writers))
        for writer in writers:
            failures += race_writer(writer, home / writer.name, pairs, options.seed)
            raced += pairs
            progress(raced, pairs * len(writers), f"{writer.name}, {len(failures)} failures")
    return finish(options, {"races": raced, "races_mixed": len(failures)}, failures)


if __name__ == "__main__":
    sys.exit(main())
