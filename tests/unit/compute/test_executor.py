"""The local executor: results, reports, errors, interrupts, and retries after killed workers."""

import contextlib
import os
import pathlib
import signal
import subprocess
import sys
import time

import numpy as np
import pytest

from deltasafe.compute.executor import LOCAL, RETRIES, Needs, Task
from deltasafe.compute.processes import is_running
from deltasafe.errors import DataError, SettingsError, WorkerLostError
from deltasafe.studies.resumable_jobs import run_batches


def double(value):
    return 2 * value, os.getpid()


def send_reports(report, name, times):
    for number in range(times):
        report((name, number))
    return os.getpid()


def fail(mark):
    pathlib.Path(mark).touch()
    raise DataError("some/file", "is wrong")


def wait_for(mark):
    while not pathlib.Path(mark).exists():
        time.sleep(0.01)
    return mark


def die(marks, name, times):
    """Kill this process on the first ``times`` attempts; the file of that name counts the attempts."""
    mark = pathlib.Path(marks, name)
    attempts = len(mark.read_text()) if mark.is_file() else 0
    mark.write_text("x" * (attempts + 1))
    if attempts < times:
        os.kill(os.getpid(), signal.SIGKILL)
    return {"value": np.array(len(name))}


class NotUnpicklable(Exception):
    def __init__(self, one, two):
        super().__init__(f"{one} {two}")


def raise_not_unpicklable():
    raise NotUnpicklable("can be pickled,", "not unpickled")


def return_unpicklable():
    return lambda: None


def send_many_reports(report):
    for _ in range(3000):
        report("x" * 1000)


def results(tasks, workers, needs=None, on_report=None):
    with contextlib.closing(LOCAL.run(tasks, workers, needs or Needs(), on_report)) as finished:
        return dict(finished)


@pytest.mark.parametrize(("workers", "needs", "here"), [(1, Needs(), True), (2, Needs(), False)])
def test_every_task_runs_once_and_results_have_its_index(workers, needs, here):
    found = results([Task(f"double {n}", double, (n,)) for n in range(5)], workers, needs)
    assert {index: value for index, (value, _) in found.items()} == {n: 2 * n for n in range(5)}
    assert ({pid for _, pid in found.values()} == {os.getpid()}) == here


def test_a_task_that_needs_its_own_process_gets_one():
    ((_, pid),) = results([Task("alone", double, (1,))], 1, Needs(own_process=True)).values()
    assert pid != os.getpid()


@pytest.mark.parametrize("needs", [Needs(), Needs(own_process=True)], ids=["here", "apart"])
@pytest.mark.parametrize("workers", [1, 2])
def test_all_reports_arrive_before_the_end(workers, needs):
    reports = []
    results([Task(name, send_reports, (name, 3)) for name in "ab"], workers, needs, reports.append)
    assert sorted(reports) == [(name, number) for name in "ab" for number in range(3)]
    assert [number for name, number in reports if name == "b"] == [0, 1, 2]


def test_an_error_keeps_its_type_and_running_tasks_finish_first(tmp_path):
    mark, received = str(tmp_path / "mark"), []
    with pytest.raises(DataError, match="some/file: is wrong"):
        received.extend(LOCAL.run([Task("", wait_for, (mark,)), Task("", fail, (mark,))], 2))
    assert received == [(0, mark)]
    with pytest.raises(DataError):
        received.extend(LOCAL.run([Task("", fail, (mark,)), Task("", wait_for, (mark,))], 1, Needs(own_process=True)))
    assert received == [(0, mark)], "no task starts after an error"


@pytest.mark.parametrize(
    ("work", "message"),
    [(raise_not_unpicklable, "NotUnpicklable: can be pickled, not"), (return_unpicklable, "lambda|local")],
)
def test_unpicklable_results_and_errors_raise_instead_of_hanging(work, message):
    with pytest.raises(Exception, match=message):
        results([Task("", work)], 1, Needs(own_process=True))


