"""What a person does in MLflow or Dagster is seen, respected and shown; each test gets a copy of one home."""

import shutil

import dagster as dg
import mlflow
import pytest

from deltasafe.errors import DataError
from pipelines import operation
from pipelines.automation.sensors import check_decisions
from pipelines.commands import registry as command
from pipelines.home import tracking_uri
from pipelines.storage.io_manager import FolderPointers
from pipelines.tracking.model_versions import CHAMPION, MODEL_NAME
from pipelines.tracking.tracker import MlflowTracker
from tests.ensembles import freeze_constant, write_hands
from tests.registered import HANDS, aliases, light_registration, materialize, publish, versions

pytestmark = pytest.mark.filterwarnings("ignore")  # warnings of MLflow
KEY = dg.AssetKey("champion")


@pytest.fixture(scope="module", autouse=True)
def registered_quickly():
    with pytest.MonkeyPatch.context() as patch:
        light_registration(patch)
        yield


@pytest.fixture(scope="module")
def original(tmp_path_factory):
    """Return a home in which three versions were promoted in turn, each better than the one before."""
    home = tmp_path_factory.mktemp("original")
    FolderPointers(home=str(home)).point(HANDS, write_hands(home / "test"))
    tracker = MlflowTracker(home)
    for logit in (1.0, -2.0, -3.0):
        folder = freeze_constant(home, logit)
        tracker.register("i" * 64, folder)
        command.EnsembleRegistry(tracker).decide(folder, True, "better")
    FolderPointers(home=str(home)).point(KEY, folder)
    freeze_constant(home / "new", -2.5)
    return home


@pytest.fixture
def home(original, tmp_path, monkeypatch):
    monkeypatch.setattr(command, "prepare_home", lambda: tmp_path / "home")
    return shutil.copytree(original, tmp_path / "home")


@pytest.fixture
def instance(tmp_path, monkeypatch):
    with dg.DagsterInstance.local_temp(str(tmp_path)) as made:
        monkeypatch.setattr(dg.DagsterInstance, "get", staticmethod(lambda: made))
        yield made


@pytest.fixture
def client(home):
    with MlflowTracker(home).records() as records:
        return records.client


@pytest.fixture
def frozen(home):
    found = sorted(versions(home).values(), key=lambda version: int(version.version))
    return [home / "frozen" / version.tags["artifact"] for version in found]


@pytest.fixture
def new(home):
    """Return an ensemble that is not registered yet, with middling figures."""
    (folder,) = (home / "new" / "frozen").iterdir()
    return folder.rename(home / "frozen" / folder.name)


def pointed(home):
    return FolderPointers(home=str(home)).folder(KEY)


def test_a_moved_alias_is_followed_and_figures_do_not_overrule_it(home, instance, client, frozen, new, capsys):
    client.set_registered_model_alias(MODEL_NAME, CHAMPION, "1")
    assert command.main(["list"]) == 0
    assert f"Dagster used {frozen[2].name}, and now follows" in capsys.readouterr().out
    assert pointed(home) == frozen[0]
    event = instance.get_latest_materialization_event(KEY).asset_materialization
    assert event.tags["dagster/data_version"] == frozen[0].name, "downstream assets become stale"
    for folder in (frozen[2], frozen[1]):
        check, used = publish(home, instance, folder)
        assert (check.passed, used) == (False, frozen[0])
        assert "version 1 was chosen by hand when version" in check.description
    check, used = publish(home, instance, new)
    assert (check.passed, used) == (True, new), "a newer one may follow"
    check, used = publish(home, instance, frozen[2])
    assert (check.passed, used) == (True, frozen[2]), "a decision by hand does not outlast its version"


def test_promotion_by_command_is_not_overruled_either(home, instance, frozen):
    assert command.main(["promote", "1", "--because", "safer"]) == 0
    check, used = publish(home, instance, frozen[2])
    assert (check.passed, used) == (False, frozen[0])
    assert versions(home)[frozen[0].name].tags["promoted"] == "safer"


@pytest.mark.parametrize("deleted", [False, True], ids=["alias removed", "version deleted"])
def test_without_a_champion_nothing_is_promoted_until_a_person_chooses(
    home, instance, client, frozen, new, deleted, capsys
):
    if deleted:
        client.delete_model_version(MODEL_NAME, "3")
    else:
        client.delete_registered_model_alias(MODEL_NAME, CHAMPION)
    assert command.main(["list"]) == 0
    shown = capsys.readouterr().out
    assert "no version is in use, since version 3" in shown
    assert "choose one: `make rollback`, or python -m pipelines.commands.registry promote" in shown
    assert f"Dagster still uses {frozen[2].name}" in shown
    assert "no version is in use" in check_decisions(dg.build_sensor_context(instance=instance), home)
    result = materialize(home, instance, new)
    assert not result.success
    assert not [event for event in result.all_events if event.is_step_up_for_retry]
    assert CHAMPION not in aliases(home)
    assert command.main(["rollback"]) == 0
    assert aliases(home)[CHAMPION] == frozen[1].name
    assert pointed(home) == frozen[1]
    if not deleted:
        check, used = publish(home, instance, frozen[2])
        assert (check.passed, used) == (False, frozen[1])
        assert "removed by hand" in check.description


