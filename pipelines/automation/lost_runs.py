"""Runs whose process is gone, and processes whose run has ended. Dagster's default launcher looks after neither."""

import time
from typing import TYPE_CHECKING

import dagster as dg

from deltasafe.compute.processes import descendants, is_running, kill_with_descendants
from pipelines.run_owner import runs_here
from pipelines.supervision import process_of, step_processes

if TYPE_CHECKING:
    from dagster._core.storage.dagster_run import DagsterRun

__all__ = ["end_leftover_processes", "fail_lost_runs"]

_STARTING = dg.DagsterRunStatus.STARTING
_UNFINISHED = [_STARTING, dg.DagsterRunStatus.STARTED, dg.DagsterRunStatus.CANCELING]
_ABORTED = [dg.DagsterRunStatus.FAILURE, dg.DagsterRunStatus.CANCELED]
_N_LATEST = 20
"""Ended runs that are checked for leftover processes, newest first."""
_SILENT_S = 100.0
"""A process that has not reported itself for so long is gone; should it come after all, Dagster ignores it."""
_silent_since_s: dict[str, float] = {}
"""When a run without a process was first found, on the monotonic clock: the wall clock may be set meanwhile."""


def fail_lost_runs(instance: dg.DagsterInstance) -> list[str]:
    """Mark runs as failed whose process on this machine has ended, and free the pool slots that they held.

    Only where runs are processes of this machine (the default launcher, and not those of other machines that share
    the database); elsewhere the launcher knows better.

    Returns:
        ids of the runs.
    """
    if not isinstance(instance.run_launcher, dg.DefaultRunLauncher):
        return []
    lost = []
    for run in filter(runs_here, instance.get_runs(dg.RunsFilter(statuses=_UNFINISHED))):
        process = process_of(instance, run.run_id)
        if is_running(*process) if process is not None else not _is_silent(run):
            continue
        again = instance.get_run_by_id(run.run_id)  # it may have ended in the meantime, as runs do
        if again is None or again.is_finished:
            continue
        _end(instance, again, "its process" if process is None else f"its process ({process.pid})")
        lost.append(run.run_id)
    return lost


def end_leftover_processes(instance: dg.DagsterInstance) -> list[str]:
    """Kill processes of failed and canceled runs on this machine whose steps still work.

    Dagster marks a run as canceled after two minutes although its process was never reached, and frees its pool slots.
    A process without steps is left alone: `make demo` goes on after its run.

    Returns:
        ids of the runs.
    """
    if not isinstance(instance.run_launcher, dg.DefaultRunLauncher):
        return []
    ended = []
    for run in filter(runs_here, instance.get_runs(dg.RunsFilter(statuses=_ABORTED), limit=_N_LATEST)):
        process = process_of(instance, run.run_id)
        if process is None or process.start is None or not is_running(*process):
            continue
        if step_processes(instance, run.run_id).intersection(descendants(process.pid)):
            kill_with_descendants(process.pid)
            instance.report_engine_event(f"The run had ended; its process {process.pid} was killed", run)
            ended.append(run.run_id)
    return ended


def _is_silent(run: "DagsterRun") -> bool:
    """Whether the process of a starting run ought to have reported itself by now."""
    now_s = time.monotonic()
    return run.status == _STARTING and now_s - _silent_since_s.setdefault(run.run_id, now_s) >= _SILENT_S


def _end(instance: dg.DagsterInstance, run: "DagsterRun", who: str) -> None:
    message = f"{who.capitalize()} is gone: it was killed, or the machine was restarted. Run it again; it goes on."
    if run.status == dg.DagsterRunStatus.CANCELING:
        instance.report_run_canceled(run, message)
    else:
        instance.report_run_failed(run, message)
    instance.event_log_storage.free_concurrency_slots_for_run(run.run_id)
