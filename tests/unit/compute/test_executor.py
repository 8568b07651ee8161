"""The local executor: everything done once, errors that lose nothing, and workers that are killed at work."""

import contextlib
import os
import pathlib
import signal
import time

import numpy as np
import pytest

from deltasafe.compute.executor import LOCAL, RETRIES, Needs, Task
from deltasafe.errors import DataError, SettingsError, WorkerLostError
from deltasafe.studies.resumable_jobs import run_batches


def double(value):
    return 2 * value, os.getpid()


def speak(tell, name, times):
    for number in range(times):
        tell((name, number))
    return os.getpid()


def leave(mark):
    pathlib.Path(mark).touch()
    raise DataError("some/file", "is wrong")


def wait_for(mark):
    while not pathlib.Path(mark).exists():
        time.sleep(0.01)
    return mark


def die(marks, name, times):
    """Is killed ``times`` times, then works; a mark for every try."""
    mark = pathlib.Path(marks, name)
    tries = len(mark.read_text()) if mark.is_file() else 0
    mark.write_text("x" * (tries + 1))
    if tries < times:
        os.kill(os.getpid(), signal.SIGKILL)
    return {"value": np.array(len(name))}


def results(tasks, workers, needs=None, hear=None):
    with contextlib.closing(LOCAL.run(tasks, workers, needs or Needs(), hear)) as finished:
        return dict(finished)


@pytest.mark.parametrize(("workers", "needs", "here"), [(1, Needs(), True), (2, Needs(), False)])
def test_every_task_is_done_once_and_known_by_its_position(workers, needs, here):
    found = results([Task(f"double {n}", double, (n,)) for n in range(5)], workers, needs)
    assert {index: value for index, (value, _) in found.items()} == {n: 2 * n for n in range(5)}
    assert ({pid for _, pid in found.values()} == {os.getpid()}) == here


def test_what_wants_a_process_of_its_own_gets_one():
    ((_, pid),) = results([Task("alone", double, (1,))], 1, Needs(apart=True)).values()
    assert pid != os.getpid()


@pytest.mark.parametrize("needs", [Needs(), Needs(apart=True)], ids=["here", "apart"])
@pytest.mark.parametrize("workers", [1, 2])
def test_all_reports_are_heard_before_the_end(workers, needs):
    heard = []
    results([Task(name, speak, (name, 3)) for name in "ab"], workers, needs, heard.append)
    assert sorted(heard) == [(name, number) for name in "ab" for number in range(3)]
    assert [number for name, number in heard if name == "b"] == [0, 1, 2]


def test_an_error_keeps_its_kind_and_what_was_underway_is_handed_over(tmp_path):
    mark, handed = str(tmp_path / "mark"), []
    with pytest.raises(DataError, match="some/file: is wrong"):
        handed.extend(LOCAL.run([Task("", wait_for, (mark,)), Task("", leave, (mark,))], 2))
    assert handed == [(0, mark)]
    with pytest.raises(DataError):
        handed.extend(LOCAL.run([Task("", leave, (mark,)), Task("", wait_for, (mark,))], 1, Needs(apart=True)))
    assert handed == [(0, mark)], "nothing is begun after an error"


def test_a_killed_worker_costs_its_own_batch_alone(tmp_path):
    tries, told = tmp_path / "tries", []
    tries.mkdir()
    jobs = [(name, (str(tries), name, RETRIES if name == "ccc" else 0)) for name in ("a", "bb", "ccc", "dddd")]
    batches, _ = run_batches(die, jobs, tmp_path / "batches", 2, lambda *report: told.append(report))
    assert [int(batch["value"]) for batch in batches] == [1, 2, 3, 4]
    assert {mark.name: len(mark.read_text()) for mark in tries.iterdir()} == {"a": 1, "bb": 1, "ccc": 3, "dddd": 1}
    assert [done for done, _, _ in told] == [0, 1, 2, 3, 4]


def test_a_batch_that_kills_every_worker_is_named_and_the_others_are_kept(tmp_path):
    tries = tmp_path / "tries"
    tries.mkdir()
    jobs = [(name, (str(tries), name, 99 if name == "bad" else 0)) for name in ("bad", "fine")]
    with pytest.raises(WorkerLostError, match="bad: the process"):
        run_batches(die, jobs, tmp_path / "batches", 2)
    assert (tries / "bad").read_text() == "x" * (RETRIES + 1)
    assert [file.name.split("-")[0] for file in (tmp_path / "batches").iterdir()] == ["fine"]


def test_a_listener_that_stops_leaves_no_process_behind():
    finished = LOCAL.run([Task("", double, (n,)) for n in range(4)], 2)
    _, (_, pid) = next(finished)
    os.kill(pid, 0)
    finished.close()
    with pytest.raises(ProcessLookupError):
        os.kill(pid, 0)


def test_rounds_share_the_cores(monkeypatch):
    monkeypatch.setattr(os, "cpu_count", lambda: 4)
    assert LOCAL.rounds(5, 4) == [(4, 1), (1, 4)]
    assert LOCAL.rounds(2, 1) == [(1, 4), (1, 4)]
    assert LOCAL.rounds(0, 2) == []
    with pytest.raises(SettingsError, match="workers"):
        list(LOCAL.run([], 0))


class Backwards:
    """Another executor: here, but the last task first."""

    def rounds(self, n_tasks, workers):
        return [(n_tasks, 1)]

    def width(self, workers):
        return 5

    def run(self, tasks, workers, needs=None, hear=None):
        for index, task in reversed(list(enumerate(tasks))):
            yield index, task.work(*task.arguments)


def test_batches_are_those_of_their_jobs_in_whichever_order_they_come_back(tmp_path):
    tries, told = tmp_path / "tries", []
    tries.mkdir()
    jobs = [(name, (str(tries), name, 0)) for name in ("a", "bb", "ccc")]
    folder = tmp_path / "batches"
    batches, _ = run_batches(die, jobs, folder, progress=lambda *report: told.append(report), executor=Backwards())
    assert [int(batch["value"]) for batch in batches] == [1, 2, 3]
    assert [message.split(";")[0] for _, _, message in told[1:]] == ["ccc", "bb", "a"]
    again, effort = run_batches(die, jobs, folder, executor=Backwards())
    assert [int(batch["value"]) for batch in again] == [1, 2, 3]
    assert effort.minutes == pytest.approx(sum(float(batch["wall_s"]) for batch in again) / 60 / 5)
