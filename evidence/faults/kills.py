"""SIGKILL writers at random instants: nothing is torn, nothing committed is lost, and the next run succeeds."""

import pathlib
import sys
import time
from functools import partial
from random import Random

from deltasafe.compute.progress import Progress, silent
from evidence.faults.children import KillOutcome, Writer, ignore, kill_once, run_in_child
from evidence.faults.writers import prepared_writers
from evidence.reporting import command_parser, finish, print_progress


def kill_writer(
    writer: Writer, home: pathlib.Path, count: int, seed: int, progress: Progress = silent
) -> list[KillOutcome]:
    """Kill a writer until ``count`` kills interrupted it; stop at the first failure."""
    random, kills, interrupted = Random(f"{seed} {writer.name}"), list[KillOutcome](), 0
    home.mkdir(parents=True)
    number, typical_s = 1, 0.0
    for _ in range(2):  # the first version may take longer, because it also creates what later ones reuse
        began_s = time.monotonic()
        if failure := run_in_child(partial(writer.write, home, number, ignore)):
            return [KillOutcome(False, f"{writer.name} cannot be written without a kill: {failure}", 0)]
        typical_s, number = time.monotonic() - began_s, number + writer.per_run
    while interrupted < count:
        kill = kill_once(writer, home, number, typical_s, random)
        kills.append(kill)
        if kill.failure:
            break
        interrupted += kill.interrupted
        number = (kill.number - 1) // writer.per_run * writer.per_run + writer.per_run + 1
        progress(interrupted, count, f"{writer.name}, version {kill.number}")
    return kills


def main(arguments: list[str] | None = None) -> int:
    """Run ``python -m evidence.faults.kills``."""
    parser = command_parser("faults.kills", __doc__, seeded=True)
    parser.add_argument("--count", type=int, default=516, help="kills that interrupt a writer, in total (default 516)")
    options = parser.parse_args(arguments)
    by_writer, failures = {}, []
    with prepared_writers() as (home, writers):
        each = -(-options.count // len(writers))
        for writer in writers:
            kills = kill_writer(writer, home / writer.name, each, options.seed, print_progress(10))
            by_writer[writer.name] = sum(kill.interrupted for kill in kills)
            failures += [f"{writer.name}, kill {n}: {kill.failure}" for n, kill in enumerate(kills, 1) if kill.failure]
    figures = {"kills": sum(by_writer.values()), "kills_lost": len(failures)}
    return finish(options, figures, failures, by_writer=by_writer)


if __name__ == "__main__":
    sys.exit(main())
