"""Progress of long steps in Dagster's event log, with a limited number of lines."""

import time

import dagster as dg

from deltasafe.compute.progress import Progress


def progress_of(context: dg.AssetExecutionContext, every_s: float = 10.0) -> Progress:
    """Create a progress callback that logs the first and the last report, and others every ``every_s`` seconds."""
    last_s = -every_s

    def report(done: int, total: int, message: str) -> None:
        nonlocal last_s
        now_s = time.monotonic()
        if done >= total or now_s - last_s >= every_s:
            last_s = now_s
            context.log.info(f"{done}/{total} {message}")

    return report
