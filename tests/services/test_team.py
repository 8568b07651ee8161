"""Machines of a team with separate homes share real servers: PostgreSQL, object store, MLflow."""

import json
import os
import pathlib
import subprocess
import sys
import threading
import time

import dagster as dg
import pytest

from deltasafe.compute.processes import stop_session
from pipelines.home import DATABASE_VARIABLE, TRACKING_VARIABLE, prepare_home
from pipelines.storage import shared_store
from pipelines.storage.io_manager import FolderPointers
from pipelines.storage.shared_store import (
    STORE_VARIABLE,
    ObjectError,
    StoreAwayError,
    manifest_of_folder,
    store_from_environment,
)
from pipelines.tracking.mlflow_server import ARTIFACTS_VARIABLE, BACKEND_VARIABLE, mlflow_command
from pipelines.tracking.registry import EnsembleRegistry
from pipelines.tracking.tracker import MlflowTracker
from tests.ensembles import freeze_constant
from tests.loopback import answers, free_ports
from tests.services.servers import PASSWORD, SECRET

ROOT = pathlib.Path(__file__).parents[2]
CHAMPION, MOTIONS = dg.AssetKey("champion"), dg.AssetKey("planned_motions")


@pytest.fixture
def team(database, s3, monkeypatch, request):
    """Set the environment that all machines of a team share; this process is one of them."""
    name = request.node.name[:40].replace("_", "-").strip("-")
    shared = {
        DATABASE_VARIABLE: database.database(name),
        STORE_VARIABLE: f"s3://team/{name}",
        "DELTASAFE_PRESET": "smoke",
        **s3.environment,
    }
    for variable, value in shared.items():
        monkeypatch.setenv(variable, value)
    for variable in ("DELTASAFE_HOME", "DAGSTER_HOME", TRACKING_VARIABLE, BACKEND_VARIABLE, ARTIFACTS_VARIABLE):
        monkeypatch.setenv(variable, "")  # so that monkeypatch restores it
        monkeypatch.delenv(variable)
    monkeypatch.setattr(shared_store, "_FIRST_WAIT_S", 0.1)
    shared_store._opened.cache_clear()


def machine(home, *made):
    """Run a job, or some of its assets, on a machine with that home."""
    environment = {**os.environ, "DELTASAFE_HOME": str(home)}
    run = [sys.executable, "-m", "tests.services.machine", *made]
    finished = subprocess.run(run, cwd=ROOT, env=environment, capture_output=True, text=True, check=False)
    assert finished.returncode == 0, finished.stdout[-2000:] + finished.stderr[-6000:]
    return json.loads(finished.stdout.splitlines()[-1])


def pointers(home):
    return FolderPointers(home=str(home))


def test_another_machine_continues_a_run_with_the_same_results(team, tmp_path):
    one, other, away = tmp_path / "one", tmp_path / "other", tmp_path / "away"
    pointers(one).point(CHAMPION, freeze_constant(one, -2.0))
    began = machine(one, "planning", "logged_scenes", "occupancy_fields")
    assert began["storage"] == "PostgresRunStorage"
    one.rename(away)
    continued = machine(other, "planning", "planned_motions")
    assert continued["runs"] == 2, "both machines write to one database"
    there = manifest_of_folder(pointers(other).folder(MOTIONS))
    away.rename(one)
    machine(one, "planning", "planned_motions")
    folder = pointers(one).folder(MOTIONS)
    assert folder.is_relative_to(one)
    here = manifest_of_folder(folder)
    assert {name: file["sha256"] for name, file in there["files"].items()} == {
        name: file["sha256"] for name, file in here["files"].items()
    }
    assert any(name.endswith("plan.png") for name in here["files"])
    for path in [*one.rglob("*"), *other.rglob("*")]:
        if path.is_file():
            data = path.read_bytes()
            assert not any(secret.encode() in data for secret in (PASSWORD, SECRET)), path
    for path in (other / "store").rglob("*.json"):
        assert str(tmp_path).encode() not in path.read_bytes(), f"{path} contains a path of one machine"


def written(home, version):
    folder = home / "store" / "made" / version
    folder.mkdir(parents=True)
    for number in range(12):
        (folder / f"{number}.txt").write_text(f"{version} {number}")
    return folder


def version_in(folder):
    texts = {path.read_text() for path in folder.iterdir()}
    assert len(texts) == 12
    (version,) = {text.partition(" ")[0] for text in texts}
    return version


