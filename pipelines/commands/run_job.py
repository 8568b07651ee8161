"""A job as a command runs it, and where its assets are afterwards."""

import pathlib
from collections.abc import Mapping
from typing import Any

import dagster as dg

from pipelines.automation.lost_runs import fail_lost_runs
from pipelines.storage.io_manager import FolderPointers

__all__ = ["made", "succeeded"]


def succeeded(job: Any, steps: Mapping[str, Mapping[str, Any]], again: str) -> bool:
    """Run a job to its end, seen in the terminal.

    Args:
        job: reconstructable, since its steps are processes of their own.
        steps: configuration of its steps, by name.
        again: the command that goes on with what is finished, named if the run fails.
    """
    config = {"loggers": {"console": {"config": {}}}, "ops": {name: {"config": dict(of)} for name, of in steps.items()}}
    with dg.DagsterInstance.get() as instance:
        fail_lost_runs(instance)
        if dg.execute_job(job, instance=instance, run_config=config).success:
            return True
    print(f"\nThe run failed. {again} goes on with what is finished; `make ui` shows the failed step.")
    return False


def made(root: pathlib.Path, asset: str) -> pathlib.Path:
    """The folder of an asset that was last made below the home ``root``."""
    return FolderPointers(home=str(root)).folder(dg.AssetKey(asset))
