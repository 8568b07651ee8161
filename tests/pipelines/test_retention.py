"""Retention: what is in use is kept, the rest is shown and deleted."""

import pathlib
import shutil
import sys

import dagster as dg
import pytest

from deltasafe.errors import SettingsError
from pipelines import operation
from pipelines.retention import Retention, RetentionSettings
from pipelines.storage.io_manager import FolderPointers
from pipelines.storage.shared_store import STORE_VARIABLE
from pipelines.tracking.model_versions import CHAMPION, MODEL_NAME
from pipelines.tracking.registry import EnsembleRegistry
from pipelines.tracking.tracker import MlflowTracker
from tests.registered import aliases, light_registration, versions

pytestmark = pytest.mark.filterwarnings("ignore")  # warnings of MLflow
LITTLE = RetentionSettings(runs=1, days=0.0, versions=1)


@pytest.fixture
def instance(tmp_path):
    (tmp_path / "dagster").mkdir()
    with dg.DagsterInstance.local_temp(str(tmp_path / "dagster")) as made:
        yield made


def make(home, instance, *names):
    """Make assets in one run, each with a folder in the store as the chain names it; return the run id."""

    def asset(name):
        @dg.asset(name=name)
        def made(context: dg.AssetExecutionContext) -> pathlib.Path:
            folder = home / "store" / name / context.run.run_id[:8]
            folder.mkdir(parents=True)
            (folder / "data").write_bytes(bytes(1000))
            folder.with_name(f"{folder.name}-sheet.png").touch()
            return folder

        return made

    @dg.asset_check(asset=names[0])
    def fine():
        return dg.AssetCheckResult(passed=True)

    resources = {"io_manager": FolderPointers(home=str(home))}
    return dg.materialize([*map(asset, names), fine], instance=instance, resources=resources).run_id


def test_what_a_pointer_or_a_kept_run_refers_to_stays_and_the_rest_goes(tmp_path, instance):
    first = make(tmp_path, instance, "planned_motions", "logged_scenes")
    runs = [make(tmp_path, instance, "planned_motions") for _ in range(3)]
    study, shared = tmp_path / "store" / "study_cell" / "abc", tmp_path / "store" / "ensemble_member" / "old"
    for folder in (study, shared):
        folder.mkdir(parents=True)
    check = dg.AssetCheckKey(dg.AssetKey("planned_motions"), "fine")
    retention = Retention(tmp_path, instance, LITTLE, [check])
    before = {run.run_id for run in instance.get_runs()}
    found = retention.survey()
    assert {run.run_id for run in instance.get_runs()} == before, "the survey deletes nothing"
    assert {each.name for each in found if each.part == "dagster"} == set(runs[:2])
    motions = {each.name for each in found if each.part == "store/planned_motions"}
    assert motions == {run[:8] for run in runs[:2]}, "the first run is kept for its scenes, and so are its motions"
    assert [each.name for each in found if each.part == "store/ensemble_member"] == ["old"]
    rows = {row["part"]: row for row in retention.disk_use(found)}
    assert rows["store/planned_motions"]["deletable"] == 2
    assert rows["all"]["deletable"] == len(found)

    retention.prune(found)
    assert {run.run_id for run in instance.get_runs()} == {first, runs[2]}
    assert sorted(path.name for path in (tmp_path / "pointers" / "runs").iterdir()) == sorted([first, runs[2]])
    assert not [path for run in runs[:2] for path in tmp_path.rglob(f"*{run}*")]
    assert {path.name[:8] for path in (tmp_path / "store" / "planned_motions").iterdir()} == {first[:8], runs[2][:8]}
    assert study.is_dir()
    pointers = FolderPointers(home=str(tmp_path))
    for name in ("planned_motions", "logged_scenes"):
        assert instance.get_latest_materialization_event(dg.AssetKey(name)) is not None
        assert pointers.folder(dg.AssetKey(name), instance=instance).is_dir()
    assert Retention(tmp_path, instance, LITTLE, [check]).survey() == []


def test_what_is_young_or_belongs_to_a_run_in_progress_stays(tmp_path, instance):
    for _ in range(3):
        make(tmp_path, instance, "planned_motions")
    assert Retention(tmp_path, instance, RetentionSettings(runs=0, days=1.0, versions=0)).survey() == []

    @dg.job
    def work():
        pass

    running = instance.create_run_for_job(work, status=dg.DagsterRunStatus.STARTED).run_id
    used = tmp_path / "store" / "executed_motions" / f"scene-{running[:8]}"
    for folder in (used, tmp_path / "store" / "ensemble_member" / "in training"):
        folder.mkdir(parents=True)
    parts = {each.part for each in Retention(tmp_path, instance, LITTLE).survey()}
    assert parts == {"dagster", "store/planned_motions"}


def test_the_latest_result_of_every_check_of_the_project_is_kept(tmp_path, instance):
    from pipelines.build import build_defs

    expected = build_defs(tmp_path).resolve_asset_graph().asset_check_keys
    assert set(Retention(tmp_path, instance, LITTLE)._checks) == set(expected)


