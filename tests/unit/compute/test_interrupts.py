"""Delayed interrupts: no signal interrupts the block, and none is lost."""

import os
import signal
import subprocess
import sys
import threading

import pytest

from deltasafe.compute.interrupts import interrupts_delayed, sigint_blocked


@pytest.fixture(autouse=True)
def default_handler():
    """Restore the default handler: a shell ignores SIGINT in background jobs, and the tests may be one."""
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


def test_in_another_thread_no_handler_is_changed():
    seen = []

    def enter():
        with interrupts_delayed():
            seen.append(signal.getsignal(signal.SIGINT))

    thread = threading.Thread(target=enter)
    thread.start()
    thread.join()
    assert seen == [signal.getsignal(signal.SIGINT)]


def test_a_process_started_with_sigint_blocked_ignores_it():
    program = "import os, signal; os.kill(os.getpid(), signal.SIGINT); print('still here')"
    with sigint_blocked():
        stdout = subprocess.run([sys.executable, "-c", program], check=True, capture_output=True, text=True).stdout
    assert stdout == "still here\n"
    with pytest.raises(KeyboardInterrupt):
        os.kill(os.getpid(), signal.SIGINT)
