"""Runs whose process is gone. The default launcher does not look after its runs, so a killed one stays STARTED."""

import os
import pathlib
import time
from typing import TYPE_CHECKING

import dagster as dg

from deltasafe.compute.processes import start_ticks
from pipelines.run_owner import runs_here

if TYPE_CHECKING:
    from dagster._core.storage.dagster_run import DagsterRun

__all__ = ["fail_lost_runs", "is_alive", "process_of"]

_STARTING = dg.DagsterRunStatus.STARTING
_UNFINISHED = [_STARTING, dg.DagsterRunStatus.STARTED, dg.DagsterRunStatus.CANCELING]
_SILENT_S = 100.0
"""A process that has not reported itself for so long is gone; should it come after all, Dagster ignores it."""


def fail_lost_runs(instance: dg.DagsterInstance) -> list[str]:
    """Mark runs as failed whose process on this machine has ended, and give back the pool slots that they held.

    Only where runs are processes of this machine (the default launcher, and not those of other machines that share
    the database); elsewhere the launcher knows better.

    Returns:
        ids of the runs.
    """
    if not isinstance(instance.run_launcher, dg.DefaultRunLauncher):
        return []
    lost = []
    for record in instance.get_run_records(dg.RunsFilter(statuses=_UNFINISHED)):
        if not runs_here(record.dagster_run):
            continue
        run, process = record.dagster_run, process_of(instance, record.dagster_run.run_id)
        if process is None:
            if run.status != _STARTING or time.time() - record.update_timestamp.timestamp() < _SILENT_S:
                continue
        elif is_alive(*process):
            continue
        again = instance.get_run_by_id(run.run_id)  # it may have ended in the meantime, as runs do
        if again is None or again.is_finished:
            continue
        _end(instance, again, "its process" if process is None else f"its process ({process[0]})")
        lost.append(run.run_id)
    return lost


def is_alive(pid: int, known_at_s: float) -> bool:
    """Whether the process that had the number ``pid`` at that time (seconds since the epoch) still runs.

    A process that began later only bears its number.
    """
    try:
        start = start_ticks(pid)
        if start is None:
            os.kill(pid, 0)
            return True
    except OSError:
        return False
    return time.time() - _up_s() + start / os.sysconf("SC_CLK_TCK") <= known_at_s + 5.0


def process_of(instance: dg.DagsterInstance, run_id: str) -> tuple[int, float] | None:
    """Number of the run's process and when it reported; None if it has not reported yet."""
    for entry in reversed(instance.all_logs(run_id, of_type=dg.DagsterEventType.ENGINE_EVENT)):
        event = entry.dagster_event
        if event is not None and event.step_key is None:
            pid = event.engine_event_data.metadata.get("pid")
            if pid is not None:
                return int(str(pid.value)), entry.timestamp
    return None


def _end(instance: dg.DagsterInstance, run: "DagsterRun", who: str) -> None:
    message = f"{who.capitalize()} is gone: it was killed, or the machine was restarted. Run it again; it goes on."
    if run.status == dg.DagsterRunStatus.CANCELING:
        instance.report_run_canceled(run, message)
    else:
        instance.report_run_failed(run, message)
    instance.event_log_storage.free_concurrency_slots_for_run(run.run_id)


def _up_s() -> float:
    return float(pathlib.Path("/proc/uptime").read_text(encoding="utf-8").split()[0])
