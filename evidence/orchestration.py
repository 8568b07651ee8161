"""What orchestration costs: the share of a run in which none of its steps was at work in the library."""

import dataclasses
import re
from collections.abc import Iterable

import dagster as dg

from deltasafe.errors import DataError
from pipelines.tracking import RECORDED

__all__ = ["RunTimes", "outside_of", "times_of_run"]

_BUSY = re.compile(rf"{re.escape(RECORDED)} ([0-9.]+) s$")
_READY = (dg.DagsterEventType.STEP_START, dg.DagsterEventType.STEP_INPUT)

Interval = tuple[float, float]


@dataclasses.dataclass(frozen=True)
class RunTimes:
    """When a run and its steps worked, in seconds since the epoch.

    Attributes:
        whole: from the creation of the run to its end.
        work: of every step, from its inputs being read to its result being handed over, less what MLflow took.
        recording_s: what MLflow took, of all steps together.
    """

    whole: Interval
    work: tuple[Interval, ...]
    recording_s: float

    @property
    def share(self) -> float:
        """Share of the whole outside all work: processes that start, waiting, Dagster's events, the recording."""
        return outside_of(self.whole, self.work) / (self.whole[1] - self.whole[0])


def times_of_run(instance: dg.DagsterInstance, run_id: str) -> RunTimes:
    """Read the times of a run that has ended from its event log.

    Raises:
        DataError: there is no such run, or it goes on.
    """
    record = instance.get_run_record_by_id(run_id)
    if record is None or record.end_time is None:
        raise DataError(f"run {run_id}", "is not known or has not ended; name one that has")
    ready: dict[str, float] = {}
    recorded: dict[str, list[Interval]] = {}
    work: list[Interval] = []
    for entry in instance.all_logs(run_id):
        step, event = entry.step_key, entry.dagster_event
        if step is None:
            continue
        if event is None:
            match = _BUSY.search(entry.user_message)
            if match:
                recorded.setdefault(step, []).append((entry.timestamp - float(match.group(1)), entry.timestamp))
        elif event.event_type in _READY:
            ready[step] = entry.timestamp
        elif event.event_type == dg.DagsterEventType.STEP_OUTPUT and step in ready:
            work += _without((ready.pop(step), entry.timestamp), recorded.get(step, []))
    recording_s = sum(ended - began for each in recorded.values() for began, ended in each)
    return RunTimes((record.create_timestamp.timestamp(), record.end_time), tuple(work), recording_s)


def outside_of(whole: Interval, work: Iterable[Interval]) -> float:
    """Seconds of ``whole`` that lie in no interval of ``work``, which may overlap."""
    outside_s, until = 0.0, whole[0]
    for began, ended in sorted(work):
        outside_s += max(0.0, min(began, whole[1]) - until)
        until = max(until, min(ended, whole[1]))
    return outside_s + whole[1] - until


def _without(interval: Interval, removed: Iterable[Interval]) -> list[Interval]:
    pieces = [interval]
    for began, ended in removed:
        halves = [half for a, b in pieces for half in ((a, min(b, began)), (max(a, ended), b))]
        pieces = [(a, b) for a, b in halves if a < b]
    return pieces
