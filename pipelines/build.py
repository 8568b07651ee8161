"""The one door: everything that Dagster needs to know, built for a home."""

import pathlib
from collections.abc import Mapping
from typing import Any

import dagster as dg

import assets.checks
import assets.motion
import assets.perception
import assets.perception_study
import assets.planner_study
import assets.safety_study
import assets.single_scene
import assets.tracking_study
from pipelines import jobs
from pipelines.automation.sensors import all_sensors
from pipelines.commands.console import progress_console
from pipelines.executors import ExecutorResource, steps_on_ray
from pipelines.home import DATASETS, home
from pipelines.resources import RegistryResource, StoreResource, TrackerResource
from pipelines.storage.io_manager import FolderPointers
from pipelines.supervision import supervised

__all__ = ["build_defs"]

# heavy libraries are imported once, in the server that the steps are forked from
_PRELOADED = ["pipelines.build", "torch"]


def build_defs(
    root: pathlib.Path | None = None, overrides: Mapping[str, Any] | None = None, max_concurrent: int = 2
) -> dg.Definitions:
    """All definitions, with resources for the home ``root``.

    Args:
        root: `$DELTASAFE_HOME` unless given.
        overrides: resources by key that replace the usual ones (tests pass a tracker in memory).
        max_concurrent: steps that run side by side.

    Raises:
        SettingsError: the environment asks for an executor that there is not.
    """
    root = root or home()
    resources: dict[str, Any] = {
        "io_manager": FolderPointers(home=str(root)),
        "store": StoreResource(home=str(root), datasets=str(DATASETS)),
        "tracker": TrackerResource(home=str(root)),
        "registry": RegistryResource(home=str(root)),
        "executor": ExecutorResource.chosen(),
    }
    executor = steps_on_ray() or dg.multiprocess_executor.configured(
        {"max_concurrent": max_concurrent, "start_method": {"forkserver": {"preload_modules": _PRELOADED}}}
    )
    return dg.Definitions(
        assets=dg.load_assets_from_modules(
            [
                assets.perception,
                assets.motion,
                assets.single_scene,
                assets.perception_study,
                assets.planner_study,
                assets.safety_study,
                assets.tracking_study,
            ]
        ),
        asset_checks=dg.load_asset_checks_from_modules([assets.checks, assets.single_scene, assets.tracking_study]),
        jobs=[
            jobs.everything,
            jobs.perception,
            jobs.planning,
            jobs.single_scene,
            jobs.perception_study,
            jobs.planner_study,
            jobs.safety_study,
            jobs.tracking_study,
        ],
        schedules=[jobs.retraining],
        sensors=all_sensors(root),
        resources={**resources, **(overrides or {})},
        executor=supervised(executor),
        loggers={"console": progress_console},
    )
