"""The code location that `dagster`, `dg` and `workspace.yaml` load."""

import dagster as dg

# imported at module level: the checkout is on the path only while this module is being loaded
from pipelines.build import build_defs
from pipelines.home import set_quiet_environment

set_quiet_environment()


@dg.definitions
def defs() -> dg.Definitions:
    """Return the definitions for `$DELTASAFE_HOME` and `$DELTASAFE_PRESET`."""
    return build_defs()
