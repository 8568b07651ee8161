"""Workers of a killed parent end: busy and idle ones of a pool, and the process of a manager."""

import os
import pathlib
import signal
import subprocess
import sys
import time

import pytest

from deltasafe.compute.processes import is_running

PROGRAM = """
import multiprocessing, os, sys, time
from concurrent.futures import ProcessPoolExecutor
from multiprocessing.managers import SyncManager
from deltasafe.compute.parent_watchdog import end_with_parent

def write_line(value):
    os.write(1, f"{value}\\n".encode())  # one write: other processes share this pipe

def work(seconds):
    write_line(os.getpid())
    time.sleep(seconds)

if __name__ == "__main__":
    end_with_parent()  # without a multiprocessing parent, this does nothing
    context = multiprocessing.get_context(sys.argv[1])
    initializer = end_with_parent if sys.argv[2] == "watchdog" else None
    manager = SyncManager(ctx=context)
    manager.start(initializer)
    write_line(manager._process.pid)
    pool = ProcessPoolExecutor(2, context, initializer)
    jobs = [pool.submit(work, seconds) for seconds in (60.0, 0.5)]
    jobs[1].result()
    write_line("ready")
    time.sleep(60)
"""


@pytest.mark.parametrize("method", ["spawn", "forkserver"])
@pytest.mark.parametrize("mode", ["watchdog", "no watchdog"])
def test_workers_end_when_their_parent_is_killed(tmp_path, method, mode):
    (tmp_path / "program.py").write_text(PROGRAM)
    environment = {**os.environ, "PYTHONPATH": str(pathlib.Path(__file__).parents[3])}
    command = [sys.executable, str(tmp_path / "program.py"), method, mode]
    parent = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True, env=environment)
    assert parent.stdout is not None
    pids = [int(line) for line in iter(parent.stdout.readline, "ready\n")]
    assert len(pids) == 3
    assert all(map(is_running, pids))
    parent.kill()
    parent.wait()
    parent.stdout.close()
    for _ in range(100):
        if not any(map(is_running, pids)):
            break
        time.sleep(0.05)
    left = [pid for pid in pids if is_running(pid)]
    for pid in left:
        os.kill(pid, signal.SIGKILL)
    assert bool(left) == (mode == "no watchdog")
