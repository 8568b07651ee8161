"""What `dagster`, `dg` and `workspace.yaml` load."""

import dagster as dg

from pipelines.home import set_quiet_environment

set_quiet_environment()


@dg.definitions
def defs() -> dg.Definitions:
    """The definitions for `$DELTASAFE_HOME` and the preset of `$DELTASAFE_PRESET`."""
    from pipelines.build import build_defs

    return build_defs()
