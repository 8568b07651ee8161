"""A run of one long step, for tests that interrupt it.

Modes: ``workers`` (two worker processes of the local executor) or ``deaf`` (the step ignores interrupts).
"""

import contextlib
import os
import pathlib
import signal
import time

import dagster as dg

from deltasafe.compute.executor import LOCAL, Needs, Task
from pipelines.storage.io_manager import FolderPointers
from pipelines.supervision import supervised

POOL = "cores"


def sleep() -> None:
    mark()
    time.sleep(3600)


def mark() -> None:
    """Create a file that shows that this process works."""
    (pathlib.Path(os.environ["LONG_RUN"]) / f"{os.getpid()}").touch()


@dg.asset(pool=POOL)
def long_work() -> None:
    """Work for an hour."""
    how = os.environ["LONG_RUN_HOW"]
    if how == "workers":
        with contextlib.closing(LOCAL.run([Task("", sleep)] * 2, 2, Needs(own_process=True))) as finished:
            dict(finished)
    mark()
    while True:
        try:
            time.sleep(3600)
        except BaseException:
            if how != "deaf":
                raise


def job() -> dg.JobDefinition:
    """Return the job; the processes of its steps import it by this name."""
    executor = supervised(dg.multiprocess_executor.configured({"start_method": {"forkserver": {}}}))
    resources = {"io_manager": FolderPointers(home=os.environ["LONG_RUN"])}
    assets = [long_work]
    defs = dg.Definitions(assets, jobs=[dg.define_asset_job("long", assets)], resources=resources, executor=executor)
    return defs.resolve_job_def("long")


def main(how: str) -> None:
    """Run the job; called by ``python -c``, so that child processes can import this module by its full name."""
    os.environ["LONG_RUN_HOW"] = how
    signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell ignores it in background jobs
    with dg.DagsterInstance.get() as instance:
        print(dg.execute_job(dg.reconstructable(job), instance=instance).success)
