"""Fail runs whose process has ended, and kill processes whose run has ended.

Dagster's default launcher does neither.
"""

import os
import platform
import time
from typing import TYPE_CHECKING

import dagster as dg

from deltasafe.compute.processes import descendants, is_running, kill_with_descendants
from pipelines.home import DATABASE_VARIABLE
from pipelines.supervision import MACHINE_TAG, process_of, step_processes

if TYPE_CHECKING:
    from dagster._core.storage.dagster_run import DagsterRun

_STARTING = dg.DagsterRunStatus.STARTING
_UNFINISHED = [dg.DagsterRunStatus.NOT_STARTED, _STARTING, dg.DagsterRunStatus.STARTED, dg.DagsterRunStatus.CANCELING]
"""A run that is not started has no process yet, except those of commands, which are created with theirs."""
_ABORTED = [dg.DagsterRunStatus.FAILURE, dg.DagsterRunStatus.CANCELED]
_N_LATEST = 20
"""Number of the latest ended runs that are checked for leftover processes."""
_SILENT_S = 100.0
"""A starting run is lost if no event names its process for so long. Dagster ignores a process that starts later."""
_silent_since_s: dict[str, float] = {}
"""When a starting run without a process was first seen, on the monotonic clock: the wall clock may be adjusted."""


def fail_lost_runs(instance: dg.DagsterInstance) -> list[str]:
    """Mark runs of this machine as failed if their process has ended, free their pool slots, and return their ids.

    Other launchers than the default one (Kubernetes) monitor their runs themselves.
    """
    if not isinstance(instance.run_launcher, dg.DefaultRunLauncher):
        return []
    lost = []
    for run in filter(_is_ours, instance.get_runs(dg.RunsFilter(statuses=_UNFINISHED))):
        process = process_of(instance, run.run_id)
        if is_running(*process) if process is not None else not _is_silent(run):
            continue
        again = instance.get_run_by_id(run.run_id)  # it may have ended in the meantime
        if again is None or again.is_finished:
            continue
        _end(instance, again, "The process" if process is None else f"The process ({process.pid})")
        lost.append(run.run_id)
    return lost


def end_leftover_processes(instance: dg.DagsterInstance) -> list[str]:
    """Kill processes of failed and canceled runs of this machine that still run steps; return the ids of the runs.

    After two minutes, Dagster marks a run as canceled and frees its pool slots even if its process never reacted.
    A process without steps is left alone: that of `make demo` continues after its run.
    """
    if not isinstance(instance.run_launcher, dg.DefaultRunLauncher):
        return []
    ended = []
    for run in filter(_is_ours, instance.get_runs(dg.RunsFilter(statuses=_ABORTED), limit=_N_LATEST)):
        process = process_of(instance, run.run_id)
        if process is None or process.start is None or not is_running(*process):
            continue
        if step_processes(instance, run.run_id).intersection(descendants(process.pid)):
            kill_with_descendants(process.pid)
            instance.report_engine_event(f"The run had ended; its process {process.pid} was killed", run)
            ended.append(run.run_id)
    return ended


def _is_ours(run: "DagsterRun") -> bool:
    """Return whether the process of a run is, or was, on this machine.

    In a shared database, the tag decides. Dagster's start timeout ends a run that died before it was tagged.
    """
    return not os.environ.get(DATABASE_VARIABLE) or run.tags.get(MACHINE_TAG) == platform.node()


def _is_silent(run: "DagsterRun") -> bool:
    """Return whether a starting run has been without a process for too long."""
    now_s = time.monotonic()
    return run.status == _STARTING and now_s - _silent_since_s.setdefault(run.run_id, now_s) >= _SILENT_S


def _end(instance: dg.DagsterInstance, run: "DagsterRun", process: str) -> None:
    message = f"{process} of the run has ended: it was killed, or the machine restarted. Run it again to continue."
    if run.status == dg.DagsterRunStatus.CANCELING:
        instance.report_run_canceled(run, message)
    else:
        instance.report_run_failed(run, message)
    instance.event_log_storage.free_concurrency_slots_for_run(run.run_id)
