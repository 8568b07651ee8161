"""Progress of long steps in Dagster's event log, at most one line every few seconds."""

import time

import dagster as dg

from deltasafe.compute.progress import Progress

__all__ = ["progress_of"]


def progress_of(context: dg.AssetExecutionContext, every_s: float = 10.0) -> Progress:
    """A progress callable that writes to the log of ``context``: the first, the last, and some in between."""
    last_s = -every_s

    def report(done: int, total: int, message: str) -> None:
        nonlocal last_s
        now_s = time.monotonic()
        if done >= total or now_s - last_s >= every_s:
            last_s = now_s
            context.log.info(f"{done}/{total} {message}")

    return report
