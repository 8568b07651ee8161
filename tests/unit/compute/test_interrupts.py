"""Delayed interrupts: nothing breaks into the block, nothing is lost."""

import os
import signal
import subprocess
import sys
import threading

import pytest

from deltasafe.compute.interrupts import interrupts_delayed, sigint_blocked


@pytest.fixture(autouse=True)
def default_handler():
    """A shell starts background jobs with SIGINT ignored, and tests may be one."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


def test_a_signal_is_delivered_at_the_end_of_the_block():
    finished, before = [], signal.getsignal(signal.SIGINT)
    with pytest.raises(KeyboardInterrupt), interrupts_delayed():
        os.kill(os.getpid(), signal.SIGINT)
        os.kill(os.getpid(), signal.SIGINT)
        finished.append(True)
    assert finished
    assert signal.getsignal(signal.SIGINT) is before


def test_the_handler_of_sigterm_is_called_once_per_signal():
    received = []
    before = signal.signal(signal.SIGTERM, lambda number, _: received.append(number))
    try:
        with interrupts_delayed():
            for _ in range(2):
                signal.raise_signal(signal.SIGTERM)
            assert received == []
        assert received == [signal.SIGTERM] * 2
    finally:
        signal.signal(signal.SIGTERM, before)


def test_an_error_in_the_block_restores_the_handlers():
    before = signal.getsignal(signal.SIGINT)
    with pytest.raises(OSError, match="full"), interrupts_delayed():
        raise OSError("full")
    assert signal.getsignal(signal.SIGINT) is before


def test_another_thread_changes_no_handler():
    seen = []

    def look():
        with interrupts_delayed():
            seen.append(signal.getsignal(signal.SIGINT))

    thread = threading.Thread(target=look)
    thread.start()
    thread.join()
    assert seen == [signal.getsignal(signal.SIGINT)]


def test_a_process_started_with_sigint_blocked_ignores_it():
    program = "import os, signal; os.kill(os.getpid(), signal.SIGINT); print('still here')"
    with sigint_blocked():
        said = subprocess.run([sys.executable, "-c", program], check=True, capture_output=True, text=True).stdout
    assert said == "still here\n"
    with pytest.raises(KeyboardInterrupt):
        os.kill(os.getpid(), signal.SIGINT)
