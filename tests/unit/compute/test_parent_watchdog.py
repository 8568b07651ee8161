"""Workers whose parent is killed: a pool's, busy and waiting, and those of a manager."""

import os
import pathlib
import signal
import subprocess
import sys
import time

import pytest

from deltasafe.compute.processes import start_ticks

PROGRAM = """
import multiprocessing, os, sys, time
from concurrent.futures import ProcessPoolExecutor
from multiprocessing.managers import SyncManager
from deltasafe.compute.parent_watchdog import end_with_parent

def say(what):
    os.write(1, f"{what}\\n".encode())  # in one piece: others write there too

def tell(seconds):
    say(os.getpid())
    time.sleep(seconds)

if __name__ == "__main__":
    end_with_parent()  # in a process that nobody's multiprocessing started, this does nothing
    context = multiprocessing.get_context(sys.argv[1])
    initializer = end_with_parent if sys.argv[2] == "held" else None
    manager = SyncManager(ctx=context)
    manager.start(initializer)
    say(manager._process.pid)
    pool = ProcessPoolExecutor(2, context, initializer)
    jobs = [pool.submit(tell, seconds) for seconds in (60.0, 0.5)]
    jobs[1].result()
    say("ready")
    time.sleep(60)
"""


def is_alive(pid):
    try:
        start_ticks(pid)
    except ProcessLookupError:
        return False
    return True


@pytest.mark.parametrize("method", ["spawn", "forkserver"])
@pytest.mark.parametrize("held", ["held", "not held"])
def test_workers_end_with_a_parent_that_was_killed(tmp_path, method, held):
    (tmp_path / "program.py").write_text(PROGRAM)
    environment = {**os.environ, "PYTHONPATH": str(pathlib.Path(__file__).parents[3])}
    command = [sys.executable, str(tmp_path / "program.py"), method, held]
    parent = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True, env=environment)
    assert parent.stdout is not None
    pids = [int(line) for line in iter(parent.stdout.readline, "ready\n")]
    assert len(pids) == 3
    assert all(map(is_alive, pids))
    parent.kill()
    parent.wait()
    parent.stdout.close()
    for _ in range(100):
        if not any(map(is_alive, pids)):
            break
        time.sleep(0.05)
    left = [pid for pid in pids if is_alive(pid)]
    for pid in left:
        os.kill(pid, signal.SIGKILL)
    assert bool(left) == (held == "not held")
