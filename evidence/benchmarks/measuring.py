"""Timing of programs in turn on a machine that other processes also use."""

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

from evidence.reporting import command_parser


def benchmark_parser(module: str, description: str | None, repeats: int = 9) -> argparse.ArgumentParser:
    """Create a parser with the options that all benchmarks share."""
    parser = command_parser(f"benchmarks.{module}", description)
    parser.add_argument("--repeats", type=int, default=repeats, help="repeats; medians are over them (%(default)s)")
    parser.add_argument("--tiny", action="store_true", help="tiny sizes: checks that the benchmark runs, no more")
    return parser


def interleaved(programs: Mapping[str, Callable[[], Any]], repeats: int) -> dict[str, list[float]]:
    """Return seconds of each program, called in turn, so that changes of the machine's load affect all of them."""
    for program in programs.values():
        program()
        program()
    taken: dict[str, list[float]] = {name: [] for name in programs}
    for _ in range(repeats):
        for name, program in programs.items():
            began_s = time.perf_counter()
            program()
            taken[name].append(time.perf_counter() - began_s)
    return taken


class foreign_cores:  # noqa: N801
    """Context that measures how many cores other processes kept busy (`cores`; NaN where this is unknown)."""

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
    """Return the highest FLOP/s of a product of square matrices, with all of torch's threads."""
    a, b = (torch.randn(size, size).to(dtype) for _ in range(2))
    seconds = interleaved({"mm": lambda: a @ b}, repeats)["mm"]
    return 2 * size**3 / min(seconds)


def median_ms(seconds: list[float]) -> float:
    """Return the median in milliseconds."""
    return 1e3 * statistics.median(seconds)
