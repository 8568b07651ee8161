"""Promotion is a gate: refused, promoted, rolled back, on the real registry with the real asset."""

from types import SimpleNamespace

import dagster as dg
import pytest

from assets.perception import champion
from deltasafe.errors import DataError
from pipelines.home import tracking_uri
from pipelines.resources import RegistryResource, StoreResource
from pipelines.storage.io_manager import FolderPointers
from pipelines.tracking import registry as command
from pipelines.tracking.mlflow_records import CHALLENGER, CHAMPION, MODEL_NAME
from pipelines.tracking.tracker import MlflowTracker
from tests.ensembles import freeze_constant, write_hands

HANDS = dg.AssetKey("test_hands")
FROZEN = dg.AssetKey("frozen_ensemble")


@pytest.fixture(scope="module")
def home(tmp_path_factory):
    root = tmp_path_factory.mktemp("home")
    FolderPointers(home=str(root)).point(HANDS, write_hands(root / "test"))
    return root


@pytest.fixture(scope="module")
def frozen(home):
    """From bad to good: mostly background, all pixels get the same logit."""
    return {name: freeze_constant(home, logit) for name, logit in (("bad", 1.0), ("good", -2.0), ("better", -3.0))}


@pytest.fixture(scope="module")
def instance(tmp_path_factory):
    with dg.DagsterInstance.local_temp(str(tmp_path_factory.mktemp("dagster"))) as made:
        yield made


@pytest.fixture
def run(home, instance, monkeypatch):
    """The command, on this home."""
    monkeypatch.setattr(command, "prepare_home", lambda: home)
    monkeypatch.setattr(dg.DagsterInstance, "get", staticmethod(lambda: instance))
    return lambda *arguments: command.main(list(arguments))


def publish(home, instance, folder):
    """What the chain does with a newly frozen ensemble; the check and the folder in use."""
    MlflowTracker(home).register("i" * 64, folder)
    FolderPointers(home=str(home)).point(FROZEN, folder)
    resources = {
        "io_manager": FolderPointers(home=str(home)),
        "store": StoreResource(home=str(home), datasets=str(home)),
        "registry": RegistryResource(home=str(home)),
    }
    upstream = [dg.AssetSpec(FROZEN), dg.AssetSpec(HANDS)]
    result = dg.materialize([champion, *upstream], resources=resources, instance=instance)
    (check,) = result.get_asset_check_evaluations()
    return check, FolderPointers(home=str(home)).folder(dg.AssetKey("champion"), run_id=result.run_id)


def aliases(home):
    from mlflow import MlflowClient

    client = MlflowClient(tracking_uri(home))
    found = client.get_registered_model(MODEL_NAME).aliases
    return {alias: client.get_model_version(MODEL_NAME, number).tags["artifact"] for alias, number in found.items()}


def versions(home):
    with MlflowTracker(home).records() as records:
        return {found.tags["artifact"]: found for found in records.versions()}


@pytest.mark.filterwarnings("ignore")  # of MLflow's own making
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
    assert used == frozen["good"], "what follows in this run works with the champion"
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
    assert event.tags["dagster/data_version"] == frozen["good"].name, "what follows is told"

    check, used = publish(home, instance, frozen["better"])
    assert (check.passed, used) == (False, frozen["good"]), "figures do not overrule a person"
    assert "saw gloves" in check.description

    number = str(versions(home)[frozen["better"].name].version)
    assert run("promote", number, "--because", "gloves were labeled wrongly") == 0
    assert aliases(home)[CHAMPION] == frozen["better"].name
    assert "taken_out_of_use" not in versions(home)[frozen["better"].name].tags
    assert len(versions(home)) == 3, "the same content is the same version"


def test_a_version_that_does_not_exist_changes_nothing(home, frozen, run, capsys):
    before = aliases(home)
    assert run("promote", "99", "--because", "why not") == 1
    assert "no version 99" in capsys.readouterr().err
    assert aliases(home) == before


def test_there_is_nothing_to_roll_back_to_in_a_fresh_home(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(command, "prepare_home", lambda: tmp_path)
    assert command.main(["rollback"]) == 1
    assert "in use before" in capsys.readouterr().err


def test_another_machine_fetches_the_champion_from_the_registry(home, frozen, tmp_path):
    from deltasafe.perception.artifact.frozen_ensemble import verify_artifact

    (found,) = [version for version in versions(home).values() if CHAMPION in version.aliases]
    for machine in (tmp_path / "one", tmp_path / "another"):  # the first takes nothing away
        with MlflowTracker(home).records():
            fetched = command._folder_of(found, machine)
        assert fetched == machine / "frozen" / frozen["better"].name
        verify_artifact(fetched)
        assert [path.name for path in fetched.parent.iterdir()] == [fetched.name]


@pytest.mark.parametrize("name", ["", "../../elsewhere", "ensemble-0/../..", "/etc"])
def test_a_registry_cannot_lead_out_of_the_home(tmp_path, name):
    found = SimpleNamespace(name=MODEL_NAME, version="1", tags={"artifact": name})
    with pytest.raises(DataError, match="not registered by this project"):
        command._folder_of(found, tmp_path / "home")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.filterwarnings("ignore")
def test_without_a_server_the_note_says_who_is_in_use_and_the_decision_waits(home, frozen, monkeypatch):
    monkeypatch.setenv("MLFLOW_TRACKING_URI", "http://127.0.0.1:9")
    away = command.EnsembleRegistry(MlflowTracker(home))
    assert away.champion() == frozen["better"]
    assert away.decide(frozen["bad"], False, "worse") == frozen["better"]
    assert len(away.tracker.pending.files()) == 1
    monkeypatch.delenv("MLFLOW_TRACKING_URI")
    MlflowTracker(home).replay()
    assert versions(home)[frozen["bad"].name].tags["refused"] == "worse"
