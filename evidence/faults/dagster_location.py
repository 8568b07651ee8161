"""A code location of quick steps for `dagster_kills`, with the project's executor settings, I/O manager and sensor.

A file in ``requests/`` below the home requests a run; its name becomes the run's tag ``request``. A file in
``without/`` switches off a protection: ``parent_watchdog`` or ``lost_runs``.
"""

import os
import pathlib
import time

import dagster as dg

from deltasafe.io.storage import atomic_folder
from pipelines.automation.lost_runs import end_leftover_processes, fail_lost_runs
from pipelines.storage.io_manager import FolderPointers
from pipelines.supervision import supervised

HOME = pathlib.Path(os.environ["DELTASAFE_HOME"])
STEP_S, LONG_STEP_S = 1.5, 20.0


class _Pointers(FolderPointers):
    def setup_for_execution(self, context: dg.InitResourceContext) -> None:
        if not _is_off("parent_watchdog"):
            super().setup_for_execution(context)


def _is_off(name: str) -> bool:
    return (HOME / "without" / name).exists()


def _write(name: str, run_id: str, seconds: float = STEP_S) -> pathlib.Path:
    folder = HOME / "store" / name / run_id
    with atomic_folder(folder) as temporary:
        for part in range(10):
            (temporary / f"{part}").write_text(run_id, encoding="utf-8")
            time.sleep(seconds / 10)
    return folder


def _verify(folder: pathlib.Path) -> None:
    if {path.read_text(encoding="utf-8") for path in folder.iterdir()} != {folder.name}:
        raise ValueError(f"{folder} is torn")


@dg.asset
def first(context: dg.AssetExecutionContext) -> pathlib.Path:
    """Write a folder."""
    return _write("first", context.run_id)


@dg.asset
def second(context: dg.AssetExecutionContext, first: pathlib.Path) -> pathlib.Path:
    """Verify the folder of `first` and write another."""
    _verify(first)
    return _write("second", context.run_id)


@dg.asset
def beside(context: dg.AssetExecutionContext, first: pathlib.Path) -> pathlib.Path:
    """Run at the same time as `second`, for so long that it would outlive a run that was killed."""
    _verify(first)
    return _write("beside", context.run_id, LONG_STEP_S)


steps = dg.define_asset_job("steps", dg.AssetSelection.all())


@dg.sensor(job=steps, minimum_interval_seconds=1, default_status=dg.DefaultSensorStatus.RUNNING)
def requests(context: dg.SensorEvaluationContext) -> dg.SensorResult:
    """Launch one run per request."""
    names = sorted(path.name for path in (HOME / "requests").iterdir())
    new = [name for name in names if name > (context.cursor or "")]
    runs = [dg.RunRequest(run_key=name, tags={"request": name}) for name in new]
    return dg.SensorResult(runs, cursor=names[-1] if names else "")


@dg.sensor(job=steps, minimum_interval_seconds=10, default_status=dg.DefaultSensorStatus.RUNNING)
def lost_runs(context: dg.SensorEvaluationContext) -> dg.SkipReason:
    """Fail lost runs as the project's sensor does, at a shorter interval."""
    if _is_off("lost_runs"):
        return dg.SkipReason("switched off")
    killed = end_leftover_processes(context.instance)
    return dg.SkipReason(f"marked as failed: {fail_lost_runs(context.instance)}; processes killed: {killed}")


defs = dg.Definitions(
    assets=[first, second, beside],
    jobs=[steps],
    sensors=[requests, lost_runs],
    resources={"io_manager": _Pointers(home=str(HOME))},
    executor=supervised(
        dg.multiprocess_executor.configured(
            {
                "max_concurrent": 2,
                "start_method": {"forkserver": {"preload_modules": ["evidence.faults.dagster_location"]}},
            }
        )
    ),
)
