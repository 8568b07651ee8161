"""A machine of a team in tests: a process with its own home.

python -m tests.services.machine JOB [ASSET ...]   run a job, or some of its assets, in this process
"""

import json
import sys

import dagster as dg

from pipelines.build import build_defs
from pipelines.home import prepare_home


def run_job(root, job, *assets):
    """Run a job; return the run id, the class of the run storage, and the number of runs in it."""
    definition = build_defs(root).resolve_job_def(job)
    selection = [dg.AssetKey(name) for name in assets] or None
    with dg.DagsterInstance.get() as instance:
        result = definition.execute_in_process(instance=instance, asset_selection=selection)
        storage = type(instance.run_storage).__name__
        return {"run_id": result.run_id, "storage": storage, "runs": instance.get_runs_count()}


if __name__ == "__main__":
    print(json.dumps(run_job(prepare_home(), *sys.argv[1:])))
