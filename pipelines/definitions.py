"""The code location that `dagster`, `dg` and `workspace.yaml` load."""

import logging
import os

import dagster as dg

# imported at module level: the checkout is on the path only while this module is being loaded
from pipelines.build import build_defs
from pipelines.home import home, set_quiet_environment

set_quiet_environment()
if not os.environ.get("DAGSTER_HOME"):  # `dg dev` and `dagster dev`
    logging.getLogger("deltasafe").warning(
        "DAGSTER_HOME is not set: runs are not recorded in %s, and have no pools and no monitoring; use `make ui`, "
        "or set DAGSTER_HOME=%s",
        home(),
        home() / "dagster",
    )


@dg.definitions
def defs() -> dg.Definitions:
    """Return the definitions for `$DELTASAFE_HOME` and `$DELTASAFE_PRESET`."""
    return build_defs()
