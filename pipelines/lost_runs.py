"""Runs whose process is gone. The default launcher does not look after its runs, so a killed one stays STARTED."""

import os
import pathlib
import time
from typing import TYPE_CHECKING

import dagster as dg

if TYPE_CHECKING:
    from dagster._core.storage.dagster_run import DagsterRun

__all__ = ["fail_lost_runs", "is_alive"]

_UNFINISHED = [dg.DagsterRunStatus.STARTED, dg.DagsterRunStatus.CANCELING]


def fail_lost_runs(instance: dg.DagsterInstance) -> list[str]:
    """Mark runs as failed whose process on this machine has ended, and give back the pool slots that they held.

    Only where runs are processes of this machine (the default launcher); elsewhere the launcher knows better.

    Returns:
        ids of the runs.
    """
    if not isinstance(instance.run_launcher, dg.DefaultRunLauncher):
        return []
    lost = []
    for run in instance.get_runs(dg.RunsFilter(statuses=_UNFINISHED)):
        process = _process_of(instance, run.run_id)
        if process is None or is_alive(*process):
            continue
        again = instance.get_run_by_id(run.run_id)  # it may have ended in the meantime, as runs do
        if again is None or again.is_finished:
            continue
        _end(instance, again, process[0])
        lost.append(run.run_id)
    return lost


def is_alive(pid: int, known_at_s: float) -> bool:
    """Whether the process that had the number ``pid`` at that time (seconds since the epoch) still runs.

    A process that began later only bears its number.
    """
    stat = pathlib.Path("/proc", str(pid), "stat")
    if not pathlib.Path("/proc/self/stat").is_file():
        try:
            os.kill(pid, 0)
        except OSError:
            return False
        return True
    try:
        fields = stat.read_text(encoding="utf-8").rpartition(")")[2].split()
    except OSError:
        return False
    began_s = time.time() - _up_s() + int(fields[19]) / os.sysconf("SC_CLK_TCK")
    return fields[0] not in ("Z", "X") and began_s <= known_at_s + 5.0


def _process_of(instance: dg.DagsterInstance, run_id: str) -> tuple[int, float] | None:
    """Number of the run's process and when it reported; None if it has not reported yet."""
    for entry in reversed(instance.all_logs(run_id, of_type=dg.DagsterEventType.ENGINE_EVENT)):
        event = entry.dagster_event
        if event is not None and event.step_key is None:
            pid = event.engine_event_data.metadata.get("pid")
            if pid is not None:
                return int(str(pid.value)), entry.timestamp
    return None


def _end(instance: dg.DagsterInstance, run: "DagsterRun", pid: int) -> None:
    message = f"Its process ({pid}) is gone: it was killed, or the machine was restarted. Run it again; it goes on."
    if run.status == dg.DagsterRunStatus.CANCELING:
        instance.report_run_canceled(run, message)
    else:
        instance.report_run_failed(run, message)
    instance.event_log_storage.free_concurrency_slots_for_run(run.run_id)


def _up_s() -> float:
    return float(pathlib.Path("/proc/uptime").read_text(encoding="utf-8").split()[0])
