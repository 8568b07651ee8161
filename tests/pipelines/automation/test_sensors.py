"""Sensors and automation conditions, tick by tick; test_unattended runs the real daemon."""

import os
import pathlib
import shutil
import subprocess
import sys
import time

import dagster as dg
import pytest

from assets.policies import ON_NEW_ASSET, ON_NEW_DATA
from assets.single_scene import scenes as scene_partitions
from deltasafe.compute.processes import is_running
from pipelines import watched_folders
from pipelines.automation.lost_runs import fail_lost_runs
from pipelines.automation.sensors import all_sensors, check_images, check_scenes
from pipelines.jobs import ALL_MEMBERS
from pipelines.watched_folders import digest_of_folder
from tests.ensembles import write_hands

EVERYTHING = dg.AssetSelection.all() | dg.AssetSelection.all_asset_checks()
SCENES = pathlib.Path(__file__).parents[3] / "datasets" / "scenes"


class Ticks:
    """Calls a sensor again and again with its own cursor."""

    def __init__(self, check, folder):
        self.check, self.folder, self.cursor = check, folder, None
        self.memory = folder.parent / f".memory of {folder.name}"

    def __call__(self):
        result = self.check(dg.build_sensor_context(cursor=self.cursor), self.folder, self.memory)
        self.cursor = result.cursor
        assert len(self.cursor) < 100, "Dagster keeps the cursor of every tick"
        return result

    def skips(self):
        return self().skip_reason.skip_message


@pytest.fixture
def hands(tmp_path):
    return write_hands(tmp_path / "hands")


def test_settled_images_start_one_training(hands):
    tick = Ticks(check_images, hands)
    assert "waiting until it is settled" in tick().skip_reason.skip_message
    (request,) = tick().run_requests
    assert digest_of_folder(hands) in request.run_key
    assert request.run_config == {"ops": {"raw_hands": {"config": {"folder": str(hands)}}}}
    assert ALL_MEMBERS.items() <= request.tags.items()
    assert tick().skip_reason.skip_message == "nothing new"


def test_a_folder_that_returns_to_an_earlier_content_is_trained_on_again(hands):
    tick, keys = Ticks(check_images, hands), []
    original = (hands / "masks" / "0.png").read_bytes()
    for content in (original, (hands / "masks" / "1.png").read_bytes(), original):
        (hands / "masks" / "0.png").write_bytes(content)
        tick()
        (request,) = tick().run_requests
        keys.append(request.run_key)
    assert len(set(keys)) == 3


def test_a_changing_folder_starts_nothing(hands):
    tick = Ticks(check_images, hands)
    assert tick().skip_reason.skip_message
    assert tick().run_requests
    for part in range(3):  # a slow copy
        (hands / "images" / "9.png").write_bytes(b"x" * (part + 1))
        assert "waiting" in tick().skip_reason.skip_message


def test_a_changed_mask_counts_and_touched_or_hidden_files_do_not(hands):
    tick = Ticks(check_images, hands)
    assert tick().skip_reason.skip_message
    assert tick().run_requests
    (hands / "masks" / "0.png").touch()
    (hands / "masks" / ".1.png.part").write_bytes(b"half")
    assert "waiting" in tick.skips()
    assert tick.skips() == "nothing new"
    shutil.copyfile(hands / "masks" / "1.png", hands / "masks" / "0.png")
    assert "waiting" in tick().skip_reason.skip_message
    assert tick().run_requests


def test_a_defect_is_named_in_every_tick_until_it_is_mended(hands):
    defective = hands / "images" / "9.png"
    defective.write_bytes(b"not an image")
    tick = Ticks(check_images, hands)
    tick()
    for _ in range(3):
        assert "9.png" in tick.skips()
    defective.unlink()
    assert "waiting" in tick.skips()
    assert tick().run_requests
    assert tick.skips() == "nothing new"


