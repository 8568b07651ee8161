"""The job `single_scene`: one partition is planned, audited, executed and evaluated with the ensemble in use."""

import dagster as dg
import pytest

from pipelines.build import build_defs
from pipelines.home import prepare_home
from pipelines.storage.io_manager import FolderPointers
from tests.ensembles import freeze_constant

SCENE = "scene_000"


@pytest.fixture
def home(tmp_path, monkeypatch):
    for name in ("DELTASAFE_HOME", "DAGSTER_HOME"):
        monkeypatch.setenv(name, str(tmp_path))
    return prepare_home()


@pytest.mark.filterwarnings("ignore::dagster.BetaWarning")  # data versions, as in `assets`
def test_one_scene_is_planned_executed_and_checked(home):
    # an ensemble that sees no hand: the planner always finds a motion, which the audit accepts
    FolderPointers(home=str(home)).point(dg.AssetKey("champion"), freeze_constant(home, -9.0))
    with dg.DagsterInstance.ephemeral() as instance:
        instance.add_dynamic_partitions("scenes", [SCENE])
        job = build_defs(home).resolve_job_def("single_scene")
        result = job.execute_in_process(instance=instance, partition_key=SCENE, raise_on_error=False)
        assert result.success, [event.message for event in result.all_events if event.is_failure]
        evaluations = {evaluation.check_name: evaluation for evaluation in result.get_asset_check_evaluations()}
    assert evaluations["audit_of_the_scene"].passed
    assert "on 1 trajectories are unsafe" in evaluations["audit_of_the_scene"].description
    assert "of 1 executed motions were safe" in evaluations["execution_of_the_scene_was_safe"].description
