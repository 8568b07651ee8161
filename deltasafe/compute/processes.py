"""Identify processes, and end them with their children.

PIDs are reused; PID plus start time is unique. The start is compared in ticks as the kernel gives them, never with a
clock: clocks are set, and containers see another /proc/uptime than the kernel's.
"""

import contextlib
import functools
import os
import pathlib
import signal
import subprocess
import time

__all__ = [
    "descendants",
    "is_running",
    "kill_with_descendants",
    "parent_of",
    "start_mark",
    "start_ticks",
    "stop_session",
]


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


def start_mark(pid: int) -> str | None:
    """Return boot and start ticks of a process, which no other process of that PID has; None without /proc.

    Raises:
        ProcessLookupError: as by `start_ticks`.
    """
    ticks = start_ticks(pid)
    return None if ticks is None else f"{_boot_id()}:{ticks}"


def is_running(pid: int, mark: str | None = None) -> bool:
    """Whether the process ``pid`` runs, and is the one whose `start_mark` was ``mark``; zombies do not run.

    Without ``mark``, any process of that PID counts.
    """
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    except PermissionError:  # another user's
        pass
    try:
        found = start_mark(pid)
    except ProcessLookupError:
        return False
    return mark is None or found is None or found == mark


def descendants(pid: int) -> list[int]:
    """PIDs of the children of a process, of their children, and so on; empty without /proc."""
    parents: dict[int, int] = {}
    for stat in pathlib.Path("/proc").glob("[0-9]*/stat"):
        fields = _running(stat)
        if fields is not None:
            parents[int(stat.parent.name)] = int(fields[1])
    found, new = [], [pid]
    while new:
        new = [child for child, parent in parents.items() if parent in new]
        found += new
    return found


def parent_of(pid: int) -> int | None:
    """PID of the parent of a process; None without /proc, or if it has ended."""
    fields = _running(pathlib.Path("/proc", str(pid), "stat"))
    return None if fields is None else int(fields[1])


def kill_with_descendants(pid: int) -> None:
    """SIGKILL a process and its descendants."""
    for each in (pid, *descendants(pid)):
        with contextlib.suppress(ProcessLookupError):
            os.kill(each, signal.SIGKILL)


@functools.cache
def _boot_id() -> str:
    try:
        return pathlib.Path("/proc/sys/kernel/random/boot_id").read_text(encoding="ascii").strip()
    except OSError:
        return ""


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
