"""Identify processes, and end them with their children.

PIDs are reused; PID plus start time is unique. The start time is compared in the kernel's clock ticks, never as wall
clock time: clocks are adjusted, and a container may see another /proc/uptime than the kernel.
"""

import contextlib
import functools
import os
import pathlib
import signal
import subprocess
import time

_PARENT, _GROUP, _START = 1, 2, 19
"""Positions in /proc/PID/stat, counted from the process state (proc(5))."""


def start_ticks(pid: int) -> int | None:
    """Return when a process started, in clock ticks since boot; None without /proc.

    Raises:
        ProcessLookupError: no process of that PID runs; zombies do not count.
    """
    if not pathlib.Path("/proc/self/stat").is_file():
        return None
    fields = _stat(pathlib.Path("/proc", str(pid), "stat"))
    if fields is None:
        raise ProcessLookupError(pid)
    return int(fields[_START])


def start_mark(pid: int) -> str | None:
    """Return boot id and start ticks, which no other process of that PID has; None without /proc.

    Raises:
        ProcessLookupError: no process of that PID runs; zombies do not count.
    """
    ticks = start_ticks(pid)
    return None if ticks is None else f"{_boot_id()}:{ticks}"


def is_running(pid: int, mark: str | None = None) -> bool:
    """Return whether the process with that PID and `start_mark` runs; zombies do not count.

    Without ``mark``, any process of that PID counts.
    """
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    except PermissionError:  # a process of another user
        pass
    try:
        found = start_mark(pid)
    except ProcessLookupError:
        return False
    return mark is None or found is None or found == mark


def descendants(pid: int) -> list[int]:
    """Return the PIDs of all children, grandchildren and so on of a process; empty without /proc."""
    parents: dict[int, int] = {}
    for stat in pathlib.Path("/proc").glob("[0-9]*/stat"):
        fields = _stat(stat)
        if fields is not None:
            parents[int(stat.parent.name)] = int(fields[_PARENT])
    found, new = [], [pid]
    while new:
        new = [child for child, parent in parents.items() if parent in new]
        found += new
    return found


def parent_of(pid: int) -> int | None:
    """Return the PID of the parent process; None without /proc, or if the process has ended."""
    fields = _stat(pathlib.Path("/proc", str(pid), "stat"))
    return None if fields is None else int(fields[_PARENT])


def kill_with_descendants(pid: int) -> None:
    """Send SIGKILL to a process and its descendants."""
    for each in (pid, *descendants(pid)):
        with contextlib.suppress(ProcessLookupError):
            os.kill(each, signal.SIGKILL)


def stop_session(leader: subprocess.Popen, patience_s: float = 30.0) -> None:
    """Stop a server that was started with ``start_new_session=True``, and all processes that it started.

    The leader gets SIGTERM first, alone: Dagster's stops its children in order, and would hang if they ended before
    it. MLflow's forwards no signal, so then the remaining group gets SIGTERM, and finally SIGKILL.
    """
    leader.terminate()
    with contextlib.suppress(subprocess.TimeoutExpired):
        leader.wait(timeout=patience_s)
    with contextlib.suppress(ProcessLookupError):
        if leader.poll() is not None:
            os.killpg(leader.pid, signal.SIGTERM)
            until_s = time.monotonic() + patience_s
            while _group_runs(leader.pid) and time.monotonic() < until_s:
                time.sleep(0.05)
        os.killpg(leader.pid, signal.SIGKILL)
    leader.wait()


@functools.cache
def _boot_id() -> str:
    try:
        return pathlib.Path("/proc/sys/kernel/random/boot_id").read_text(encoding="ascii").strip()
    except OSError:
        return ""


def _stat(path: pathlib.Path) -> list[str] | None:
    """Return the fields of /proc/PID/stat from the process state on; None if the process has ended or is a zombie."""
    try:
        fields = path.read_text(encoding="utf-8").rpartition(")")[2].split()
    except OSError:
        return None
    return None if fields[0] in "ZX" else fields


def _group_runs(group: int) -> bool:
    """Return whether a process of the group runs; zombies do not count.

    Raises:
        ProcessLookupError: without /proc, the group has no process.
    """
    stats = list(pathlib.Path("/proc").glob("[0-9]*/stat"))
    if not stats:
        os.killpg(group, 0)
        return True
    return any(int(fields[_GROUP]) == group for fields in map(_stat, stats) if fields is not None)
