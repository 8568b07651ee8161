"""A machine of the team as tests start it: a process with a home of its own.

python -m tests.services.machine JOB [ASSET ...]   a run of a job, or of some of its assets, in this process
"""

import json
import sys

import dagster as dg

from pipelines.build import build_defs
from pipelines.home import prepare_home


def make(root, job, *assets):
    """One run; its id and the kind of storage that it was recorded in."""
    definition = build_defs(root).resolve_job_def(job)
    chosen = [dg.AssetKey(name) for name in assets] or None
    with dg.DagsterInstance.get() as instance:
        result = definition.execute_in_process(instance=instance, asset_selection=chosen)
        storage = type(instance.run_storage).__name__
        return {"run_id": result.run_id, "storage": storage, "runs": instance.get_runs_count()}


if __name__ == "__main__":
    print(json.dumps(make(prepare_home(), *sys.argv[1:])))
