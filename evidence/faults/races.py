"""Two runs write the same thing at once: what stands there afterwards is the one or the other, never of both."""

import os
import pathlib
import signal
import sys
import time
from functools import partial
from random import Random

from deltasafe.siblings import left_behind
from evidence.faults.killing import Writer, run_alone, start_alone
from evidence.faults.reporting import conclude, parser, progress_every
from evidence.faults.writers import prepared_writers

__all__ = ["main", "race", "race_writer"]

LONGEST_S = 300.0


def race(writer: Writer, home: pathlib.Path, number: int, later_s: float) -> str:
    """Two processes, the second one later by a little; what was wrong, or nothing.

    They write versions that follow each other. What grows in steps (a member) is written as the same version by
    both, as two runs of one partition do.
    """
    numbers = (number, number if writer.per_run > 1 else number + 1)
    began, children = time.monotonic() + 0.05, []
    for delay_s, each in zip((0.0, later_s), numbers, strict=True):
        children.append(start_alone(partial(_write_at, writer, home, each, began + delay_s)))
    ended = [_exit_status(pid, began + LONGEST_S) for pid in children]
    if any(ended):
        return f"the two ended with {ended}"
    last = max(numbers) + writer.per_run - 1
    found = run_alone(lambda: str(writer.read(home)))
    if found not in {str(each + writer.per_run - 1) for each in numbers}:
        return f"{numbers} were written, {found} stands there"
    said = run_alone(partial(writer.write, home, last + 1, lambda done: None))
    left = left_behind(home)
    return said or (f"left {left[0].name}" if left else "")


def race_writer(writer: Writer, home: pathlib.Path, pairs: int, seed: int) -> list[str]:
    """``pairs`` races one after another in the same place; what was wrong."""
    random, number, wrong = Random(f"{seed} {writer.name}"), 1, []
    home.mkdir(parents=True)
    for pair in range(1, pairs + 1):
        said = race(writer, home, number, random.choice((0.0, random.uniform(0.0, 0.05), random.uniform(0.0, 0.5))))
        number += (2 if writer.per_run > 1 else 3) * writer.per_run
        wrong += [f"{writer.name}, pair {pair}: {said}"] if said else []
    return wrong


def _write_at(writer: Writer, home: pathlib.Path, number: int, when: float) -> None:
    time.sleep(max(0.0, when - time.monotonic()))
    writer.write(home, number, lambda done: None)


def _exit_status(pid: int, until: float) -> int:
    while time.monotonic() < until:
        done, status = os.waitpid(pid, os.WNOHANG)
        if done:
            return os.waitstatus_to_exitcode(status)
        time.sleep(0.005)
    os.kill(pid, signal.SIGKILL)
    return os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1])


def main(arguments: list[str] | None = None) -> int:
    """``python -m evidence.faults.races``."""
    made = parser(__doc__)
    made.add_argument("--count", type=int, default=102, help="pairs, over all writers (default 102)")
    options = made.parse_args(arguments)
    failures, raced, progress = list[str](), 0, progress_every(1)
    with prepared_writers() as (home, all_of_them):
        pairs = -(-options.count // len(all_of_them))
        for writer in all_of_them:
            failures += race_writer(writer, home / writer.name, pairs, options.seed)
            raced += pairs
            progress(raced, pairs * len(all_of_them), f"{writer.name}, {len(failures)} failures")
    return conclude("races", {"races": raced, "races_mixed": len(failures)}, options, failures)


if __name__ == "__main__":
    sys.exit(main())
