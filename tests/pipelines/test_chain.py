"""`make demo PRESET=smoke`, and the results that it leaves."""

import json
import os
import pathlib
import subprocess
import sys

import dagster as dg
import numpy as np
import pytest

from pipelines.home import tracking_uri
from pipelines.storage.io_manager import FolderPointers
from pipelines.tracking.mlflow_records import EXPERIMENT
from pipelines.tracking.model_versions import CHAMPION, MODEL_NAME

ROOT = pathlib.Path(__file__).parents[2]

BLOCKED = """
import sys
class Blocked:
    def find_spec(self, name, path=None, target=None):
        if name.split(".")[0] in ("dagster", "mlflow"):
            raise ModuleNotFoundError(name)
sys.meta_path.insert(0, Blocked())
"""


def run(home, *arguments):
    environment = {**os.environ, "DELTASAFE_HOME": str(home), "DELTASAFE_PRESET": "smoke"}
    command = [sys.executable, *arguments]
    return subprocess.run(command, env=environment, cwd=ROOT, capture_output=True, text=True, check=False)


@pytest.fixture(scope="module")
def home(tmp_path_factory):
    return tmp_path_factory.mktemp("home")


@pytest.fixture(scope="module")
def demo(home):
    finished = run(home, "-m", "pipelines.commands.demo")
    assert finished.returncode == 0, finished.stdout[-2000:] + finished.stderr[-6000:]
    return finished


@pytest.fixture(scope="module")
def folder(home, demo):
    pointers = FolderPointers(home=str(home))
    return lambda asset, partition=None: pointers.folder(dg.AssetKey(asset), partition)


def test_the_summary_names_the_results(demo, folder):
    for asset in ("calibration_report", "safety_report", "frozen_ensemble"):
        assert str(folder(asset)) in demo.stdout
    assert "make ui" in demo.stdout
    assert "member_01: finished after" in demo.stderr, "progress is visible"


def test_no_temporary_file_is_left(home, demo):
    hidden = [path for path in home.rglob(".*") if path.parent.name != "dagster"]
    assert hidden == []
    assert not list((home / "store").rglob("checkpoint.safetensors"))


def test_every_original_has_the_configured_number_of_variants(folder):
    from deltasafe.perception.data.augmented_set import AugmentedSet
    from deltasafe.presets import PRESETS

    data = AugmentedSet.load(folder("augmented_hands"))
    assert data.n == 50 * PRESETS["smoke"].augmentation.n_variants


def test_members_differ_and_are_recorded(home, folder):
    from mlflow import MlflowClient

    from deltasafe.perception.training.member import Member

    first, second = (Member.load(folder("ensemble_member", f"member_{m:02d}")) for m in range(2))
    assert first.record["weights_sha256"] != second.record["weights_sha256"]
    client = MlflowClient(tracking_uri(home))
    assert client.get_model_version_by_alias(MODEL_NAME, CHAMPION).tags["artifact"] == folder("frozen_ensemble").name


def test_dagster_and_mlflow_link_to_each_other(home, demo):
    from mlflow import MlflowClient

    client = MlflowClient(tracking_uri(home))
    found = client.search_runs([client.get_experiment_by_name(EXPERIMENT).experiment_id])
    assert len(found) == 3, "one for the ensemble and one per member"
    with dg.DagsterInstance.from_config(str(home / "dagster")) as instance:
        (run,) = instance.get_runs(dg.RunsFilter(job_name="everything"))
        pages = {
            event.partition: event.metadata["MLflow run"].url
            for event in instance.fetch_materializations(dg.AssetKey("ensemble_member"), limit=10).records
            for event in [event.asset_materialization]
        }
    for record in found:
        assert record.data.tags["dagster_run_id"] == run.run_id
        assert record.data.tags["dagster_run"].endswith(f"/runs/{run.run_id}")
        assert record.inputs.dataset_inputs, "its data, by digest"
        if "mlflow.parentRunId" in record.data.tags:
            assert pages[record.info.run_name].endswith(record.info.run_id)
            assert {"loss", "loss_epoch", "images_per_s"} <= set(record.data.metrics)
            assert [file.path for file in client.list_artifacts(record.info.run_id, "figures")] == ["figures/loss.png"]
    assert not list((home / "mlflow" / "pending").glob("*.json")), "no call is pending"


