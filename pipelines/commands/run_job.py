"""Run a job from the command line, and find the folders of its assets."""

import pathlib
from collections.abc import Mapping
from typing import Any

import dagster as dg

from pipelines.automation.lost_runs import fail_lost_runs
from pipelines.storage.io_manager import FolderPointers

__all__ = ["latest_folder", "run_to_end"]


def run_to_end(job: Any, steps: Mapping[str, Mapping[str, Any]], again: str) -> bool:
    """Run a job to its end with progress in the terminal; return whether it succeeded.

    Args:
        job: a reconstructable job, because its steps are separate processes.
        steps: configuration by step.
        again: the command that resumes the run; printed if the run fails.
    """
    ops = {name: {"config": dict(config)} for name, config in steps.items()}
    with dg.DagsterInstance.get() as instance:
        fail_lost_runs(instance)  # a killed run would hold its pool slots forever
        run_config = {"loggers": {"console": {"config": {}}}, "ops": ops}
        if dg.execute_job(job, instance=instance, run_config=run_config).success:
            return True
    print(f"\nThe run failed. {again} resumes it and keeps finished work; `make ui` shows the failed step.")
    return False


def latest_folder(root: pathlib.Path, asset: str) -> pathlib.Path:
    """Return the folder of the latest version of an asset in the home ``root``."""
    return FolderPointers(home=str(root)).folder(dg.AssetKey(asset))
