"""Interrupted runs end with all their processes; processes of ended runs are found by PID and start time."""

import contextlib
import os
import pathlib
import signal
import subprocess
import sys
import time

import dagster as dg
import pytest
from dagster._core.events import RunFailureReason
from dagster._core.execution.retries import auto_reexecution_should_retry_run

from deltasafe.compute.processes import descendants, is_running, start_mark
from pipelines.automation.lost_runs import end_leftover_processes, fail_lost_runs
from pipelines.commands import run_job
from pipelines.supervision import FAILED_CHECKS_TAG, RunProcess, process_of, supervised
from tests.pipelines.long_run import POOL

ROOT = pathlib.Path(__file__).parents[2]
FAILED = dg.DagsterRunStatus.FAILURE
pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="needs /proc")


@pytest.fixture
def instance(tmp_path):
    (tmp_path / "marks").mkdir()
    pools = {"concurrency": {"pools": {"default_limit": 1, "granularity": "op"}}}
    with dg.DagsterInstance.local_temp(str(tmp_path), overrides=pools) as made:
        yield made


@contextlib.contextmanager
def long_run(tmp_path, how):
    """Start the command in its own session, as a terminal does; yield it and its PIDs when all of them work."""
    (tmp_path / "dagster.yaml").write_text("concurrency: {pools: {default_limit: 1, granularity: op}}\n")
    variables = {"DAGSTER_HOME": str(tmp_path), "LONG_RUN": str(tmp_path / "marks"), "PYTHONPATH": str(ROOT)}
    command = [sys.executable, "-c", f"from tests.pipelines.long_run import main; main({how!r})"]
    with subprocess.Popen(
        command, cwd=ROOT, env={**os.environ, **variables}, start_new_session=True, stderr=subprocess.DEVNULL
    ) as process:
        try:
            while len(list((tmp_path / "marks").iterdir())) < (2 if how == "workers" else 1):
                assert process.poll() is None
                time.sleep(0.1)
            yield process, [process.pid, *descendants(process.pid)]
        finally:
            with contextlib.suppress(ProcessLookupError):
                os.killpg(process.pid, signal.SIGKILL)


def wait_until_ended(process, pids):
    """Wait until all processes have ended; the timeout is many times the usual duration."""
    process.wait(timeout=120)
    until_s = time.monotonic() + 60
    while any(map(is_running, pids)) and time.monotonic() < until_s:
        time.sleep(0.1)
    assert [pid for pid in pids if is_running(pid)] == []


@pytest.mark.parametrize(
    ("how", "signals"),
    [
        ("workers", [signal.SIGINT]),
        ("workers", [signal.SIGINT] * 2),
        ("workers", [signal.SIGTERM] * 2),
        ("deaf", [signal.SIGINT]),
    ],
)
def test_an_interrupted_run_ends_all_processes_and_frees_its_pool_slots(tmp_path, instance, how, signals):
    with long_run(tmp_path, how) as (process, pids):
        assert len(pids) >= (4 if how == "workers" else 2)
        for number in signals:
            with contextlib.suppress(ProcessLookupError):
                (os.killpg if number == signal.SIGINT else os.kill)(process.pid, number)
            time.sleep(0.7)
        wait_until_ended(process, pids)
    (run,) = instance.get_runs()
    assert run.status == FAILED
    assert instance.event_log_storage.get_concurrency_info(POOL).active_slot_count == 0


def test_a_process_that_outlives_its_run_is_killed_with_its_workers(tmp_path, instance):
    with long_run(tmp_path, "workers") as (process, pids):
        (run,) = instance.get_runs()
        assert end_leftover_processes(instance) == []
        instance.report_run_canceled(run)
        assert end_leftover_processes(instance) == [run.run_id]
        wait_until_ended(process, pids)
        assert end_leftover_processes(instance) == []


@dg.op
def nothing():
    pass


def recorded():
    @dg.job(executor_def=supervised(dg.in_process_executor))
    def work():
        nothing()

    return work


def test_a_run_records_its_process_and_a_process_without_steps_is_kept(instance):
    with dg.execute_job(dg.reconstructable(recorded), instance=instance) as result:
        run = instance.get_run_by_id(result.run_id)
    assert process_of(instance, run.run_id) == RunProcess(os.getpid(), start_mark(os.getpid()))
    instance.report_run_failed(run)
    assert end_leftover_processes(instance) == []


def started_run(instance, metadata):
    """Create a started run whose event has ``metadata`` about its process."""
    run = instance.create_run_for_job(recorded(), status=dg.DagsterRunStatus.STARTED)
    instance.report_engine_event("Started process for run", run, dg._core.events.EngineEventData(metadata))
    return run.run_id


def test_a_reused_pid_is_another_process(instance):
    pid, (boot, _, ticks) = str(os.getpid()), start_mark(os.getpid()).rpartition(":")
    alive = [started_run(instance, {"pid": pid}), started_run(instance, {"pid": pid, "start": f"{boot}:{ticks}"})]
    gone = started_run(instance, {"pid": pid, "start": f"{boot}:{int(ticks) - 1}"})
    assert fail_lost_runs(instance) == [gone]
    assert {instance.get_run_by_id(each).status for each in alive} == {dg.DagsterRunStatus.STARTED}