def test_every_asset_page_is_small(home, demo):
    with dg.DagsterInstance.from_config(str(home / "dagster")) as instance:
        for key in instance.get_asset_keys():
            event = instance.get_latest_materialization_event(key)
            shown = [str(value.value) for value in event.asset_materialization.metadata.values()]
            assert sum(map(len, shown)) < 100_000, key.to_user_string()


def test_the_first_ensemble_is_promoted(folder):
    assert folder("champion") == folder("frozen_ensemble")


def test_the_report_evaluates_all_pixels_of_all_test_images(folder):
    from deltasafe.perception.calibration.report import CalibrationReport

    report = CalibrationReport.load(folder("calibration_report"))
    assert report.n_pixels == 50 * 384 * 288
    assert next(predictor.scores for predictor in report.ensembles) == report.members[0].scores


def test_the_frozen_ensemble_loads_without_dagster_and_mlflow(folder, tmp_path):
    frozen = folder("frozen_ensemble")
    program = f"""{BLOCKED}
import numpy as np, deltasafe
p = deltasafe.load_ensemble({str(frozen)!r}).p_occupied(np.full((61, 83, 3), 90, np.uint8))
np.save({str(tmp_path / "p.npy")!r}, p)
"""
    subprocess.run(
        [sys.executable, "-c", program], check=True, cwd=tmp_path, env={**os.environ, "PYTHONPATH": str(ROOT)}
    )
    assert np.load(tmp_path / "p.npy", allow_pickle=False).shape == (61, 83)


@pytest.mark.filterwarnings("ignore")  # warnings of MLflow
def test_the_registered_model_predicts_the_same_probabilities(home, folder):
    import mlflow

    import deltasafe

    mlflow.set_tracking_uri(tracking_uri(home))
    model = mlflow.pyfunc.load_model(f"models:/{MODEL_NAME}@{CHAMPION}")
    images = np.random.default_rng(0).integers(0, 256, (2, 40, 50, 3), dtype=np.uint8)
    ensemble = deltasafe.load_ensemble(folder("frozen_ensemble"))
    expected = np.stack([ensemble.p_occupied(image) for image in images])
    assert np.abs(np.asarray(model.predict(images)) - expected).max() < 1e-6


def test_every_scene_has_an_outcome_a_plan_and_a_verdict_if_executed(folder):
    report = json.loads((folder("safety_report") / "report.json").read_text())
    assert report["figures"]["scenes"] == len(report["scenes"]) == 2
    for scene in report["scenes"]:
        assert scene["outcome"]
        assert (folder("safety_report") / f"{scene['scene_id']}-plan.png").is_file()
        assert (scene["verdict"] is not None) == (folder("executed_motions") / scene["scene_id"]).is_dir()


def test_figures_are_recorded_in_the_documented_form(home, demo):
    record = json.loads((home / "results.json").read_text())
    assert set(record) == {"figures", "command", "commit", "seeds", "machine"}
    required = {"minutes_total", "pa", "miou", "nll", "bs", "scenes", "scenes_executed", "contacts"}
    assert required <= set(record["figures"])
    assert all(isinstance(value, int | float) for value in record["figures"].values())


def test_one_member_is_materialized_alone(home, demo):
    """With the range tags of the job, one run makes all members; here, one partition has its own run."""
    program = """
import dagster as dg
from pipelines.home import prepare_home
prepare_home()
from pipelines.definitions import defs
job = defs().resolve_implicit_global_asset_job_def()
with dg.DagsterInstance.get() as instance:
    result = job.execute_in_process(
        instance=instance, asset_selection=[dg.AssetKey("ensemble_member")], partition_key="member_01"
    )
    assert result.success
    events = [e for e in result.all_events if e.event_type_value == "ASSET_MATERIALIZATION"]
    print(*[e.partition for e in events])
"""
    finished = run(home, "-c", program)
    assert finished.returncode == 0, finished.stderr[-3000:]
    assert finished.stdout.split() == ["member_01"]
