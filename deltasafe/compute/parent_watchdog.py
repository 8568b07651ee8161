"""End a worker process when its parent process ends, even if the parent was killed."""

import multiprocessing
import multiprocessing.connection
import os
import threading

_THREAD = "parent-watchdog"


def end_with_parent() -> None:
    """Start a thread that ends this process when its `multiprocessing` parent ends; without a parent, do nothing.

    Otherwise an idle worker would wait for tasks forever, and a busy one would work in parallel with the next run.
    Writes are atomic, so ending at any time is safe. Pools use this function as their initializer.
    """
    parent = multiprocessing.parent_process()
    if parent is not None and not any(thread.name == _THREAD for thread in threading.enumerate()):
        threading.Thread(target=_wait_for, args=(parent.sentinel,), name=_THREAD, daemon=True).start()


def _wait_for(sentinel: int) -> None:
    multiprocessing.connection.wait([sentinel])
    os._exit(1)
