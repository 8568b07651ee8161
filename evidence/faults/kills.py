"""SIGKILL at random instants while each writer works: nothing torn, nothing lost, and the next run just goes on."""

import pathlib
import sys
import time
from functools import partial
from random import Random

from deltasafe.progress import Progress, silent
from evidence.faults.killing import Killed, Writer, kill_once, run_alone
from evidence.faults.reporting import conclude, parser, progress_every
from evidence.faults.writers import prepared_writers

__all__ = ["kill_writer", "main"]


def kill_writer(writer: Writer, home: pathlib.Path, count: int, seed: int, progress: Progress = silent) -> list[Killed]:
    """Kill it until it was ``count`` times at work then; stops at the first thing that is wrong."""
    random, kills = Random(f"{seed} {writer.name}"), list[Killed]()
    home.mkdir(parents=True)
    number, typical_s = 1, 0.0
    for _ in range(2):  # the first of its kind may have to make more than those that follow
        began_s, following = time.monotonic(), number
        wrong = run_alone(partial(writer.write, home, following, lambda done: None))
        if wrong:
            return [Killed(False, f"{writer.name} cannot even be written: {wrong}", 0)]
        typical_s, number = time.monotonic() - began_s, number + writer.per_run
    while sum(kill.at_work for kill in kills) < count:
        kill = kill_once(writer, home, number, typical_s, random)
        kills.append(kill)
        if kill.wrong:
            break
        number = (kill.number - 1) // writer.per_run * writer.per_run + writer.per_run + 1
        progress(sum(kill.at_work for kill in kills), count, f"{writer.name}, version {kill.number}")
    return kills


def main(arguments: list[str] | None = None) -> int:
    """``python -m evidence.faults.kills``."""
    made = parser(__doc__)
    made.add_argument("--count", type=int, default=516, help="kills of writers at work, in all (default 516)")
    options = made.parse_args(arguments)
    by_writer, failures = {}, []
    with prepared_writers() as (home, all_of_them):
        for writer in all_of_them:
            kills = kill_writer(
                writer, home / writer.name, -(-options.count // len(all_of_them)), options.seed, progress_every(10)
            )
            by_writer[writer.name] = sum(kill.at_work for kill in kills)
            failures += [f"{writer.name}, kill {n}: {kill.wrong}" for n, kill in enumerate(kills, 1) if kill.wrong]
    figures = {"kills": sum(by_writer.values()), "kills_lost": len(failures)}
    return conclude("kills", figures, options, failures, by_writer=by_writer)


if __name__ == "__main__":
    sys.exit(main())
