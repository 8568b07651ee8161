"""Servers with a child: one stops it and waits for it, one forgets it, one listens to nobody."""

import pathlib
import signal
import subprocess
import sys
import time

import pytest

from deltasafe.compute.processes import start_ticks, stop_session

CHILD = """
import pathlib, signal, sys, time
signal.signal(signal.SIGTERM, lambda *_: (pathlib.Path(sys.argv[1]).write_text("asked"), sys.exit(0)))
print("ready", flush=True)
time.sleep(60)
"""

LEADER = """
import signal, subprocess, sys, time
child = subprocess.Popen([sys.executable, "-c", sys.argv[1], sys.argv[2]], stdout=subprocess.PIPE, text=True)
child.stdout.readline()

def stops_its_child(*_):
    child.terminate()
    print("child ended by itself" if child.wait() == 0 else "child was dead before", flush=True)
    sys.exit(0)

what = {"in order": stops_its_child, "forgets": signal.SIG_DFL, "deaf": signal.SIG_IGN}[sys.argv[3]]
signal.signal(signal.SIGTERM, what)
print(child.pid, flush=True)
while True:
    time.sleep(60)
"""


@pytest.mark.skipif(not pathlib.Path("/proc/self/stat").is_file(), reason="looks whether a process is there in /proc")
@pytest.mark.parametrize(
    ("leads", "code", "said", "asked"),
    [
        ("in order", 0, "child ended by itself", True),
        ("forgets", -signal.SIGTERM, "", True),
        ("deaf", -signal.SIGKILL, "", False),
    ],
)
def test_a_server_ends_with_its_children(tmp_path, leads, code, said, asked):
    command = [sys.executable, "-c", LEADER, CHILD, str(tmp_path / "asked"), leads]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, start_new_session=True) as leader:
        child = int(leader.stdout.readline())
        assert start_ticks(child)
        stop_session(leader, patience_s=1.0 if leads == "deaf" else 30.0)
        assert leader.returncode == code
        assert leader.stdout.read().strip() == said
    with pytest.raises(ProcessLookupError):
        for _ in range(100):  # a killed one may take a moment
            start_ticks(child)
            time.sleep(0.05)
    assert (tmp_path / "asked").exists() == asked