def test_an_interrupted_deletion_is_finished(tmp_path, instance):
    (tmp_path / "store" / "planned_motions" / ".0123abcd.removed").mkdir(parents=True)
    retention = Retention(tmp_path, instance, LITTLE)
    retention.prune(retention.survey())
    assert list((tmp_path / "store" / "planned_motions").iterdir()) == []


def test_versions_that_matter_stay_with_all_that_they_refer_to(tmp_path, instance, monkeypatch):
    light_registration(monkeypatch)
    tracker = MlflowTracker(tmp_path, {"dagster_run_id": "deleted"})
    registry, folders = EnsembleRegistry(tracker), []
    for number, is_better in enumerate([True, False, True, True, False]):
        folder = tmp_path / "frozen" / f"ensemble-{number:016x}"
        folder.mkdir(parents=True)
        (folder / "weights").write_bytes(bytes(1000))
        tracker.register(f"{number}" * 64, folder)
        registry.decide(folder, is_better, "measured")
        folders.append(folder)
    with tracker.records() as records:
        trash = records.client.create_experiment("of a user", (tmp_path / "elsewhere").as_uri())
        records.client.delete_experiment(trash)
        records.client.create_run(records.experiment, run_name="of a user")

    retention = Retention(tmp_path, instance, LITTLE)
    found = retention.survey()
    assert [each.name for each in found if each.part == "frozen"] == [folder.name for folder in folders[:3]]
    retention.prune(found)
    assert set(versions(tmp_path)) == {folder.name for folder in folders[3:]}
    assert aliases(tmp_path) == {CHAMPION: folders[3].name, "challenger": folders[4].name}
    assert sorted((tmp_path / "frozen").iterdir()) == folders[3:]
    assert len(list((tmp_path / "mlflow" / "artifacts").rglob("weights"))) == 2
    shutil.rmtree(folders[3])
    import mlflow

    fetched = mlflow.artifacts.download_artifacts(f"models:/{MODEL_NAME}@{CHAMPION}", dst_path=str(tmp_path / "new"))
    assert list(pathlib.Path(fetched).rglob("weights"))
    with tracker.records() as records:
        records.client.restore_experiment(trash)
        runs = records.client.search_runs([records.experiment])
    assert sum(run.info.run_name == "of a user" for run in runs) == 1
    assert len(runs) == 3
    assert Retention(tmp_path, instance, LITTLE).survey() == []


@pytest.mark.parametrize(("variable", "value"), [("RUNS", "many"), ("RUNS", "-1"), ("DAYS", "x"), ("VERSIONS", "1.5")])
def test_a_wrong_setting_is_named(variable, value):
    with pytest.raises(SettingsError, match=r"number|at least 0"):
        RetentionSettings.from_environment({f"DELTASAFE_KEEP_{variable}": value})


def test_nothing_is_deleted_from_a_home_that_shares_its_artifacts(tmp_path, instance, monkeypatch):
    monkeypatch.setenv(STORE_VARIABLE, "file:///mnt/team")
    with pytest.raises(SettingsError, match="shares its artifacts"):
        Retention(tmp_path, instance, LITTLE)


def test_the_asset_shows_disk_use_and_deletes_only_if_told(tmp_path, instance, monkeypatch):
    monkeypatch.setenv("DELTASAFE_HOME", str(tmp_path))
    old = make(tmp_path, instance, "planned_motions")
    make(tmp_path, instance, "planned_motions")
    keep = {"keep_runs": 0, "keep_days": 0.0}
    for delete in (False, True):
        config = {"ops": {"disk_space": {"config": {**keep, "delete": delete}}}}
        result = dg.materialize([operation.disk_space], instance=instance, run_config=config)
        (event,) = result.asset_materializations_for_node("disk_space")
        parts = [record.data["part"] for record in event.metadata["disk use"].records]
        assert {"store/planned_motions", "dagster", "all"} <= set(parts)
        assert old in event.metadata["deleted" if delete else "deletable"].value
        assert (instance.get_run_by_id(old) is None) == delete


def test_a_failed_run_runs_the_alert_command(tmp_path, instance, monkeypatch):
    @dg.op
    def broken():
        raise RuntimeError("out of order")

    @dg.job
    def work():
        broken()

    result = work.execute_in_process(instance=instance, raise_on_error=False)
    (event,) = (event for event in result.all_events if event.is_run_failure)
    context = dg.build_run_status_sensor_context(
        "failed_runs", event, instance, dagster_run=result.dagster_run
    ).for_run_failure()
    assert "is not set" in operation.failed_runs(context).skip_message
    program = f"import os, pathlib; pathlib.Path({str(tmp_path / 'told')!r}).write_text(os.environ['DELTASAFE_RUN'])"
    (tmp_path / "alert.py").write_text(program)
    monkeypatch.setenv(operation.ALERT_VARIABLE, f"{sys.executable} {tmp_path / 'alert.py'}")
    assert "status 0" in operation.failed_runs(context).skip_message
    assert (tmp_path / "told").read_text().endswith(f"/runs/{result.run_id}")
