"""Options and records that all commands of this package share."""

import argparse
import pathlib
import sys
from collections.abc import Mapping
from typing import Any

from deltasafe.progress import Progress
from pipelines.records import merge_part

__all__ = ["conclude", "parser", "progress_every"]


def parser(description: str | None, seed: int = 0) -> argparse.ArgumentParser:
    """Options of every command."""
    made = argparse.ArgumentParser(description=description)
    made.add_argument("--record", type=pathlib.Path, metavar="FILE", help="also merge the figures into this JSON file")
    made.add_argument("--seed", type=int, default=seed, help=f"of everything drawn (default {seed})")
    return made


def progress_every(count: int) -> Progress:
    """Prints a line for each ``count`` pieces of work, and for the last."""

    def progress(done: int, total: int, what: str) -> None:
        if done % count == 0 or done == total:
            print(f"{done} / {total}  {what}", flush=True)

    return progress


def conclude(
    name: str, figures: Mapping[str, float], options: argparse.Namespace, failures: list[str], **about: Any
) -> int:
    """Print figures and failures, record them if asked to; the exit status is 1 if anything failed."""
    for failure in failures[:50]:
        print(f"FAILED  {failure}", file=sys.stderr)
    for key, value in figures.items():
        print(f"{key}: {value:g}")
    if options.record is not None:
        asked = " ".join(
            f"--{key.replace('_', '-')} {value}"
            for key, value in vars(options).items()
            if key not in ("record", "seed") and value is not None
        )
        command = f"python -m evidence.faults.{name} {asked} --seed {options.seed}".replace("  ", " ")
        merge_part(options.record, name, figures, command=command, seeds={"seed": options.seed}, **about)
        print(f"written: {options.record}")
    return 1 if failures else 0
