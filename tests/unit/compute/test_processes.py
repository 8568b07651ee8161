"""Processes are identified by PID and start time; servers are stopped together with their children."""

import os
import pathlib
import signal
import subprocess
import sys
import time

import pytest

from deltasafe.compute.processes import (
    descendants,
    is_running,
    kill_with_descendants,
    parent_of,
    start_mark,
    start_ticks,
    stop_session,
)

SLEEP = "import time; time.sleep(600)"
linux = pytest.mark.skipif(not pathlib.Path("/proc/self/stat").is_file(), reason="reads /proc")

CHILD = """
import pathlib, signal, sys, time
signal.signal(signal.SIGTERM, lambda *_: (pathlib.Path(sys.argv[1]).write_text("terminated"), sys.exit(0)))
print("ready", flush=True)
time.sleep(60)
"""

LEADER = """
import signal, subprocess, sys, time
child = subprocess.Popen([sys.executable, "-c", sys.argv[1], sys.argv[2]], stdout=subprocess.PIPE, text=True)
child.stdout.readline()

def stop_child(*_):
    child.terminate()
    print("child ended in order" if child.wait() == 0 else "child had ended before", flush=True)
    sys.exit(0)

handler = {"stops child": stop_child, "ignores child": signal.SIG_DFL, "ignores SIGTERM": signal.SIG_IGN}[sys.argv[3]]
signal.signal(signal.SIGTERM, handler)
print(child.pid, flush=True)
while True:
    time.sleep(60)
"""


@pytest.mark.skipif(not pathlib.Path("/proc/self/stat").is_file(), reason="reads /proc")
@pytest.mark.parametrize(
    ("leader_kind", "code", "stdout", "terminated"),
    [
        ("stops child", 0, "child ended in order", True),
        ("ignores child", -signal.SIGTERM, "", True),
        ("ignores SIGTERM", -signal.SIGKILL, "", False),
    ],
)
def test_a_server_stops_with_its_children(tmp_path, leader_kind, code, stdout, terminated):
    command = [sys.executable, "-c", LEADER, CHILD, str(tmp_path / "terminated"), leader_kind]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, start_new_session=True) as leader:
        child = int(leader.stdout.readline())
        assert start_ticks(child)
        stop_session(leader, patience_s=1.0 if leader_kind == "ignores SIGTERM" else 30.0)
        assert leader.returncode == code
        assert leader.stdout.read().strip() == stdout
    with pytest.raises(ProcessLookupError):
        for _ in range(100):  # a killed process may take a moment to end
            start_ticks(child)
            time.sleep(0.05)
    assert (tmp_path / "terminated").exists() == terminated


def test_a_killed_process_does_not_run_even_as_a_zombie():
    process = subprocess.Popen([sys.executable, "-c", SLEEP])
    mark = start_mark(process.pid)
    assert is_running(process.pid, mark)
    process.kill()
    os.waitid(os.P_PID, process.pid, os.WEXITED | os.WNOWAIT)  # ended, but not reaped
    if mark is not None:
        assert not is_running(process.pid, mark)
        assert not is_running(process.pid)
    process.wait()
    assert not is_running(process.pid, mark)


@linux
def test_another_start_time_or_boot_is_another_process():
    boot, _, ticks = start_mark(os.getpid()).rpartition(":")
    assert is_running(os.getpid(), f"{boot}:{ticks}")
    assert not is_running(os.getpid(), f"{boot}:{int(ticks) - 1}")
    assert not is_running(os.getpid(), f"earlier boot:{ticks}")
    assert is_running(os.getpid()), "without a mark, any process of that PID counts"


@pytest.mark.parametrize("step_s", [-1e6, -10.0, 10.0, 1e6])
def test_clock_changes_do_not_matter(monkeypatch, step_s):
    mark, now_s = start_mark(os.getpid()), time.time()
    monkeypatch.setattr(time, "time", lambda: now_s + step_s)
    assert is_running(os.getpid(), mark)


@linux
def test_descendants_are_found_and_killed():
    program = f"import subprocess, sys; subprocess.run([sys.executable, '-c', {SLEEP!r}])"
    with subprocess.Popen([sys.executable, "-c", program]) as parent:
        while not (found := descendants(parent.pid)):
            time.sleep(0.05)
        assert parent.pid in descendants(os.getpid())
        assert parent_of(parent.pid) == os.getpid()
        kill_with_descendants(parent.pid)
    while any(map(is_running, found)):
        time.sleep(0.05)
