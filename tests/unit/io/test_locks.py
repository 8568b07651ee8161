"""Locks between processes: mutual exclusion, the holder in the error, release when the holder is killed."""

import multiprocessing
import os
import signal
import subprocess
import sys

import pytest

from deltasafe.errors import LockedError
from deltasafe.io.locks import FileLock

HOLDER = """
import pathlib, sys, time
from deltasafe.io.locks import FileLock
with FileLock(pathlib.Path(sys.argv[1])):
    print("held", flush=True)
    time.sleep(600)
"""


@pytest.fixture
def holder(tmp_path):
    command = [sys.executable, "-c", HOLDER, str(tmp_path / "lock")]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout.readline() == "held\n"
        yield process
        process.kill()


def test_the_error_names_the_holder(tmp_path, holder):
    with pytest.raises(LockedError, match=f"is in use by process {holder.pid} of "), FileLock(tmp_path / "lock", 0.2):
        pass


def test_the_lock_of_a_killed_process_is_free(tmp_path, holder):
    holder.send_signal(signal.SIGKILL)
    holder.wait()
    assert (tmp_path / "lock").is_file()
    with FileLock(tmp_path / "lock", 0.0):
        assert str(os.getpid()) in (tmp_path / "lock").read_text()
    assert not (tmp_path / "lock").exists()


def test_an_exception_releases_the_lock(tmp_path):
    with pytest.raises(ValueError, match="wrong"), FileLock(tmp_path / "lock"):
        raise ValueError("wrong")
    with FileLock(tmp_path / "lock", 0.0):
        pass


def increment(folder, times):
    for _ in range(times):
        with FileLock(folder / "lock"):
            number = int((folder / "number").read_text())
            (folder / "number").write_text(f"{number + 1}")


def test_only_one_process_holds_the_lock(tmp_path):
    (tmp_path / "number").write_text("0")
    context = multiprocessing.get_context("spawn")
    processes = [context.Process(target=increment, args=(tmp_path, 100)) for _ in range(3)]
    for process in processes:
        process.start()
    for process in processes:
        process.join()
    assert (tmp_path / "number").read_text() == "300"