def test_only_changed_files_are_read_and_only_when_they_are_settled(hands, monkeypatch):
    read = []
    real = watched_folders.sha256_of_file
    monkeypatch.setattr(watched_folders, "sha256_of_file", lambda path: read.append(path.name) or real(path))
    tick = Ticks(check_images, hands)
    tick()
    assert read == []
    assert tick().run_requests
    assert sorted(read) == sorted(path.name for path in hands.rglob("*.*"))
    read.clear()
    for _ in range(3):
        assert tick.skips() == "nothing new"
    (hands / "masks" / "0.png").write_bytes((hands / "masks" / "1.png").read_bytes())
    stat = (hands / "masks" / "1.png").stat()
    os.utime(hands / "masks" / "0.png", ns=(stat.st_atime_ns, stat.st_mtime_ns))  # the change time still differs
    tick()
    assert tick().run_requests
    assert read == ["0.png"]


def test_a_large_folder_is_read_over_several_ticks(hands, monkeypatch):
    monkeypatch.setattr("pipelines.automation.sensors._READING_S", 0.0)
    tick = Ticks(check_images, hands)
    tick()
    reasons = []
    while not (result := tick()).run_requests:
        reasons.append(result.skip_reason.skip_message)
    assert len(reasons) == len(list(hands.rglob("*.*"))) - 1
    assert all("the next tick continues" in reason for reason in reasons)
    assert digest_of_folder(hands) in result.run_requests[0].run_key


def test_a_failed_tick_is_repeated(hands):
    """Dagster keeps the old cursor if a tick fails after the sensor function: its state must still exist."""
    tick = Ticks(check_images, hands)
    tick()
    before = tick.cursor
    (lost,) = tick().run_requests
    tick.cursor = before
    (again,) = tick().run_requests
    assert again.run_key == lost.run_key


def test_a_missing_folder_is_no_error(tmp_path):
    assert "no images" in Ticks(check_images, tmp_path / "none")().skip_reason.skip_message
    assert "no new settled scene" in Ticks(check_scenes, tmp_path / "none")().skip_reason.skip_message


def test_a_complete_scene_becomes_a_partition(tmp_path):
    tick = Ticks(check_scenes, tmp_path)
    shutil.copytree(SCENES / "scene_000", tmp_path / "scene_000")
    assert tick().skip_reason.skip_message
    (tmp_path / "scene_001").mkdir()  # still being logged: scene.json is written last
    shutil.copyfile(next((SCENES / "scene_001").glob("*.jpg")), tmp_path / "scene_001" / "image.jpg")
    result = tick()
    (request,) = result.run_requests
    assert request.partition_key == "scene_000"
    assert request.run_config["ops"]["logged_scene"]["config"]["folder"] == str(tmp_path)
    (new,) = result.dynamic_partitions_requests
    assert (new.partitions_def_name, list(new.partition_keys)) == (scene_partitions.name, ["scene_000"])
    assert tick().skip_reason.skip_message


def test_an_unreadable_scene_is_named(tmp_path):
    shutil.copytree(SCENES / "scene_000", tmp_path / "scene_000")
    (tmp_path / "scene_000" / "scene.json").write_text("{}")
    tick = Ticks(check_scenes, tmp_path)
    tick()
    for _ in range(2):
        assert "scene_000" in tick.skips()
    shutil.copyfile(SCENES / "scene_000" / "scene.json", tmp_path / "scene_000" / "scene.json")
    tick()
    assert [request.partition_key for request in tick().run_requests] == ["scene_000"]


def test_only_sensors_that_start_nothing_are_on_by_default(tmp_path):
    running = {s.name for s in all_sensors(tmp_path) if s.default_status == dg.DefaultSensorStatus.RUNNING}
    assert running == {"lost_runs", "decisions_in_mlflow", "stale_partitions"}


# automation ------------------------------------------------------------------------------------------------------