def test_an_error_carries_the_traceback_of_the_worker(tmp_path):
    with pytest.raises(DataError) as raised:
        results([Task("", fail, (str(tmp_path / "mark"),))], 1, Needs(own_process=True))
    assert "in fail" in str(raised.value.__cause__)


def test_more_reports_than_a_pipe_holds_all_arrive():
    reports = []
    results([Task("", send_many_reports)] * 2, 2, on_report=reports.append)
    assert len(reports) == 6000


def test_an_error_in_the_callback_ends_the_workers(tmp_path):
    def fail(_):
        raise OSError("the log is full")

    with pytest.raises(OSError, match="the log is full"):
        results([Task("", send_many_reports)] * 2, 2, on_report=fail)


def test_a_killed_worker_affects_only_its_own_batch(tmp_path):
    tries, reports = tmp_path / "tries", []
    tries.mkdir()
    jobs = [(name, (str(tries), name, RETRIES if name == "ccc" else 0)) for name in ("a", "bb", "ccc", "dddd")]
    batches, _ = run_batches(die, jobs, tmp_path / "batches", 2, lambda *report: reports.append(report))
    assert [int(batch["value"]) for batch in batches] == [1, 2, 3, 4]
    assert {mark.name: len(mark.read_text()) for mark in tries.iterdir()} == {"a": 1, "bb": 1, "ccc": 3, "dddd": 1}
    assert [done for done, _, _ in reports] == [0, 1, 2, 3, 4]


def test_a_batch_that_loses_every_worker_is_named_and_other_batches_are_kept(tmp_path):
    tries = tmp_path / "tries"
    tries.mkdir()
    jobs = [(name, (str(tries), name, 99 if name == "bad" else 0)) for name in ("bad", "fine")]
    with pytest.raises(WorkerLostError, match="bad: the process"):
        run_batches(die, jobs, tmp_path / "batches", 2)
    assert (tries / "bad").read_text() == "x" * (RETRIES + 1)
    assert [file.name.split("-")[0] for file in (tmp_path / "batches").iterdir()] == ["fine"]


def test_closing_the_generator_ends_the_workers():
    finished = LOCAL.run([Task("", double, (n,)) for n in range(4)], 2)
    _, (_, pid) = next(finished)
    os.kill(pid, 0)
    finished.close()
    with pytest.raises(ProcessLookupError):
        os.kill(pid, 0)


def sleep(folder, ignores_sigterm):
    if ignores_sigterm:
        signal.signal(signal.SIGTERM, signal.SIG_IGN)
    pathlib.Path(folder, f"{os.getpid()}").touch()
    time.sleep(3600)


PROGRAM = """
import contextlib, signal, sys
from deltasafe.compute.executor import LOCAL, Needs, Task
from tests.unit.compute.test_executor import sleep

if __name__ == "__main__":
    signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell ignores it in background jobs
    if sys.argv[3] == "handled":
        signal.signal(signal.SIGTERM, signal.getsignal(signal.SIGINT))  # as Dagster does
    tasks = [Task(f"{n}", sleep, (sys.argv[1], sys.argv[2] == "ignores")) for n in range(4)]
    print("running", flush=True)
    with contextlib.closing(LOCAL.run(tasks, 2, Needs(own_process=True))) as finished:
        dict(finished)
"""


@contextlib.contextmanager
def program(tmp_path, worker="ends", sigterm="default"):
    """Start the program in its own session, as a terminal does."""
    (tmp_path / "program.py").write_text(PROGRAM)
    (tmp_path / "pids").mkdir()
    command = [sys.executable, str(tmp_path / "program.py"), str(tmp_path / "pids"), worker, sigterm]
    environment = {**os.environ, "PYTHONPATH": str(pathlib.Path(__file__).parents[3])}
    streams = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    with subprocess.Popen(command, env=environment, start_new_session=True, **streams) as process:
        try:
            assert process.stdout.readline() == "running\n"
            yield process
        finally:
            with contextlib.suppress(ProcessLookupError):
                os.killpg(process.pid, signal.SIGKILL)


