"""What starts work by itself, look by look; the daemon itself runs in test_unattended."""

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
from pipelines.automation.lost_runs import fail_lost_runs
from pipelines.automation.sensors import all_sensors, look_at_images, look_at_scenes
from pipelines.jobs import ALL_MEMBERS
from pipelines.watched_folders import digest_of_folder
from tests.ensembles import write_hands

EVERYTHING = dg.AssetSelection.all() | dg.AssetSelection.all_asset_checks()
SCENES = pathlib.Path(__file__).parents[3] / "datasets" / "scenes"


class Looks:
    """A sensor asked again and again, with the cursor that it left."""

    def __init__(self, look, folder):
        self.look, self.folder, self.cursor = look, folder, None

    def __call__(self):
        result = self.look(dg.build_sensor_context(cursor=self.cursor), self.folder)
        self.cursor = result.cursor
        return result


@pytest.fixture
def hands(tmp_path):
    return write_hands(tmp_path / "hands")


def test_images_are_trained_on_once_they_are_at_rest(hands):
    look = Looks(look_at_images, hands)
    assert "waiting until it is at rest" in look().skip_reason.skip_message
    (request,) = look().run_requests
    assert request.run_key == digest_of_folder(hands)
    assert request.run_config == {"ops": {"raw_hands": {"config": {"folder": str(hands)}}}}
    assert ALL_MEMBERS.items() <= request.tags.items()
    assert look().skip_reason.skip_message == "nothing new"


def test_a_folder_that_is_being_written_to_is_left_alone(hands):
    look = Looks(look_at_images, hands)
    assert look().skip_reason.skip_message
    assert look().run_requests
    for part in range(3):  # a copy that takes its time
        (hands / "images" / "9.png").write_bytes(b"x" * (part + 1))
        assert "waiting" in look().skip_reason.skip_message


def test_a_changed_mask_is_a_change_and_a_touched_or_hidden_file_is_none(hands):
    look = Looks(look_at_images, hands)
    assert look().skip_reason.skip_message
    assert look().run_requests
    (hands / "masks" / "0.png").touch()
    (hands / "masks" / ".1.png.part").write_bytes(b"half")
    assert look().skip_reason.skip_message == "nothing new"
    shutil.copyfile(hands / "masks" / "1.png", hands / "masks" / "0.png")
    assert "waiting" in look().skip_reason.skip_message
    assert look().run_requests


def test_defective_images_are_named_and_not_trained_on(hands):
    (hands / "images" / "9.png").write_bytes(b"no picture")
    look = Looks(look_at_images, hands)
    look()
    assert "9.png" in look().skip_reason.skip_message
    assert look().skip_reason.skip_message == "nothing new", "and not complained about for ever"


def test_nothing_to_watch_is_no_error(tmp_path):
    assert "no images" in Looks(look_at_images, tmp_path / "none")().skip_reason.skip_message
    assert "no new scene" in Looks(look_at_scenes, tmp_path / "none")().skip_reason.skip_message


def test_a_new_scene_becomes_a_partition_when_it_is_complete(tmp_path):
    look = Looks(look_at_scenes, tmp_path)
    shutil.copytree(SCENES / "scene_000", tmp_path / "scene_000")
    assert look().skip_reason.skip_message
    (tmp_path / "scene_001").mkdir()  # being logged: its scene.json is written last
    shutil.copyfile(next((SCENES / "scene_001").glob("*.jpg")), tmp_path / "scene_001" / "image.jpg")
    result = look()
    (request,) = result.run_requests
    assert request.partition_key == "scene_000"
    assert request.run_config["ops"]["logged_scene"]["config"]["folder"] == str(tmp_path)
    (added,) = result.dynamic_partitions_requests
    assert (added.partitions_def_name, list(added.partition_keys)) == (scene_partitions.name, ["scene_000"])
    assert look().skip_reason.skip_message


def test_a_scene_that_cannot_be_read_is_named(tmp_path):
    shutil.copytree(SCENES / "scene_000", tmp_path / "scene_000")
    (tmp_path / "scene_000" / "scene.json").write_text("{}")
    look = Looks(look_at_scenes, tmp_path)
    look()
    assert "scene_000" in look().skip_reason.skip_message


def test_sensors_that_start_trainings_are_off_until_they_are_switched_on(tmp_path):
    running = {s.name for s in all_sensors(tmp_path) if s.default_status == dg.DefaultSensorStatus.RUNNING}
    assert running == {"lost_runs"}


# automation ------------------------------------------------------------------------------------------------------


def chain(version, check_passes=True):
    """An ensemble in use, behind a blocking check, and what follows from it."""

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
    def zealous_audit():
        return dg.AssetCheckResult(passed=True)

    return dg.Definitions([champion, fields, motions], asset_checks=[intact, zealous_audit])


def test_other_data_are_followed_in_one_go_and_the_same_data_made_again_are_not():
    with dg.DagsterInstance.ephemeral() as instance:
        cursor = None

        def requested(defs):
            nonlocal cursor
            result = dg.evaluate_automation_conditions(defs, instance, EVERYTHING, cursor=cursor)
            cursor = result.cursor
            return {r.key.to_user_string() for r in result.results if r.true_subset.size}

        def make(defs, *names, ok=True):
            job = defs.resolve_implicit_global_asset_job_def()
            keys = [dg.AssetKey(name) for name in names]
            assert job.execute_in_process(instance=instance, asset_selection=keys, raise_on_error=False).success == ok

        first = chain("ensemble-1")
        make(first, "champion", "fields", "motions")
        assert requested(first) == set()
        make(first, "champion")
        assert requested(first) == set(), "made again, the same ensemble"
        second = chain("ensemble-2")
        make(second, "champion")
        assert requested(second) == {"fields", "fields:zealous_audit", "motions"}, (
            "all in one go, with the check between them"
        )
        make(second, "fields", "motions")
        assert requested(second) == set()
        make(chain("ensemble-3"), "champion", "fields", "motions")
        assert requested(second) == set(), "one run of the whole chain has done it already"
        damaged = chain("ensemble-4", check_passes=False)
        make(damaged, "champion", ok=False)
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


def test_a_run_whose_process_was_killed_is_failed_and_others_are_not(tmp_path):
    with dg.DagsterInstance.local_temp(str(tmp_path)) as instance:
        killed = subprocess.Popen([sys.executable, "-c", "import time; time.sleep(600)"])
        lost, alive = started_run(instance, killed.pid), started_run(instance, os.getpid())
        assert fail_lost_runs(instance) == []
        killed.kill()
        while is_running(killed.pid):  # a zombie, as a killed child is until it is waited for
            time.sleep(0.01)
        assert fail_lost_runs(instance) == [lost]
        killed.wait()
        assert instance.get_run_by_id(lost).status == dg.DagsterRunStatus.FAILURE
        assert instance.get_run_by_id(alive).status == dg.DagsterRunStatus.STARTED
        assert fail_lost_runs(instance) == []


def test_a_run_whose_process_never_reports_itself_is_failed_after_a_while(tmp_path, monkeypatch):
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
