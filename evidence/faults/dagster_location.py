"""A code location of quick steps, to be killed: executor, I/O manager and clean-up are the project's own.

A file in ``requests/`` below the home asks for a run; its name becomes the run's tag ``request``. Files in ``without/``
switch off what is to be shown to be needed: ``lifeline``, ``lost_runs``.
"""

import os
import pathlib
import time

import dagster as dg

from deltasafe.storage import atomic_folder
from pipelines.io import FolderPointers
from pipelines.lost_runs import fail_lost_runs

__all__ = ["defs"]

HOME = pathlib.Path(os.environ["DELTASAFE_HOME"])
STEP_S, LONG_STEP_S = 1.5, 20.0


class _Pointers(FolderPointers):
    def setup_for_execution(self, context: dg.InitResourceContext) -> None:
        if not _is_off("lifeline"):
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


def _sound(folder: pathlib.Path) -> None:
    if {path.read_text(encoding="utf-8") for path in folder.iterdir()} != {folder.name}:
        raise ValueError(f"{folder} is torn")


@dg.asset
def first(context: dg.AssetExecutionContext) -> pathlib.Path:
    """One step."""
    return _write("first", context.run_id)


@dg.asset
def second(context: dg.AssetExecutionContext, first: pathlib.Path) -> pathlib.Path:
    """Another, that reads what the first wrote."""
    _sound(first)
    return _write("second", context.run_id)


@dg.asset
def beside(context: dg.AssetExecutionContext, first: pathlib.Path) -> pathlib.Path:
    """A third, at the same time as the second; it would still be at work when its run has ended without it."""
    _sound(first)
    return _write("beside", context.run_id, LONG_STEP_S)


steps = dg.define_asset_job("steps", dg.AssetSelection.all())


@dg.sensor(job=steps, minimum_interval_seconds=1, default_status=dg.DefaultSensorStatus.RUNNING)
def requests(context: dg.SensorEvaluationContext) -> dg.SensorResult:
    """A run for every request, once."""
    names = sorted(path.name for path in (HOME / "requests").iterdir())
    new = [name for name in names if name > (context.cursor or "")]
    made = [dg.RunRequest(run_key=name, tags={"request": name}) for name in new]
    return dg.SensorResult(made, cursor=names[-1] if names else "")


@dg.sensor(job=steps, minimum_interval_seconds=10, default_status=dg.DefaultSensorStatus.RUNNING)
def lost_runs(context: dg.SensorEvaluationContext) -> dg.SkipReason:
    """As in the project, a little more often."""
    if _is_off("lost_runs"):
        return dg.SkipReason("switched off")
    return dg.SkipReason(f"marked as failed: {fail_lost_runs(context.instance)}")


defs = dg.Definitions(
    assets=[first, second, beside],
    jobs=[steps],
    sensors=[requests, lost_runs],
    resources={"io_manager": _Pointers(home=str(HOME))},
    executor=dg.multiprocess_executor.configured(
        {"max_concurrent": 2, "start_method": {"forkserver": {"preload_modules": ["evidence.faults.dagster_location"]}}}
    ),
)