def test_parallel_writers_and_a_reader_that_sees_complete_versions_only(team, tmp_path):
    key, seen, errors = dg.AssetKey("made"), [], []
    pointers(tmp_path / "a").point(key, written(tmp_path / "a", "a0"))

    def write(name):
        try:
            for number in range(1, 8):
                pointers(tmp_path / name).point(key, written(tmp_path / name, f"{name}{number}"))
        except Exception as error:
            errors.append(error)

    writers = [threading.Thread(target=write, args=(name,)) for name in "ab"]
    for writer in writers:
        writer.start()
    while any(writer.is_alive() for writer in writers):
        folder = pointers(tmp_path / "reader").folder(key)
        assert version_in(folder) == folder.name
        seen.append(folder.name)
    assert errors == []
    assert pointers(tmp_path / "reader").folder(key).name in ("a7", "b7")
    assert len(set(seen)) > 1


def test_a_damaged_object_is_named(team, tmp_path):
    key = dg.AssetKey("made")
    pointers(tmp_path / "a").point(key, written(tmp_path / "a", "a0"))
    store = store_from_environment()
    blob = store._files.find(f"{store._root}/blobs")[0]
    store._files.pipe_file(blob, b"a0 9")
    with pytest.raises(ObjectError, match=f"{blob.rpartition('/')[2]}: is damaged"):
        pointers(tmp_path / "b").folder(key)
    assert not (tmp_path / "b" / "store" / "made" / "a0").exists()


def test_a_short_outage_of_the_store_is_retried_and_a_long_one_reported(team, s3, tmp_path, monkeypatch):
    key = dg.AssetKey("made")
    pointers(tmp_path / "a").point(key, written(tmp_path / "a", "a0"))
    monkeypatch.setattr(shared_store, "_FIRST_WAIT_S", 1.0)
    s3.stop()
    back = threading.Timer(1.0, s3.start)
    back.start()
    pointers(tmp_path / "a").point(key, written(tmp_path / "a", "a1"))
    back.join()
    assert version_in(pointers(tmp_path / "b").folder(key)) == "a1"
    monkeypatch.setattr(shared_store, "_FIRST_WAIT_S", 0.01)
    s3.stop()
    try:
        with pytest.raises(StoreAwayError, match=r"s3://team/.* cannot be reached .* check that the store runs"):
            pointers(tmp_path / "a").point(key, written(tmp_path / "a", "a2"))
    finally:
        s3.start()
    monkeypatch.setattr(shared_store, "_FIRST_WAIT_S", 1.0)  # after a restart, it answers before it can read
    assert version_in(pointers(tmp_path / "c").folder(key)) == "a1"


@pytest.fixture
def mlflow(team, database, tmp_path, monkeypatch):
    """MLflow as `make ui` starts it, with PostgreSQL and the store for artifacts."""
    (port,) = free_ports(1)
    monkeypatch.setenv(BACKEND_VARIABLE, database.database(f"mlflow-{port}"))
    monkeypatch.setenv("MLFLOW_SERVER_ENABLE_JOB_EXECUTION", "false")
    command = mlflow_command(tmp_path / "server", port)
    assert PASSWORD not in " ".join(command)
    with (tmp_path / "mlflow.log").open("w") as log:
        process = subprocess.Popen(command, cwd=tmp_path, stdout=log, stderr=log, start_new_session=True)
    try:
        while not answers(f"http://127.0.0.1:{port}/health"):
            assert process.poll() is None, (tmp_path / "mlflow.log").read_text()[-4000:]
            time.sleep(0.2)
        yield
    finally:
        stop_session(process)


@pytest.mark.filterwarnings("ignore")  # warnings of MLflow
def test_another_machine_downloads_the_champion_from_mlflow(mlflow, tmp_path):
    one, other = tmp_path / "one", tmp_path / "other"
    frozen = freeze_constant(one, -2.0)
    registry = EnsembleRegistry(MlflowTracker(one))
    registry.tracker.register("i" * 64, frozen)
    registry.decide(frozen, True, "the first")
    assert registry.tracker.pending.files() == []
    fetched = EnsembleRegistry(MlflowTracker(other)).champion()
    assert fetched == other / "frozen" / frozen.name
    assert manifest_of_folder(fetched) == manifest_of_folder(frozen)
    store = store_from_environment()
    assert any(frozen.name in name for name in store._files.find(f"{store._root}/mlflow")), "artifacts are in the store"


def test_dagster_yaml_follows_the_database_variable(team, tmp_path, monkeypatch):
    monkeypatch.setenv("DELTASAFE_HOME", str(tmp_path))
    settings = prepare_home() / "dagster" / "dagster.yaml"
    assert DATABASE_VARIABLE in settings.read_text()
    monkeypatch.delenv(DATABASE_VARIABLE)
    prepare_home()
    assert DATABASE_VARIABLE not in settings.read_text(), "the default file is updated"