def running_workers(tmp_path):
    while len(pids := [int(path.name) for path in (tmp_path / "pids").iterdir()]) < 2:
        time.sleep(0.05)
    return pids


def wait_for_end_of_group(process):
    """Wait until no process of the group runs, at most a minute; return what they wrote to stderr."""
    stderr = process.communicate(timeout=60)[1]  # returns when all writers have closed the pipes
    for _ in range(600):
        with contextlib.suppress(ProcessLookupError):
            os.killpg(process.pid, 0)
            time.sleep(0.1)
            continue
        return stderr
    raise AssertionError("processes are left")


@pytest.mark.skipif(sys.platform != "linux", reason="needs /proc")
@pytest.mark.parametrize("worker", ["ends", "ignores"])
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
def test_interrupts_end_all_workers(tmp_path, worker, signals, sigterm):
    with program(tmp_path, worker, sigterm) as process:
        pids = running_workers(tmp_path)
        for number in signals:
            to = os.killpg if number == signal.SIGINT else os.kill  # Ctrl-C reaches the whole group
            with contextlib.suppress(ProcessLookupError):
                to(process.pid, number)
            time.sleep(0.7)
        stderr = wait_for_end_of_group(process)
    assert not any(map(is_running, pids))
    assert stderr.count("Traceback") <= len(signals), "workers print no traceback"


@pytest.mark.parametrize("after_s", [0.0, 0.02, 0.1, 0.5])
def test_an_interrupt_while_workers_start_ends_all_processes(tmp_path, after_s):
    with program(tmp_path) as process:
        time.sleep(after_s)
        os.killpg(process.pid, signal.SIGINT)
        stderr = wait_for_end_of_group(process)
    assert process.returncode != 0
    assert stderr.count("Traceback") <= 1


def test_a_burst_of_interrupts_ends_all_processes(tmp_path):
    with program(tmp_path, "ignores") as process:
        running_workers(tmp_path)
        for _ in range(30):
            with contextlib.suppress(ProcessLookupError):
                os.killpg(process.pid, signal.SIGINT)
            time.sleep(0.03)
        wait_for_end_of_group(process)


def test_trainings_of_a_round_share_the_cores(monkeypatch):
    monkeypatch.setattr(os, "cpu_count", lambda: 4)
    assert LOCAL.rounds(5, 4) == [(4, 1), (1, 4)]
    assert LOCAL.rounds(2, 1) == [(1, 4), (1, 4)]
    assert LOCAL.rounds(0, 2) == []
    with pytest.raises(SettingsError, match="workers"):
        list(LOCAL.run([], 0))


class Backwards:
    """An executor that runs the tasks in this process, last one first."""

    def rounds(self, n_tasks, workers):
        return [(n_tasks, 1)]

    def n_parallel(self, workers):
        return 5

    def run(self, tasks, workers, needs=None, on_report=None):
        for index, task in reversed(list(enumerate(tasks))):
            yield index, task.work(*task.arguments)


def test_batches_are_in_job_order_whatever_order_they_finish_in(tmp_path):
    tries, reports = tmp_path / "tries", []
    tries.mkdir()
    jobs = [(name, (str(tries), name, 0)) for name in ("a", "bb", "ccc")]
    folder = tmp_path / "batches"
    batches, _ = run_batches(die, jobs, folder, progress=lambda *report: reports.append(report), executor=Backwards())
    assert [int(batch["value"]) for batch in batches] == [1, 2, 3]
    assert [message.split(";")[0] for _, _, message in reports[1:]] == ["ccc", "bb", "a"]
    again, effort = run_batches(die, jobs, folder, executor=Backwards())
    assert [int(batch["value"]) for batch in again] == [1, 2, 3]
    assert effort.minutes == pytest.approx(sum(float(batch["wall_s"]) for batch in again) / 60 / 5)