def chain(version, check_passes=True):
    """Build a champion with a blocking check, and two downstream assets."""

    @dg.asset
    def champion():
        return dg.MaterializeResult(data_version=dg.DataVersion(version))

    @dg.asset_check(asset=champion, blocking=True)
    def intact():
        return dg.AssetCheckResult(passed=check_passes)

    @dg.asset(deps=[champion], automation_condition=ON_NEW_DATA)
    def fields():
        return dg.MaterializeResult()

    @dg.asset(deps=[fields, champion], automation_condition=ON_NEW_DATA)
    def motions():
        return dg.MaterializeResult()

    @dg.asset_check(asset=fields, blocking=True, automation_condition=ON_NEW_ASSET)
    def audit():
        return dg.AssetCheckResult(passed=True)

    return dg.Definitions([champion, fields, motions], asset_checks=[intact, audit])


def test_a_new_data_version_requests_all_downstream_assets_at_once():
    with dg.DagsterInstance.ephemeral() as instance:
        cursor = None

        def requested(defs):
            nonlocal cursor
            result = dg.evaluate_automation_conditions(defs, instance, EVERYTHING, cursor=cursor)
            cursor = result.cursor
            return {r.key.to_user_string() for r in result.results if r.true_subset.size}

        def materialize(defs, *names, ok=True):
            job = defs.resolve_implicit_global_asset_job_def()
            keys = [dg.AssetKey(name) for name in names]
            assert job.execute_in_process(instance=instance, asset_selection=keys, raise_on_error=False).success == ok

        first = chain("ensemble-1")
        materialize(first, "champion", "fields", "motions")
        assert requested(first) == set()
        materialize(first, "champion")
        assert requested(first) == set(), "the same data version again"
        second = chain("ensemble-2")
        materialize(second, "champion")
        assert requested(second) == {"fields", "fields:audit", "motions"}, "together with the check between them"
        materialize(second, "fields", "motions")
        assert requested(second) == set()
        materialize(chain("ensemble-3"), "champion", "fields", "motions")
        assert requested(second) == set(), "a run of the whole chain has made them already"
        damaged = chain("ensemble-4", check_passes=False)
        materialize(damaged, "champion", ok=False)
        assert requested(damaged) == set(), "a blocking check failed"


# lost runs -------------------------------------------------------------------------------------------------------


def started_run(instance, pid):
    @dg.job
    def work():
        pass

    run = instance.create_run_for_job(work, status=dg.DagsterRunStatus.STARTED)
    data = dg._core.events.EngineEventData.in_process(pid)
    instance.report_engine_event("Started process for run", run, data)
    return run.run_id


def test_only_the_run_of_a_killed_process_fails(tmp_path):
    with dg.DagsterInstance.local_temp(str(tmp_path)) as instance:
        killed = subprocess.Popen([sys.executable, "-c", "import time; time.sleep(600)"])
        lost, alive = started_run(instance, killed.pid), started_run(instance, os.getpid())
        assert fail_lost_runs(instance) == []
        killed.kill()
        while is_running(killed.pid):  # until it is a zombie
            time.sleep(0.01)
        assert fail_lost_runs(instance) == [lost]
        killed.wait()
        assert instance.get_run_by_id(lost).status == dg.DagsterRunStatus.FAILURE
        assert instance.get_run_by_id(alive).status == dg.DagsterRunStatus.STARTED
        assert fail_lost_runs(instance) == []


def test_a_starting_run_without_a_process_fails_after_a_timeout(tmp_path, monkeypatch):
    @dg.job
    def work():
        pass

    with dg.DagsterInstance.local_temp(str(tmp_path)) as instance:
        silent = instance.create_run_for_job(work, status=dg.DagsterRunStatus.STARTING).run_id
        waiting = instance.create_run_for_job(work, status=dg.DagsterRunStatus.NOT_STARTED).run_id
        assert fail_lost_runs(instance) == []
        monkeypatch.setattr("pipelines.automation.lost_runs._SILENT_S", 0.0)
        assert fail_lost_runs(instance) == [silent]
        assert instance.get_run_by_id(waiting).status == dg.DagsterRunStatus.NOT_STARTED
