"""Processes that end with the one that started them, even if that one was killed and could tell them nothing."""

import multiprocessing
import multiprocessing.connection
import os
import threading

__all__ = ["end_with_parent"]


def end_with_parent() -> None:
    """End this process as soon as the one that started it by `multiprocessing` has ended; elsewhere, do nothing.

    Workers of a pool would otherwise wait for work for ever, and one that works would go on beside the next run.
    What it was writing is left as by any kill: whole or not at all. Given to pools as their initializer.
    """
    parent = multiprocessing.parent_process()
    if parent is not None and not any(thread.name == _NAME for thread in threading.enumerate()):
        threading.Thread(target=_wait_for, args=(parent.sentinel,), name=_NAME, daemon=True).start()


_NAME = "lifeline"


def _wait_for(sentinel: int) -> None:
    multiprocessing.connection.wait([sentinel])
    os._exit(1)
