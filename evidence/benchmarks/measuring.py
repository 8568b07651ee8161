"""Timing side by side on a machine that others use too, and the record of what was measured."""

import argparse
import math
import os
import pathlib
import resource
import statistics
import time
from collections.abc import Callable, Mapping
from typing import Any

import torch

from pipelines.provenance import commit, machine
from pipelines.records import merge_part

__all__ = ["conclude", "foreign_cores", "interleaved", "matmul_peak", "median_ms", "parser", "say"]


def interleaved(programs: Mapping[str, Callable[[], Any]], repeats: int) -> dict[str, list[float]]:
    """Seconds of each program, called in turns, so that a change of the machine's load meets all of them."""
    for program in programs.values():
        program()
        program()
    taken: dict[str, list[float]] = {name: [] for name in programs}
    for _ in range(repeats):
        for name, program in programs.items():
            began = time.perf_counter()
            program()
            taken[name].append(time.perf_counter() - began)
    return taken


class foreign_cores:  # noqa: N801
    """Context that measures how many cores other processes kept busy meanwhile (`cores`; NaN where unknown)."""

    def __enter__(self) -> "foreign_cores":
        self._before = _busy_s(), _own_s(), time.perf_counter()
        self.cores = float("nan")
        return self

    def __exit__(self, *error: object) -> None:
        busy_s, own_s, began_s = self._before
        elapsed_s = time.perf_counter() - began_s
        foreign_s = _busy_s() - busy_s - (_own_s() - own_s)
        self.cores = foreign_s if math.isnan(foreign_s) else max(0.0, foreign_s / elapsed_s)


def _busy_s() -> float:
    stat = pathlib.Path("/proc/stat")
    if not stat.is_file():
        return float("nan")
    ticks = [int(value) for value in stat.read_text().splitlines()[0].split()[1:]]
    return (sum(ticks) - ticks[3] - ticks[4]) / os.sysconf("SC_CLK_TCK")


def _own_s() -> float:
    used = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(usage.ru_utime + usage.ru_stime for usage in used)


def matmul_peak(dtype: torch.dtype, size: int = 2048, repeats: int = 5) -> float:
    """Largest multiplications and additions a second (FLOP/s) of square matrices, all of torch's threads."""
    a, b = (torch.randn(size, size).to(dtype) for _ in range(2))
    seconds = interleaved({"mm": lambda: a @ b}, repeats)["mm"]
    return 2 * size**3 / min(seconds)


def parser(description: str | None) -> argparse.ArgumentParser:
    """Options that every benchmark has."""
    made = argparse.ArgumentParser(description=description)
    made.add_argument("--repeats", type=int, default=9, help="turns (default 9); medians are over them")
    made.add_argument("--record", type=pathlib.Path, help="also merge the figures into this JSON file")
    made.add_argument("--tiny", action="store_true", help="everything very small: shows that it runs, measures nothing")
    return made


def conclude(record: dict[str, Any], destination: pathlib.Path | None, command: str) -> None:
    """Print by what was measured, and merge the record into a file of several benchmarks if asked to.

    Args:
        record: ``figures`` (name -> number) with whatever explains them, ``seeds`` among it.
        destination: JSON: ``figures`` of all its benchmarks, and under ``parts`` each one's own record. Figures
            that this benchmark gave earlier are replaced, those of others stay.
        command: what measured it, with its options.
    """
    record = {"seeds": {}, "load_1min": os.getloadavg()[0], **_without_nan(record)}
    say(f"{machine()}; load {record['load_1min']:.1f}; commit {commit()}")
    if destination is None:
        return
    name = command.rpartition("-m evidence.benchmarks.")[2].split(maxsplit=1)[0]
    merge_part(destination, name, command=command, **record)
    say(f"written: {destination}")


def _without_nan(value: Any) -> Any:
    """JSON has no NaN: what is unknown is null."""
    if isinstance(value, dict):
        return {key: _without_nan(each) for key, each in value.items()}
    if isinstance(value, list | tuple):
        return [_without_nan(each) for each in value]
    return None if isinstance(value, float) and math.isnan(value) else value


def say(text: str) -> None:
    """Print at once, also into a pipe."""
    print(text, flush=True)


def median_ms(seconds: list[float]) -> float:
    """Median in milliseconds."""
    return 1e3 * statistics.median(seconds)
