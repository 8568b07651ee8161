"""Decisions about ensembles (refuse, promote, roll back) with the real registry and the real asset."""

from types import SimpleNamespace

import dagster as dg
import pytest

from deltasafe.errors import DataError
from pipelines.commands import registry as command
from pipelines.storage.io_manager import FolderPointers
from pipelines.tracking.frozen_folder import frozen_folder
from pipelines.tracking.model_versions import CHALLENGER, CHAMPION, DEMOTED_TAG, MODEL_NAME
from pipelines.tracking.tracker import MlflowTracker
from tests.ensembles import freeze_constant, write_hands
from tests.registered import HANDS, aliases, publish, versions


@pytest.fixture(scope="module")
def home(tmp_path_factory):
    root = tmp_path_factory.mktemp("home")
    FolderPointers(home=str(root)).point(HANDS, write_hands(root / "test"))
    return root


@pytest.fixture(scope="module")
def frozen(home):
    """Ensembles from bad to good: the images are mostly background, and all pixels get the same logit."""
    return {name: freeze_constant(home, logit) for name, logit in (("bad", 1.0), ("good", -2.0), ("better", -3.0))}


@pytest.fixture(scope="module")
def instance(tmp_path_factory):
    with dg.DagsterInstance.local_temp(str(tmp_path_factory.mktemp("dagster"))) as made:
        yield made


@pytest.fixture
def run(home, instance, monkeypatch):
    """Run a command of the registry on this home."""
    monkeypatch.setattr(command, "prepare_home", lambda: home)
    monkeypatch.setattr(dg.DagsterInstance, "get", staticmethod(lambda: instance))
    return lambda *arguments: command.main(list(arguments))


@pytest.mark.filterwarnings("ignore")  # warnings of MLflow
def test_a_worse_ensemble_is_refused_another_promoted_and_taken_back_by_one_command(
    home, instance, frozen, run, capsys
):
    check, used = publish(home, instance, frozen["good"])
    assert (check.passed, used) == (True, frozen["good"])
    assert aliases(home) == {CHAMPION: frozen["good"].name}

    check, used = publish(home, instance, frozen["bad"])
    assert not check.passed
    assert check.severity == dg.AssetCheckSeverity.WARN
    assert "worse than" in check.description
    assert "NLL" in check.description
    assert used == frozen["good"], "downstream assets of this run use the champion"
    assert aliases(home) == {CHAMPION: frozen["good"].name, CHALLENGER: frozen["bad"].name}
    assert "worse than" in versions(home)[frozen["bad"].name].tags["refused"]

    check, used = publish(home, instance, frozen["better"])
    assert (check.passed, used) == (True, frozen["better"])
    assert aliases(home)[CHAMPION] == frozen["better"].name

    assert run("rollback", "--because", "saw gloves as background") == 0
    assert aliases(home)[CHAMPION] == frozen["good"].name
    assert "saw gloves as background" in capsys.readouterr().out
    assert FolderPointers(home=str(home)).folder(dg.AssetKey("champion")) == frozen["good"]
    event = instance.get_latest_materialization_event(dg.AssetKey("champion")).asset_materialization
    assert event.tags["dagster/data_version"] == frozen["good"].name, "downstream assets become stale"

    check, used = publish(home, instance, frozen["better"])
    assert (check.passed, used) == (False, frozen["good"]), "figures do not override a person"
    assert "saw gloves" in check.description

    number = str(versions(home)[frozen["better"].name].version)
    assert run("promote", number, "--because", "gloves were labeled wrongly") == 0
    assert aliases(home)[CHAMPION] == frozen["better"].name
    assert DEMOTED_TAG not in versions(home)[frozen["better"].name].tags
    assert len(versions(home)) == 3, "the same content keeps its version"


def test_a_version_that_does_not_exist_changes_nothing(home, frozen, run, capsys):
    before = aliases(home)
    assert run("promote", "99", "--because", "why not") == 1
    assert "no version 99" in capsys.readouterr().err
    assert aliases(home) == before


def test_rollback_in_a_new_home_is_refused(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(command, "prepare_home", lambda: tmp_path)
    assert command.main(["rollback"]) == 1
    assert "in use before" in capsys.readouterr().err


@pytest.mark.filterwarnings("ignore")  # warnings of MLflow
def test_rollback_skips_deleted_versions_and_changes_nothing_if_it_fails(tmp_path, instance, monkeypatch, capsys):
    monkeypatch.setattr(command, "prepare_home", lambda: tmp_path)
    monkeypatch.setattr(dg.DagsterInstance, "get", staticmethod(lambda: instance))
    first, second, third = (freeze_constant(tmp_path, logit) for logit in (1.0, -2.0, -3.0))
    tracker = MlflowTracker(tmp_path)
    for folder in (first, second, third):
        tracker.register("i" * 64, folder)
        tracker.call("promote", artifact=folder.name, because="better", by_hand=True)
    with tracker.records() as records:
        records.client.delete_model_version(MODEL_NAME, records.version_of(second.name).version)

    artifacts = tmp_path / "mlflow" / "artifacts"
    first.rename(tmp_path / "hidden-folder")
    artifacts.rename(tmp_path / "hidden-artifacts")
    assert command.main(["rollback"]) == 1
    assert f"{first}: is missing, and so is its copy in MLflow" in capsys.readouterr().err
    assert aliases(tmp_path) == {CHAMPION: third.name}
    assert DEMOTED_TAG not in versions(tmp_path)[third.name].tags

    (tmp_path / "hidden-artifacts").rename(artifacts)
    assert command.main(["rollback"]) == 0
    assert aliases(tmp_path) == {CHAMPION: first.name}
    assert DEMOTED_TAG in versions(tmp_path)[third.name].tags


def test_another_machine_fetches_the_champion_from_the_registry(home, frozen, tmp_path):
    from deltasafe.perception.artifact.frozen_ensemble import verify_artifact

    (found,) = [version for version in versions(home).values() if CHAMPION in version.aliases]
    for machine in (tmp_path / "one", tmp_path / "another"):  # the first download leaves the registry intact
        with MlflowTracker(home).records():
            fetched = frozen_folder(found, machine)
        assert fetched == machine / "frozen" / frozen["better"].name
        verify_artifact(fetched)
        assert [path.name for path in fetched.parent.iterdir()] == [fetched.name]


@pytest.mark.parametrize("name", ["", "../../elsewhere", "ensemble-0/../..", "/etc"])
def test_a_tag_cannot_lead_out_of_the_home(tmp_path, name):
    found = SimpleNamespace(name=MODEL_NAME, version="1", tags={"artifact": name})
    with pytest.raises(DataError, match="not registered by this project"):
        frozen_folder(found, tmp_path / "home")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.filterwarnings("ignore")
def test_without_a_server_the_local_copy_decides_and_the_decision_is_queued(home, frozen, monkeypatch):
    monkeypatch.setenv("MLFLOW_TRACKING_URI", "http://127.0.0.1:9")
    away = command.EnsembleRegistry(MlflowTracker(home))
    assert away.champion() == frozen["better"]
    assert away.decide(frozen["bad"], False, "worse") == frozen["better"]
    assert len(away.tracker.pending.files()) == 1
    monkeypatch.delenv("MLFLOW_TRACKING_URI")
    MlflowTracker(home).replay()
    assert versions(home)[frozen["bad"].name].tags["refused"] == "worse"