def test_promotion_and_rollback_are_jobs_of_the_ui(home, instance, frozen):
    def run(job, **config):
        (op,) = (node.name for node in job.nodes)
        resources = {"registry": command.EnsembleRegistry(MlflowTracker(home))}
        run_config = {"ops": {op: {"config": config}}}
        bound = dg.Definitions(jobs=[job], resources=resources).resolve_job_def(job.name)
        return bound.execute_in_process(run_config=run_config, instance=instance, raise_on_error=False)

    assert run(operation.promote, version=1, because="safer").success
    assert pointed(home) == frozen[0]
    assert run(operation.rollback, because="no longer").success
    assert (pointed(home), aliases(home)[CHAMPION]) == (frozen[2], frozen[2].name)
    for config, message in (({"version": 99, "because": "why not"}, "has no version 99"), ({"version": 1}, "reason")):
        (failure,) = run(operation.promote, **config).get_step_failure_events()
        assert message in failure.step_failure_data.error.message


def test_making_the_ensemble_in_use_again_keeps_its_reason(home, instance, frozen):
    check, used = publish(home, instance, frozen[2])
    assert (check.passed, used) == (True, frozen[2])
    assert versions(home)[frozen[2].name].tags["promoted"] == "better"


def test_a_decision_that_waited_does_not_overrule_a_person(home, client, frozen, new, monkeypatch):
    monkeypatch.setenv("MLFLOW_TRACKING_URI", "http://127.0.0.1:9")
    away = command.EnsembleRegistry(MlflowTracker(home))
    away.tracker.register("i" * 64, new)
    assert away.decide(new, True, "better") == new
    monkeypatch.delenv("MLFLOW_TRACKING_URI")
    client.set_registered_model_alias(MODEL_NAME, CHAMPION, "1")
    assert command.EnsembleRegistry(MlflowTracker(home)).champion() == frozen[0]
    assert f"compared with {frozen[2].name}, but version 1" in versions(home)[new.name].tags["refused"]


def test_calls_wait_while_the_experiment_is_deleted(home, instance, client, new, capsys):
    experiment = client.get_experiment_by_name("deltasafe").experiment_id
    client.delete_experiment(experiment)
    publish(home, instance, new)
    assert len(list((home / "mlflow" / "pending").glob("*.json"))) == 2
    assert not (home / "mlflow" / "pending" / "refused").exists()
    assert command.main(["list"]) == 0
    assert f"MLFLOW_TRACKING_URI={tracking_uri(home)} mlflow experiments restore --experiment-id {experiment}" in (
        capsys.readouterr().out
    )
    client.restore_experiment(experiment)
    assert command.main(["replay"]) == 0
    assert versions(home)[new.name].tags["refused"].startswith("worse than")


def test_refused_calls_are_listed_and_sent_again(home, instance, new, capsys):
    hidden = new.rename(home / "hidden")
    MlflowTracker(home).register("i" * 64, new)
    assert command.main(["list"]) == 0
    assert f"register of {new}" in (shown := capsys.readouterr().out)
    assert "python -m pipelines.commands.registry retry" in shown
    hidden.rename(new)
    assert command.main(["retry"]) == 0
    assert "refused call" not in capsys.readouterr().out
    assert new.name in versions(home)


def test_an_asset_that_was_wiped_is_not_used(home, instance, frozen):
    publish(home, instance, frozen[2])
    pointers = FolderPointers(home=str(home))
    assert pointers.folder(KEY, instance=instance) == frozen[2]
    instance.wipe_assets([KEY])
    with pytest.raises(DataError, match="materialize champion first"):
        pointers.folder(KEY, instance=instance)
    publish(home, instance, frozen[2])
    assert pointers.folder(KEY, instance=instance) == frozen[2]


def test_an_ensemble_whose_folder_and_artifact_are_gone_is_one_sentence(home, instance, frozen, capsys):
    shutil.rmtree(frozen[2])
    shutil.rmtree(home / "mlflow" / "artifacts")
    result = materialize(home, instance, frozen[1])
    assert not result.success
    assert not [event for event in result.all_events if event.is_step_up_for_retry]
    assert command.main(["list"]) == 0
    assert "is missing, and so is its copy in MLflow" in capsys.readouterr().out


def test_a_copied_home_uses_its_own_artifacts(original, home, frozen):
    shutil.rmtree(frozen[2])
    with MlflowTracker(home).records() as records:
        for version in records.versions():
            assert str(original) not in f"{version.source} {records.client.get_run(version.run_id).info.artifact_uri}"
    mlflow.set_tracking_uri(tracking_uri(home))
    fetched = mlflow.artifacts.download_artifacts(f"models:/{MODEL_NAME}@{CHAMPION}")
    assert fetched.startswith(str(home))
    assert command.EnsembleRegistry(MlflowTracker(home)).champion() == frozen[2]
