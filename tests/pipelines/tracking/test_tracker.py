"""Tracking: runs of ensembles and members from parallel processes, and calls while MLflow is away."""

import concurrent.futures
import contextlib
import dataclasses
import json
import multiprocessing
import os
import pathlib
import sqlite3
import subprocess
import sys
import time

import pytest

from assets.interfaces import TrainedMember
from pipelines.home import TRACKING_VARIABLE, tracking_uri
from pipelines.tracking.call_queue import CallQueue
from pipelines.tracking.mlflow_records import EXPERIMENT
from pipelines.tracking.tracker import MlflowTracker, is_reachable
from tests.loopback import free_ports

IDENTITY = "i" * 64


def trained(name="member_00", losses=(0.7, 0.3, 0.2, 0.1), figure=pathlib.Path("none")):
    return TrainedMember(name, {"epochs": 2, "seed": 1}, losses, 2, [11.0, 12.0], {"augmented hands": "a" * 64}, figure)


def record(home, name):
    MlflowTracker(home, {"dagster_run_id": name}).member(IDENTITY, trained(name))


def runs(uri):
    from mlflow import MlflowClient

    client = MlflowClient(uri)
    found = client.search_runs([client.get_experiment_by_name(EXPERIMENT).experiment_id])
    children = {run.info.run_name: run for run in found if "mlflow.parentRunId" in run.data.tags}
    (parent,) = [run for run in found if "mlflow.parentRunId" not in run.data.tags]
    return client, parent, children


def curve(client, run, key):
    return [(m.step, m.value) for m in client.get_metric_history(run.info.run_id, key)]


def test_processes_that_create_the_database_in_parallel_share_one_parent_run(tmp_path):
    names = ["member_00", "member_01"]
    context = multiprocessing.get_context("spawn")
    with concurrent.futures.ProcessPoolExecutor(2, context) as pool:
        list(pool.map(record, [tmp_path] * 2, names))
    record(tmp_path, "member_01")  # trained again: the same run
    client, parent, children = runs(tracking_uri(tmp_path))
    assert sorted(children) == names
    assert {run.data.tags["mlflow.parentRunId"] for run in children.values()} == {parent.info.run_id}
    member = children["member_00"]
    assert member.data.params == {"epochs": "2", "seed": "1"}
    assert parent.data.params == {"epochs": "2"}
    assert curve(client, children["member_01"], "loss") == [(0, 0.7), (1, 0.3), (2, 0.2), (3, 0.1)]
    assert curve(client, member, "loss_epoch") == [(1, pytest.approx(0.5)), (2, pytest.approx(0.15))]
    assert curve(client, member, "images_per_s") == [(1, 11.0), (2, 12.0)]
    assert member.data.tags["dagster_run_id"] == "member_00"
    (seen,) = member.inputs.dataset_inputs
    assert (seen.dataset.name, seen.dataset.digest) == ("augmented hands", "a" * 36)
    assert [(tag.key, tag.value) for tag in seen.tags] == [("mlflow.data.context", "training")]


def test_a_report_is_recorded_in_the_run_of_its_ensemble(tmp_path):
    (tmp_path / "report").mkdir()
    (tmp_path / "report" / "report.md").write_text("# fine")
    (tmp_path / "loss.png").write_bytes(b"png")
    tracker = MlflowTracker(tmp_path / "home")
    tracker.member(IDENTITY, trained(figure=tmp_path / "loss.png"))
    page = tracker.report(IDENTITY, {"pa": 0.98}, tmp_path / "report", {"test hands": "t" * 64})
    client, parent, children = runs(tracking_uri(tmp_path / "home"))
    assert parent.data.metrics == {"pa": 0.98}
    assert page == f"http://127.0.0.1:5000/#/experiments/{parent.info.experiment_id}/runs/{parent.info.run_id}"
    assert [file.path for file in client.list_artifacts(parent.info.run_id, "calibration_report")] == [
        "calibration_report/report.md"
    ]
    child = children["member_00"].info.run_id
    assert [file.path for file in client.list_artifacts(child, "figures")] == ["figures/loss.png"]
    assert parent.inputs.dataset_inputs[0].dataset.digest == "t" * 36


def test_recording_again_changes_no_duration_and_a_member_alone_ends_its_parent(tmp_path):
    began_ms, ended_ms = 1_700_000_000_000, 1_700_000_050_000
    tracker = MlflowTracker(tmp_path, {"mlflow.user": "someone", "mlflow.source.git.commit": "abc"})
    first = dataclasses.replace(trained(), trained_ms=(began_ms, ended_ms))
    tracker.member(IDENTITY, first)
    (tmp_path / "report").mkdir()
    for _ in range(2):  # made again later: both members are reused
        tracker.member(IDENTITY, trained())
        tracker.report(IDENTITY, {"pa": 0.98}, tmp_path / "report", {})
    client, parent, children = runs(tracking_uri(tmp_path))
    for run in (parent, children["member_00"]):
        assert (run.info.start_time, run.info.end_time, run.info.status) == (began_ms, ended_ms, "FINISHED")
        assert run.data.tags["mlflow.source.git.commit"] == "abc"
        assert run.data.tags["mlflow.user"] == "someone"
    points = client.get_metric_history(children["member_00"].info.run_id, "loss")
    times_ms = [point.timestamp for point in points]
    assert times_ms == sorted(set(times_ms))
    assert (times_ms[0] > began_ms, times_ms[-1]) == (True, ended_ms)
    tracker.member(IDENTITY, dataclasses.replace(trained("member_01"), trained_ms=(ended_ms, ended_ms + 7000)))
    _, parent, _ = runs(tracking_uri(tmp_path))
    assert parent.info.end_time == ended_ms + 7000
    assert client.get_experiment_by_name(EXPERIMENT).tags["mlflow.experimentKind"] == "custom_model_development"


