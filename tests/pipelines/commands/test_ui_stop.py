"""Stopping `make ui`: whatever interrupts the clean-up, no server stays."""

import pathlib
import signal
import subprocess
import sys
import time

import pytest

from deltasafe.compute.processes import is_running

ROOT = pathlib.Path(__file__).parents[3]
SLOW_TO_STOP = (
    "import os, pathlib, signal, sys, time\n"
    "signal.signal(signal.SIGTERM, lambda *_: (time.sleep(0.5), sys.exit(0)))\n"
    "pathlib.Path(sys.argv[1]).write_text(str(os.getpid()))\n"
    "time.sleep(600)"
)
PROGRAM = (
    "import signal, sys\n"
    "signal.signal(signal.SIGHUP, signal.SIG_DFL)\n"
    "from pipelines.commands.ui import _serve\n"
    f"sys.exit(_serve([[sys.executable, '-c', {SLOW_TO_STOP!r}, file] for file in sys.argv[1:]]))"
)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP], ids=lambda number: number.name)
def test_a_second_signal_leaves_no_server(tmp_path, number):
    files = [tmp_path / "dagster", tmp_path / "mlflow"]
    command = [sys.executable, "-c", PROGRAM, *map(str, files)]
    with subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, text=True) as process:
        while not all(file.is_file() and file.read_text() for file in files):
            assert process.poll() is None
            time.sleep(0.02)
        process.send_signal(number)
        assert process.stdout.readline() == "\n"
        for _ in range(3):
            time.sleep(0.05)
            process.send_signal(number)
        assert process.wait() == 0
    assert not [file.name for file in files if is_running(int(file.read_text()))]
