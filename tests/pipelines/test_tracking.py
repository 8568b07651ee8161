"""MLflow: one run an ensemble, one a member, however many processes write."""

import concurrent.futures
import multiprocessing

from pipelines.home import tracking_uri
from pipelines.tracking import EXPERIMENT, MlflowTracker


def record(home, name):
    MlflowTracker(home, {"dagster_run_id": name}).member("i" * 64, name, {"epochs": 4, "seed": 1}, [0.7, 0.3, 0.1])


def runs(home):
    from mlflow import MlflowClient

    client = MlflowClient(tracking_uri(home))
    return client, client.search_runs([client.get_experiment_by_name(EXPERIMENT).experiment_id])


def test_processes_that_open_a_fresh_database_at_once_share_one_parent(tmp_path):
    names = ["member_00", "member_01"]
    context = multiprocessing.get_context("spawn")
    with concurrent.futures.ProcessPoolExecutor(2, context) as pool:
        list(pool.map(record, [tmp_path] * 2, names))
    record(tmp_path, "member_01")  # trained again: the same run, not another one
    client, found = runs(tmp_path)
    children = {run.info.run_name: run for run in found if "mlflow.parentRunId" in run.data.tags}
    parents = [run for run in found if "mlflow.parentRunId" not in run.data.tags]
    assert len(parents) == 1
    assert sorted(children) == names
    assert {run.data.tags["mlflow.parentRunId"] for run in children.values()} == {parents[0].info.run_id}
    member = children["member_00"]
    assert member.data.params == {"epochs": "4", "seed": "1"}
    assert [m.value for m in client.get_metric_history(member.info.run_id, "loss")] == [0.7, 0.3, 0.1]
    assert member.data.tags["dagster_run_id"] == "member_00"


def test_a_report_goes_to_the_run_of_its_ensemble(tmp_path):
    (tmp_path / "report").mkdir()
    (tmp_path / "report" / "report.md").write_text("# fine")
    tracker = MlflowTracker(tmp_path / "home")
    tracker.member("i" * 64, "member_00", {}, [0.5])
    tracker.report("i" * 64, {"pa": 0.98}, tmp_path / "report")
    client, found = runs(tmp_path / "home")
    (parent,) = [run for run in found if "mlflow.parentRunId" not in run.data.tags]
    assert parent.data.metrics == {"pa": 0.98}
    assert [file.path for file in client.list_artifacts(parent.info.run_id, "calibration_report")] == [
        "calibration_report/report.md"
    ]
