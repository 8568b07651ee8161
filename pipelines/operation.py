"""Jobs that operate a home from the UI: disk use and retention, promotion, rollback, and the alert on failed runs."""

import dataclasses
import os
import shlex
import subprocess
from typing import Any

import dagster as dg

from deltasafe.errors import DeltasafeError, SettingsError
from pipelines.home import home, run_page
from pipelines.jobs import is_unattended
from pipelines.retention import Retention, RetentionSettings
from pipelines.tracking.reconciliation import reconcile
from pipelines.tracking.registry import EnsembleRegistry

ALERT_VARIABLE = "DELTASAFE_ALERT_COMMAND"
_ALERT_TIMEOUT_S = 30.0


class DiskSpaceConfig(dg.Config):
    """Without `delete`, the asset only shows what may be deleted. `keep_...` of -1: the environment decides.

    Everything that is younger than `keep_days` is kept, and the newest runs and registered versions.
    """

    delete: bool = False
    keep_runs: int = -1
    keep_days: float = -1.0
    keep_versions: int = -1


@dg.asset(group_name="operation", owners=["team:operation"], kinds={"disk"}, code_version="1", pool="registry")
def disk_space(context: dg.AssetExecutionContext, config: DiskSpaceConfig) -> dg.MaterializeResult:
    """Disk use of the home by part, and what may be deleted: old runs and all that only they refer to.

    With the setting `delete`, it is deleted. `make prune` does the same from the command line.
    """
    given = {"runs": config.keep_runs, "days": config.keep_days, "versions": config.keep_versions}
    chosen: dict[str, Any] = {name: value for name, value in given.items() if value >= 0}
    try:
        settings = dataclasses.replace(RetentionSettings.from_environment(), **chosen)
        retention = Retention(home(), context.instance, settings)
        found = retention.survey()
    except DeltasafeError as error:
        raise dg.Failure(str(error), allow_retries=False) from error
    rows = retention.disk_use(found)
    if config.delete:
        retention.prune(found)
    names = "\n".join(f"- {each.part}: {each.name} ({each.n_bytes / 1e6:.1f} MB)" for each in found)
    return dg.MaterializeResult(
        metadata={
            "disk use": dg.MetadataValue.table([dg.TableRecord(row) for row in rows]),
            "total [MB]": rows[-1]["MB"],
            "deletable [MB]": rows[-1]["deletable MB"],
            "deleted" if config.delete else "deletable": dg.MetadataValue.md(names or "nothing"),
        }
    )


housekeeping = dg.define_asset_job(
    "housekeeping",
    dg.AssetSelection.assets("disk_space"),
    description="Shows the disk use of the home, and deletes what is old if the setting `delete` is true.",
)


@dg.schedule(
    job=housekeeping,
    cron_schedule="0 4 * * *",
    execution_timezone="UTC",
    default_status=dg.DefaultScheduleStatus("RUNNING" if is_unattended() else "STOPPED"),
    description="Deletes daily at 4:00 UTC what no setting keeps ($DELTASAFE_KEEP_RUNS, _DAYS, _VERSIONS).",
)
def nightly(context: dg.ScheduleEvaluationContext) -> dg.RunRequest:
    config = {"ops": {"disk_space": {"config": {"delete": True}}}}
    return dg.RunRequest(run_key=context.scheduled_execution_time.isoformat(), run_config=config)


class PromoteConfig(dg.Config):
    """`version` is a number in the list of versions in MLflow; `because`, a reason, is stored with it."""

    version: int = 0
    because: str = ""


class RollbackConfig(dg.Config):
    """`because`, a reason, is stored with both versions."""

    because: str = ""


@dg.op(pool="registry")
def use_version(
    context: dg.OpExecutionContext, config: PromoteConfig, registry: dg.ResourceParam[EnsembleRegistry]
) -> None:
    """Use a registered version, and report it to Dagster."""
    try:
        registry.promote(str(config.version), _reason(config.because))
    except DeltasafeError as error:
        raise dg.Failure(str(error), allow_retries=False) from error
    _follow(context, registry)


@dg.op(pool="registry")
def use_previous_version(
    context: dg.OpExecutionContext, config: RollbackConfig, registry: dg.ResourceParam[EnsembleRegistry]
) -> None:
    """Use the previous version again, take the present one out of use, and report it to Dagster."""
    try:
        registry.rollback(_reason(config.because))
    except DeltasafeError as error:
        raise dg.Failure(str(error), allow_retries=False) from error
    _follow(context, registry)


def _reason(because: str) -> str:
    """Return the reason. It has a default only so that the launchpad shows the field.

    Raises:
        SettingsError: it is empty.
    """
    if not because.strip():
        raise SettingsError("because is empty: give a reason")
    return because


def _follow(context: dg.OpExecutionContext, registry: EnsembleRegistry) -> None:
    for difference in reconcile(registry, context.instance):
        context.log.info(difference)


@dg.job(description="Uses a registered version of the ensemble, as decided by you.")
def promote() -> None:
    use_version()


@dg.job(description="Uses the previous ensemble again, and takes the present one out of use.")
def rollback() -> None:
    use_previous_version()


@dg.run_failure_sensor(
    default_status=dg.DefaultSensorStatus.RUNNING if os.environ.get(ALERT_VARIABLE) else dg.DefaultSensorStatus.STOPPED,
    description=f"Runs the command ${ALERT_VARIABLE} for every failed run. Its environment has DELTASAFE_RUN (the "
    "page), DELTASAFE_JOB and DELTASAFE_ERROR.",
)
def failed_runs(context: dg.RunFailureSensorContext) -> dg.SkipReason:
    run, command = context.dagster_run, os.environ.get(ALERT_VARIABLE)
    if not command:
        return dg.SkipReason(f"${ALERT_VARIABLE} is not set")
    about = {"RUN": run_page(run.run_id), "JOB": run.job_name, "ERROR": context.failure_event.message or ""}
    environment = {**os.environ, **{f"DELTASAFE_{name}": value for name, value in about.items()}}
    done = subprocess.run(shlex.split(command), env=environment, timeout=_ALERT_TIMEOUT_S, check=False)
    return dg.SkipReason(f"the alert for run {run.run_id} ended with status {done.returncode}")
