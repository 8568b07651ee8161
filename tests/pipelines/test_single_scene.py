"""The job `single_scene`: one partition is planned, audited, executed and evaluated with the ensemble in use."""

import dagster as dg
import pytest

from deltasafe.trials.new_scene import write_scene
from pipelines.build import build_defs
from pipelines.home import prepare_home
from pipelines.storage.io_manager import FolderPointers
from tests.ensembles import freeze_constant
from tests.unit.trials.test_new_scene import DRAFT

SCENE = "scene_000"


@pytest.fixture
def home(tmp_path, monkeypatch):
    for name in ("DELTASAFE_HOME", "DAGSTER_HOME"):
        monkeypatch.setenv(name, str(tmp_path))
    return prepare_home()


def run(home, instance, scene, folder=""):
    """Run the job for one partition; return its check evaluations by name."""
    instance.add_dynamic_partitions("scenes", [scene])
    job = build_defs(home).resolve_job_def("single_scene")
    config = {"ops": {"logged_scene": {"config": {"folder": str(folder)}}}}
    result = job.execute_in_process(config, instance=instance, partition_key=scene, raise_on_error=False)
    assert result.success, [event.message for event in result.all_events if event.is_failure]
    return {evaluation.check_name: evaluation for evaluation in result.get_asset_check_evaluations()}


@pytest.mark.filterwarnings("ignore::dagster.BetaWarning")  # data versions, as in `assets`
def test_scenes_with_and_without_truth_are_planned_executed_and_checked(home):
    # an ensemble that sees no hand: the planner always finds a motion, which the audit accepts
    FolderPointers(home=str(home)).point(dg.AssetKey("champion"), freeze_constant(home, -9.0))
    photo = write_scene(DRAFT, home / "mine" / "photo")
    with dg.DagsterInstance.ephemeral() as instance:
        evaluations = run(home, instance, SCENE)
        unjudged = run(home, instance, photo.id, home / "mine")["execution_of_the_scene_was_safe"]
    assert (unjudged.passed, unjudged.severity) == (False, dg.AssetCheckSeverity.WARN)
    assert "not judged: contacts of 1 motions with the hand" in unjudged.description
    assert evaluations["audit_of_the_scene"].passed
    assert "on 1 trajectories are unsafe" in evaluations["audit_of_the_scene"].description
    assert "of 1 executed motions were safe" in evaluations["execution_of_the_scene_was_safe"].description
