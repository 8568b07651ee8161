"""The local executor: everything done once, errors that lose nothing, and workers that are killed at work."""

import contextlib
import os
import pathlib
import signal
import subprocess
import sys
import time

import numpy as np
import pytest

from deltasafe.compute.executor import LOCAL, RETRIES, Needs, Task, in_order
from deltasafe.compute.processes import is_running
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


class Unreadable(Exception):
    def __init__(self, one, two):
        super().__init__(f"{one} {two}")


def raise_unreadable():
    raise Unreadable("can be pickled,", "not unpickled")


def give_unpicklable():
    return lambda: None


def say_much(tell):
    for _ in range(3000):
        tell("x" * 1000)


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


@pytest.mark.parametrize(
    ("work", "message"), [(raise_unreadable, "Unreadable: can be pickled, not"), (give_unpicklable, "lambda|local")]
)
def test_what_cannot_be_sent_is_an_error_and_no_hang(work, message):
    with pytest.raises(Exception, match=message):
        results([Task("", work)], 1, Needs(apart=True))


def test_an_error_shows_where_it_came_from(tmp_path):
    with pytest.raises(DataError) as raised:
        results([Task("", leave, (str(tmp_path / "mark"),))], 1, Needs(apart=True))
    assert "in leave" in str(raised.value.__cause__)


def test_more_reports_than_a_pipe_holds_are_all_received():
    heard = []
    results([Task("", say_much)] * 2, 2, hear=heard.append)
    assert len(heard) == 6000


def test_an_error_in_the_callback_ends_the_workers(tmp_path):
    def fail(_):
        raise OSError("the log is full")

    with pytest.raises(OSError, match="the log is full"):
        results([Task("", say_much)] * 2, 2, hear=fail)


def test_results_in_order():
    assert list(in_order([(2, "c"), (0, "a"), (1, "b"), (3, "d")])) == ["a", "b", "c", "d"]


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


def sleep(folder, is_deaf):
    if is_deaf:
        signal.signal(signal.SIGTERM, signal.SIG_IGN)
    pathlib.Path(folder, f"{os.getpid()}").touch()
    time.sleep(3600)


PROGRAM = """
import contextlib, signal, sys
from deltasafe.compute.executor import LOCAL, Needs, Task
from tests.unit.compute.test_executor import sleep

if __name__ == "__main__":
    signal.signal(signal.SIGINT, signal.default_int_handler)  # ignored if the tests run in the background
    if sys.argv[3] == "handled":
        signal.signal(signal.SIGTERM, signal.getsignal(signal.SIGINT))  # as Dagster does
    tasks = [Task(f"{n}", sleep, (sys.argv[1], sys.argv[2] == "deaf")) for n in range(4)]
    print("running", flush=True)
    with contextlib.closing(LOCAL.run(tasks, 2, Needs(apart=True))) as finished:
        dict(finished)
"""


@contextlib.contextmanager
def program(tmp_path, deaf="listens", sigterm="default"):
    """The program in a session of its own, as a terminal starts it."""
    (tmp_path / "program.py").write_text(PROGRAM)
    (tmp_path / "pids").mkdir()
    command = [sys.executable, str(tmp_path / "program.py"), str(tmp_path / "pids"), deaf, sigterm]
    environment = {**os.environ, "PYTHONPATH": str(pathlib.Path(__file__).parents[3])}
    streams = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    with subprocess.Popen(command, env=environment, start_new_session=True, **streams) as process:
        try:
            assert process.stdout.readline() == "running\n"
            yield process
        finally:
            with contextlib.suppress(ProcessLookupError):
                os.killpg(process.pid, signal.SIGKILL)


def workers_at_work(tmp_path):
    while len(pids := [int(path.name) for path in (tmp_path / "pids").iterdir()]) < 2:
        time.sleep(0.05)
    return pids


def group_has_ended(process):
    """Wait until no process of the group runs; a watchdog of a minute."""
    said = process.communicate(timeout=60)[1]  # both ends of the pipes are closed: nothing writes any more
    for _ in range(600):
        with contextlib.suppress(ProcessLookupError):
            os.killpg(process.pid, 0)
            time.sleep(0.1)
            continue
        return said
    raise AssertionError("processes are left")


@pytest.mark.skipif(sys.platform != "linux", reason="sees processes in /proc")
@pytest.mark.parametrize("deaf", ["listens", "deaf"])
@pytest.mark.parametrize(
    ("signals", "sigterm"),
    [
        ([signal.SIGINT], "default"),
        ([signal.SIGINT] * 2, "default"),
        ([signal.SIGTERM], "handled"),
        ([signal.SIGTERM] * 2, "handled"),
        ([signal.SIGTERM], "default"),
    ],
)
def test_interrupts_end_all_workers(tmp_path, deaf, signals, sigterm):
    with program(tmp_path, deaf, sigterm) as process:
        pids = workers_at_work(tmp_path)
        for number in signals:
            to = os.killpg if number == signal.SIGINT else os.kill  # Ctrl-C reaches the whole group
            with contextlib.suppress(ProcessLookupError):
                to(process.pid, number)
            time.sleep(0.7)
        said = group_has_ended(process)
    assert not any(map(is_running, pids))
    assert said.count("Traceback") <= len(signals), "workers print none"


@pytest.mark.parametrize("after_s", [0.0, 0.02, 0.1, 0.5])
def test_an_interrupt_during_the_start_of_workers_ends_all(tmp_path, after_s):
    with program(tmp_path) as process:
        time.sleep(after_s)
        os.killpg(process.pid, signal.SIGINT)
        said = group_has_ended(process)
    assert process.returncode != 0
    assert said.count("Traceback") <= 1


def test_a_burst_of_interrupts_ends_all(tmp_path):
    with program(tmp_path, "deaf") as process:
        workers_at_work(tmp_path)
        for _ in range(30):
            with contextlib.suppress(ProcessLookupError):
                os.killpg(process.pid, signal.SIGINT)
            time.sleep(0.03)
        group_has_ended(process)


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
