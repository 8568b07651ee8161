"""Which runs belong to this machine, where machines share one database."""

import os
import platform

import dagster as dg

from pipelines.home import DATABASE_VARIABLE

__all__ = ["MACHINE_TAG", "runs_here"]

MACHINE_TAG = "deltasafe/machine"


def runs_here(run: dg.DagsterRun) -> bool:
    """Whether the run's process is, or was, one of this machine.

    A home of its own has no others; in a shared database those runs that say so. A run that died before it could say
    it is ended by Dagster's own start timeout.
    """
    return not os.environ.get(DATABASE_VARIABLE) or run.tags.get(MACHINE_TAG) == platform.node()
