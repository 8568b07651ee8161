"""Delay signals during clean-up, and start worker processes that ignore Ctrl-C."""

import contextlib
import signal
import threading
from collections.abc import Iterator
from typing import Any


@contextlib.contextmanager
def interrupts_delayed() -> Iterator[None]:
    """Delay the Python handlers of SIGINT and SIGTERM to the end of the block.

    Only the main thread runs handlers; in other threads this does nothing. A signal without a Python handler (SIGTERM
    in a plain script) acts at once.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    handlers: dict[int, Any] = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    handlers = {number: handler for number, handler in handlers.items() if callable(handler)}
    received: list[int] = []
    try:
        for number in handlers:
            signal.signal(number, lambda number, _: received.append(number))
        yield
    finally:
        for number, handler in handlers.items():
            signal.signal(number, handler)
        for number in received:
            signal.raise_signal(number)


@contextlib.contextmanager
def sigint_blocked() -> Iterator[None]:
    """Start processes that never receive SIGINT: a terminal sends Ctrl-C to the whole process group.

    Children inherit the mask from this thread. A handler set in the child would come too late: the traceback of a
    KeyboardInterrupt during its imports would already be on the terminal.
    """
    before = signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGINT])
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
