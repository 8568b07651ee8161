"""Cost of orchestration: the fraction of a run's time in which no step was working in the library."""

import dataclasses
import re
from collections.abc import Iterable

import dagster as dg

from deltasafe.errors import DataError
from pipelines.tracking.tracker import RECORDING_LOG_PREFIX

_RECORDING = re.compile(rf"{re.escape(RECORDING_LOG_PREFIX)} ([0-9.]+) s$")
_WORK_STARTS = (dg.DagsterEventType.STEP_START, dg.DagsterEventType.STEP_INPUT)

Interval = tuple[float, float]


@dataclasses.dataclass(frozen=True)
class RunTimes:
    """Times of a run, in seconds since the epoch.

    Attributes:
        run_s: from the creation of the run to its end.
        work_s: per step, from reading its inputs to returning its result, without the calls of MLflow.
        recording_s: duration of all calls of MLflow.
    """

    run_s: Interval
    work_s: tuple[Interval, ...]
    recording_s: float

    @property
    def share(self) -> float:
        """Return the fraction of the run outside all work: process starts, waiting, Dagster's events, MLflow."""
        return time_outside(self.run_s, self.work_s) / (self.run_s[1] - self.run_s[0])


def times_of_run(instance: dg.DagsterInstance, run_id: str) -> RunTimes:
    """Read the times of a finished run from its event log.

    Raises:
        DataError: there is no such run, or it has not ended.
    """
    record = instance.get_run_record_by_id(run_id)
    if record is None or record.end_time is None:
        raise DataError(f"run {run_id}", "is unknown or has not ended; name one that has")
    started: dict[str, float] = {}
    recordings: dict[str, list[Interval]] = {}
    work: list[Interval] = []
    for entry in instance.all_logs(run_id):
        step, event = entry.step_key, entry.dagster_event
        if step is None:
            continue
        if event is None:
            match = _RECORDING.search(entry.user_message)
            if match:
                recordings.setdefault(step, []).append((entry.timestamp - float(match.group(1)), entry.timestamp))
        elif event.event_type in _WORK_STARTS:
            started[step] = entry.timestamp
        elif event.event_type == dg.DagsterEventType.STEP_OUTPUT and step in started:
            work += _without((started.pop(step), entry.timestamp), recordings.get(step, []))
    recording_s = sum(end - begin for intervals in recordings.values() for begin, end in intervals)
    return RunTimes((record.create_timestamp.timestamp(), record.end_time), tuple(work), recording_s)


def time_outside(whole: Interval, intervals: Iterable[Interval]) -> float:
    """Return the seconds of ``whole`` that no interval covers; intervals may overlap."""
    outside_s, until = 0.0, whole[0]
    for begin, end in sorted(intervals):
        outside_s += max(0.0, min(begin, whole[1]) - until)
        until = max(until, min(end, whole[1]))
    return outside_s + whole[1] - until


def _without(interval: Interval, removed: Iterable[Interval]) -> list[Interval]:
    pieces = [interval]
    for begin, end in removed:
        halves = [half for a, b in pieces for half in ((a, min(b, begin)), (max(a, end), b))]
        pieces = [(a, b) for a, b in halves if a < b]
    return pieces
