"""Which process bears a number, and how a server ends that has children.

Numbers are given away again; the number and the start together are not.
"""

import contextlib
import os
import pathlib
import signal
import subprocess
import time

__all__ = ["start_ticks", "stop_session"]


def start_ticks(pid: int) -> int | None:
    """When the process began, in ticks since the machine did; None where that cannot be told (no /proc).

    Raises:
        ProcessLookupError: there is none of that number; one that has ended and was not waited for yet is none.
    """
    if not pathlib.Path("/proc/self/stat").is_file():
        return None
    fields = _running(pathlib.Path("/proc", str(pid), "stat"))
    if fields is None:
        raise ProcessLookupError(pid)
    return int(fields[19])


def _running(stat: pathlib.Path) -> list[str] | None:
    """Fields of a process from its state on; None if it has ended, whether or not it was waited for."""
    try:
        fields = stat.read_text(encoding="utf-8").rpartition(")")[2].split()
    except OSError:
        return None
    return None if fields[0] in "ZX" else fields


def stop_session(leader: subprocess.Popen, patience_s: float = 30.0) -> None:
    """End a server that was started with ``start_new_session=True``, and whatever it has started.

    The leader is asked first, and alone: some (Dagster's) stop their children in order, and would wait for ever if
    those ended before; others (MLflow's) pass nothing on. Then whoever is left is asked, and killed if it does not
    listen.
    """
    leader.terminate()
    with contextlib.suppress(subprocess.TimeoutExpired):
        leader.wait(timeout=patience_s)
    with contextlib.suppress(ProcessLookupError):
        if leader.poll() is not None:
            os.killpg(leader.pid, signal.SIGTERM)
            until = time.monotonic() + patience_s
            while _is_at_work(leader.pid) and time.monotonic() < until:
                time.sleep(0.05)
        os.killpg(leader.pid, signal.SIGKILL)
    leader.wait()


def _is_at_work(group: int) -> bool:
    """Whether a process of the group still runs; one that only has to be waited for, by whomever, does not."""
    stats = list(pathlib.Path("/proc").glob("[0-9]*/stat"))
    if not stats:
        os.killpg(group, 0)
        return True
    return any(int(fields[2]) == group for fields in map(_running, stats) if fields is not None)
