"""What `dagster`, `dg` and `workspace.yaml` load."""

import warnings

import dagster as dg

from pipelines.home import set_quiet_environment

set_quiet_environment()
# single-run backfills and ranges of partitions are marked as beta in Dagster 1.13; both are covered by tests here
warnings.filterwarnings("ignore", category=dg.BetaWarning)


@dg.definitions
def defs() -> dg.Definitions:
    from pipelines.build import build_defs

    return build_defs()
