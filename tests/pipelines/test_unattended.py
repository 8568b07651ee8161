"""Unattended operation: after one changed image, daemon, sensor and automation retrain and plan again."""

import os
import pathlib
import shutil
import subprocess
import sys
import time

import cv2
import dagster as dg
import pytest
from dagster._core.definitions.run_request import InstigatorType

from pipelines.automation.sensors import INTERVAL_VARIABLE
from pipelines.home import DATASETS, prepare_home
from pipelines.jobs import UNATTENDED_VARIABLE
from pipelines.storage.io_manager import FolderPointers
from pipelines.tracking.model_versions import CHAMPION
from pipelines.tracking.tracker import MlflowTracker
from tests.ensembles import freeze_constant

ROOT = pathlib.Path(__file__).parents[2]
SCENES = dg.AssetKey("logged_scenes")


@pytest.fixture
def home(tmp_path, monkeypatch):
    """A home with an ensemble in use, selected scenes, and labeled images with one defective mask."""
    from deltasafe.trials.selection import select_scenes

    for name in ("DELTASAFE_HOME", "DAGSTER_HOME"):
        monkeypatch.setenv(name, str(tmp_path))
    root = prepare_home()
    tracker = MlflowTracker(root)
    earlier = freeze_constant(root, 1.0)  # predicts hand nearly everywhere: any trained ensemble is better
    tracker.register("e" * 64, earlier)
    tracker.call("promote", artifact=earlier.name, because="the first")
    hands = pathlib.Path(shutil.copytree(DATASETS / "hands" / "train", root / "incoming" / "hands"))
    mask = min((hands / "masks").iterdir())
    good = mask.read_bytes()
    cv2.imwrite(str(mask), cv2.imread(str(mask), cv2.IMREAD_GRAYSCALE) // 2)
    select_scenes(DATASETS / "scenes", 1, root / "store" / "scenes")
    FolderPointers(home=str(root)).point(SCENES, root / "store" / "scenes")
    with dg.DagsterInstance.get() as instance:
        instance.report_runless_asset_event(dg.AssetMaterialization(SCENES, tags={"dagster/data_version": "1"}))
        yield root, instance, mask, good


@pytest.fixture
def daemon(home, tmp_path):
    environment = {**os.environ, INTERVAL_VARIABLE: "2", UNATTENDED_VARIABLE: "1"}
    command = [sys.executable, "-m", "dagster._daemon", "run", "-w", str(ROOT / "workspace.yaml")]
    with (tmp_path / "daemon.log").open("w") as log:
        process = subprocess.Popen(command, cwd=ROOT, env=environment, stdout=log, stderr=log, start_new_session=True)
    yield process, tmp_path / "daemon.log"
    process.terminate()
    process.wait()


def refusal(instance):
    """Return the skip reason of the sensor for defective images; None if there is none yet."""
    for state in instance.all_instigator_state(instigator_type=InstigatorType.SENSOR):
        for tick in instance.get_ticks(state.instigator_origin_id, state.selector_id):
            if "not used until it is changed" in (tick.skip_reason or ""):
                return tick.skip_reason
    return None


def wait_for(found, daemon, instance):
    """Poll ``found`` without a time limit; fail if the daemon has ended or a run has failed."""
    process, log = daemon
    while True:
        value = found()
        if value:
            return value
        assert process.poll() is None, log.read_text()[-4000:]
        for run in instance.get_runs(dg.RunsFilter(statuses=[dg.DagsterRunStatus.FAILURE])):
            errors = [e.dagster_event.message for e in instance.all_logs(run.run_id) if "FAILURE" in e.message]
            raise AssertionError(f"{run.job_name} failed: {errors}\n{log.read_text()[-4000:]}")
        time.sleep(0.5)


@pytest.mark.filterwarnings("ignore")  # warnings of MLflow
def test_a_changed_image_becomes_a_new_challenger_and_what_follows_is_made_again(home, daemon):
    root, instance, mask, good = home
    assert wait_for(lambda: refusal(instance), daemon, instance).startswith("not used until it is changed")
    assert instance.get_runs() == []

    mask.write_bytes(good)

    def trained():
        runs = instance.get_runs(dg.RunsFilter(job_name="perception", statuses=[dg.DagsterRunStatus.SUCCESS]))
        return runs[0] if runs else None

    run = wait_for(trained, daemon, instance)
    assert run.tags["dagster/sensor_name"] == "labeled_images"
    with MlflowTracker(root).records() as records:
        newest = records.versions()[0]
    assert newest.tags["dagster_run_id"] == run.run_id
    assert CHAMPION in newest.aliases
    assert "not worse than" in newest.tags["promoted"]

    follows = dg.RunsFilter(tags={"dagster/from_automation_condition": "true"})
    request = wait_for(lambda: instance.get_runs(follows), daemon, instance)[0]
    assert {key.to_user_string() for key in request.asset_selection} == {
        "occupancy_fields",
        "planned_motions",
        "executed_motions",
        "safety_report",
    }
