"""Run a job from the command line, and find the folders of its assets."""

import pathlib
import sys
from collections.abc import Mapping
from typing import Any

import dagster as dg
from dagster._core.definitions.reconstruct import ReconstructableJob
from dagster._core.execution.api import execute_run
from dagster._core.utils import make_new_run_id

from assets.interfaces import Store
from pipelines.automation.launch_check import launch_error
from pipelines.automation.lost_runs import fail_lost_runs
from pipelines.home import DATASETS, home
from pipelines.storage.io_manager import FolderPointers
from pipelines.supervision import process_tags


def job_named(name: str) -> dg.JobDefinition:
    """Return a job of this project; the processes of its steps call this function, too."""
    from pipelines.definitions import defs

    return defs().resolve_job_def(name)


def run_to_end(name: str, steps: Mapping[str, Mapping[str, Any]], again: str) -> bool:
    """Run a job to its end with progress in the terminal; return whether it succeeded.

    Settings or inputs with defects are listed, and nothing is run.

    Args:
        name: of the job. Its steps are separate processes.
        steps: configuration by step.
        again: the command that resumes the run; printed if the run fails.
    """
    job = dg.build_reconstructable_job(__name__, job_named.__name__, (name,))
    ops = {step: {"config": dict(config)} for step, config in steps.items()}
    names = [node.name for node in job.get_definition().nodes]
    if error := launch_error({"ops": ops}, names, Store(home(), DATASETS)):
        print(f"\n{error}", file=sys.stderr)
        return False
    with dg.DagsterInstance.get() as instance:
        fail_lost_runs(instance)  # a killed run would hold its pool slots forever
        run_config = {"loggers": {"console": {"config": {}}}, "ops": ops}
        if execute(job, instance, run_config).success:
            return True
    print(f"\nThe run failed. {again} resumes it and keeps finished work; `make ui` shows the failed step.")
    return False


def execute(
    job: ReconstructableJob, instance: dg.DagsterInstance, run_config: Mapping[str, Any]
) -> dg.JobExecutionResult:
    """Execute a job in this process, as `dagster.execute_job`, but create the run with its process.

    Otherwise a run that is killed before its executor begins would stay in the state "not started" forever.
    """
    definition, run_id = job.get_definition(), make_new_run_id()
    run = instance.create_run_for_job(
        definition,
        run_id=run_id,
        run_config=run_config,
        tags={**definition.run_tags, **process_tags(run_id)},
        job_code_origin=job.get_python_origin(),
    )
    return execute_run(job, run, instance)


def latest_folder(root: pathlib.Path, asset: str) -> pathlib.Path:
    """Return the folder of the latest version of an asset in the home ``root``."""
    return FolderPointers(home=str(root)).folder(dg.AssetKey(asset))