@pytest.mark.parametrize("at", ["importing", "starting"])
def test_a_command_that_dies_before_its_first_step_is_a_lost_run(instance, monkeypatch, at):
    def dies(job, run, instance):
        if at == "starting":
            instance.report_dagster_event(dg.DagsterEvent("PIPELINE_STARTING", run.job_name), run.run_id)
        raise KeyboardInterrupt

    monkeypatch.setattr(run_job, "execute_run", dies)
    with pytest.raises(KeyboardInterrupt):
        run_job.execute(dg.reconstructable(recorded), instance, {})
    (run,) = instance.get_runs()
    assert run.status == getattr(dg.DagsterRunStatus, {"importing": "NOT_STARTED"}.get(at, "STARTING"))
    assert fail_lost_runs(instance) == []
    again = instance.create_run_for_job(recorded(), tags=run.tags)  # a re-execution copies the tags
    mark = start_mark(os.getpid())
    monkeypatch.setattr("pipelines.automation.lost_runs.is_running", lambda *process: process != (os.getpid(), mark))
    assert fail_lost_runs(instance) == [run.run_id]
    assert instance.get_run_by_id(run.run_id).status == FAILED
    assert instance.get_run_by_id(again.run_id).status == dg.DagsterRunStatus.NOT_STARTED


@pytest.mark.parametrize("step_s", [-1e6, 10.0, 1e6])
def test_a_clock_change_fails_no_run(instance, monkeypatch, step_s):
    started_run(instance, {"pid": str(os.getpid())})
    started_run(instance, {"pid": str(os.getpid()), "start": start_mark(os.getpid())})
    instance.create_run_for_job(recorded(), status=dg.DagsterRunStatus.STARTING)
    assert fail_lost_runs(instance) == []
    now_s = time.time()
    monkeypatch.setattr(time, "time", lambda: now_s + step_s)
    assert fail_lost_runs(instance) == []


UPTIME = """
mount --bind {fake} /proc/uptime && test "$(cat /proc/uptime)" = "100.00 100.00" && exec {python} -c '
import dagster as dg
from pipelines.automation.lost_runs import fail_lost_runs
with dg.DagsterInstance.from_config("{home}") as instance:
    print(fail_lost_runs(instance))
'
"""


def can_mount():
    return subprocess.run(["unshare", "-m", "true"], check=False, capture_output=True).returncode == 0


@pytest.mark.skipif(not can_mount(), reason="needs a mount namespace, hence root")
def test_another_uptime_in_a_container_fails_no_run(tmp_path, instance):
    fake = tmp_path / "uptime"
    fake.write_text("100.00 100.00\n")
    (tmp_path / "dagster.yaml").touch()
    started_run(instance, {"pid": str(os.getpid())})
    started_run(instance, {"pid": str(os.getpid()), "start": start_mark(os.getpid())})
    gone = started_run(instance, {"pid": str(2**22 + 1), "start": "boot:1"})
    script = UPTIME.format(fake=fake, python=sys.executable, home=tmp_path)
    stdout = subprocess.run(
        ["unshare", "-m", "sh", "-c", script], cwd=ROOT, check=True, capture_output=True, text=True
    ).stdout
    assert stdout == f"{[gone]}\n"


def refused():
    @dg.job(executor_def=supervised(dg.in_process_executor, lambda config, steps: f"{sorted(steps)} are refused"))
    def work():
        nothing()

    return work


def test_a_refused_run_starts_no_step_and_is_not_retried(instance):
    tags = {"dagster/max_retries": "2"}
    with dg.execute_job(dg.reconstructable(refused), instance=instance, tags=tags) as result:
        run = instance.get_run_by_id(result.run_id)
    assert run.status == FAILED
    assert not auto_reexecution_should_retry_run(instance, run, RunFailureReason.RUN_EXCEPTION)
    events = [entry.dagster_event for entry in instance.all_logs(run.run_id) if entry.dagster_event]
    assert not [event for event in events if event.is_step_event]
    (failure,) = [event for event in events if event.is_job_failure]
    assert "['nothing'] are refused" in failure.job_failure_data.error.message


PASSED = {"audit": False, "bound": False}


def checked():
    @dg.asset
    def report():
        pass

    @dg.multi_asset_check(specs=[dg.AssetCheckSpec(name, asset=report) for name in PASSED])
    def checks():
        for name, passed in PASSED.items():
            yield dg.AssetCheckResult(check_name=name, passed=passed, severity=dg.AssetCheckSeverity.WARN)

    jobs = [dg.define_asset_job("work")]
    defs = dg.Definitions([report], jobs=jobs, asset_checks=[checks], executor=supervised(dg.in_process_executor))
    return defs.resolve_job_def("work")


def test_failed_checks_are_a_tag_of_the_green_run(instance, monkeypatch):
    def run(tags, **passed):
        for name, value in passed.items():
            monkeypatch.setitem(PASSED, name, value)
        with dg.execute_job(dg.reconstructable(checked), instance=instance, tags=tags) as result:
            assert result.success
            return instance.get_run_by_id(result.run_id).tags

    failed = run({}, audit=True)
    assert failed[FAILED_CHECKS_TAG] == "report.bound"
    assert run(failed, bound=True)[FAILED_CHECKS_TAG] == "none", "the tags of the parent run were copied"
    assert FAILED_CHECKS_TAG not in run({})
