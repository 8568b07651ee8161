"""Build Dagster's definitions for a home."""

import functools
import pathlib

import dagster as dg

import assets.checks
import assets.motion
import assets.perception
import assets.perception_study
import assets.planner_study
import assets.safety_study
import assets.single_scene
import assets.staleness
import assets.tracking_study
from assets.interfaces import Store
from pipelines import jobs, operation
from pipelines.automation.launch_check import launch_error
from pipelines.automation.sensors import all_sensors
from pipelines.commands.console import progress_console
from pipelines.executors import ExecutorResource, ray_step_executor
from pipelines.home import DATASETS, home
from pipelines.resources import RegistryResource, StoreResource, TrackerResource
from pipelines.storage.io_manager import FolderPointers
from pipelines.supervision import supervised

# imported once, by the server process that forks the steps
_PRELOADED = ["pipelines.build", "torch"]


def build_defs(root: pathlib.Path | None = None) -> dg.Definitions:
    """Build all definitions, with resources for the home ``root`` (by default `$DELTASAFE_HOME`).

    Raises:
        SettingsError: an environment variable is invalid, or its executor is not installed.
    """
    root = root or home()
    executor = ray_step_executor() or dg.multiprocess_executor.configured(
        {"max_concurrent": 2, "start_method": {"forkserver": {"preload_modules": _PRELOADED}}}
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
                operation,
            ]
        ),
        asset_checks=[
            *dg.load_asset_checks_from_modules([assets.checks, assets.single_scene, assets.tracking_study]),
            *assets.staleness.CHECKS,
        ],
        jobs=[
            jobs.everything,
            jobs.perception,
            jobs.planning,
            jobs.single_scene,
            jobs.perception_study,
            jobs.planner_study,
            jobs.safety_study,
            jobs.tracking_study,
            operation.housekeeping,
            operation.promote,
            operation.rollback,
        ],
        schedules=[jobs.retraining, operation.nightly],
        sensors=[*all_sensors(root), operation.failed_runs],
        resources={
            "io_manager": FolderPointers(home=str(root)),
            "store": StoreResource(home=str(root), datasets=str(DATASETS)),
            "tracker": TrackerResource(home=str(root)),
            "registry": RegistryResource(home=str(root)),
            "executor": ExecutorResource.from_environment(),
        },
        executor=supervised(executor, functools.partial(launch_error, store=Store(root, DATASETS))),
        loggers={"console": progress_console},
    )