# a server that comes and goes -----------------------------------------------------------------------------------


@pytest.fixture
def server(tmp_path, monkeypatch):
    """Return an address without a server, and a function that starts a server there."""
    (port,) = free_ports(1)
    uri = f"http://127.0.0.1:{port}"
    monkeypatch.setenv(TRACKING_VARIABLE, uri)
    monkeypatch.setenv("MLFLOW_HTTP_REQUEST_MAX_RETRIES", "1")
    started = []

    def start():
        store = tmp_path / "server"
        store.mkdir()
        command = [sys.executable, "-m", "mlflow", "server", "--host", "127.0.0.1", "--port", str(port)]
        command += ["--workers", "1", "--backend-store-uri", f"sqlite:///{store / 'mlflow.db'}"]
        command += ["--artifacts-destination", str(store / "artifacts")]
        environment = {**os.environ, "MLFLOW_SERVER_ENABLE_JOB_EXECUTION": "false"}
        environment.pop(TRACKING_VARIABLE)
        with (tmp_path / "server.log").open("w") as log:
            started.append(subprocess.Popen(command, env=environment, stdout=log, stderr=log))
        for _ in range(1200):
            if is_reachable(uri, timeout_s=1.0):
                return
            assert started[-1].poll() is None, (tmp_path / "server.log").read_text()[-3000:]
            time.sleep(0.1)
        raise AssertionError("the server did not come up")

    yield uri, start
    for process in started:
        process.terminate()
        process.wait()


def test_calls_during_an_outage_are_replayed_once_and_in_order(tmp_path, server):
    uri, start = server
    home = tmp_path / "home"
    tracker = MlflowTracker(home, {"dagster_run_id": "first"})
    (tmp_path / "report").mkdir()
    (tmp_path / "report" / "report.md").write_text("# fine")
    assert tracker.member(IDENTITY, trained()) is None, "no page yet, and no error"
    assert tracker.report(IDENTITY, {"pa": 0.98}, tmp_path / "report", {}) is None
    waiting = CallQueue(home / "mlflow" / "pending").files()
    assert [json.loads(file.read_text())["call"] for file in waiting] == ["member", "report"]
    assert not (home / "mlflow" / "mlflow.db").exists(), "with an address, there is no local database"

    start()
    page = MlflowTracker(home, {"dagster_run_id": "second"}).member(IDENTITY, trained("member_01"))
    assert page.startswith(f"{uri}/#/experiments/")
    assert tracker.pending.files() == []
    client, parent, children = runs(uri)
    assert sorted(children) == ["member_00", "member_01"]
    assert children["member_00"].data.tags["dagster_run_id"] == "first"
    assert parent.data.metrics == {"pa": 0.98}
    before = curve(client, children["member_00"], "loss")

    # a process that ends between a call and the removal of its file: the call is made again
    waiting[0].write_text(json.dumps({"call": "member", "arguments": _as_written(tracker)}))
    tracker.replay()
    client, _, children = runs(uri)
    assert sorted(children) == ["member_00", "member_01"]
    assert curve(client, children["member_00"], "loss") == before
    assert len(before) == 4


def _as_written(tracker):
    written = {}
    probe = MlflowTracker(tracker.home, tracker.tags)
    probe.pending = type("Noted", (), {"add": lambda self, kind, arguments: written.update(arguments) or "x"})()
    probe.replay = dict
    probe.member(IDENTITY, trained())
    return written


def test_a_call_that_fails_permanently_is_refused_and_blocks_nothing(tmp_path):
    tracker = MlflowTracker(tmp_path)
    assert tracker.report(IDENTITY, {"pa": 0.9}, tmp_path / "missing report", {}) is None
    assert tracker.member(IDENTITY, trained()) is not None
    (reason,) = (tmp_path / "mlflow" / "pending" / "refused").glob("*.txt")
    assert "missing report" in reason.read_text()


@pytest.mark.parametrize("kind", ["a folder", "not a database"])
def test_a_database_that_cannot_be_opened_causes_a_warning(kind, tmp_path, caplog):
    database = tmp_path / "mlflow" / "mlflow.db"
    if kind == "a folder":
        database.mkdir(parents=True)
    else:
        database.parent.mkdir(parents=True)
        database.write_bytes(b"not a SQLite database" * 100)
    tracker = MlflowTracker(tmp_path)
    assert tracker.member(IDENTITY, trained()) is None
    assert "wait" in caplog.text
    assert str(database) in caplog.text
    assert len(tracker.pending.files()) == 1


def test_a_locked_or_missing_database_counts_as_reachable(tmp_path):
    with contextlib.closing(sqlite3.connect(tmp_path / "mlflow.db")) as connection:
        connection.execute("CREATE TABLE some (x)")
        connection.execute("BEGIN EXCLUSIVE")
        assert is_reachable(f"sqlite:///{tmp_path / 'mlflow.db'}", timeout_s=0.1)
    assert is_reachable(f"sqlite:///{tmp_path / 'not yet.db'}")
    assert not (tmp_path / "not yet.db").exists()
