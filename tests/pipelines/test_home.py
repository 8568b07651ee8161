"""The home: its `dagster.yaml`, its database, errors, and runs of other machines."""

import importlib.util
import platform

import dagster as dg
import pytest
import yaml

from deltasafe.errors import DataError, SettingsError
from pipelines import home
from pipelines.automation.lost_runs import fail_lost_runs
from pipelines.home import DATABASE_VARIABLE, prepare_home
from pipelines.supervision import MACHINE_TAG, supervised

ADDRESS = "postgresql+psycopg2://user:secret@127.0.0.1:1/dagster"


@pytest.fixture
def settings(tmp_path, monkeypatch):
    for variable in ("DAGSTER_HOME", DATABASE_VARIABLE):
        monkeypatch.setenv(variable, "")
    monkeypatch.setenv("DELTASAFE_HOME", str(tmp_path))
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: object())
    return tmp_path / "dagster" / "dagster.yaml"


def test_the_database_is_added_and_removed_with_its_variable(settings, monkeypatch):
    prepare_home()
    default = settings.read_text()
    assert "storage" not in default
    monkeypatch.setenv(DATABASE_VARIABLE, ADDRESS)
    prepare_home()
    assert settings.read_text().startswith(default)
    assert f"env: {DATABASE_VARIABLE}" in settings.read_text()
    assert "secret" not in settings.read_text()
    monkeypatch.setenv(DATABASE_VARIABLE, "")
    prepare_home()
    assert settings.read_text() == default


def test_an_edited_file_is_kept_and_must_name_the_database(settings, monkeypatch):
    settings.parent.mkdir()
    settings.write_text("telemetry: {enabled: false}\n")
    prepare_home()
    monkeypatch.setenv(DATABASE_VARIABLE, ADDRESS)
    with pytest.raises(DataError, match=f"was edited and does not use {DATABASE_VARIABLE}"):
        prepare_home()
    edited = f"storage: {{postgres: {{postgres_url: {{env: {DATABASE_VARIABLE}}}}}}}\n"
    settings.write_text(edited)
    prepare_home()
    assert settings.read_text() == edited


def test_an_invalid_address_is_refused_without_showing_it(settings, monkeypatch):
    monkeypatch.setenv(DATABASE_VARIABLE, "postgresql://user:secret@127.0.0.1/dagster")
    with pytest.raises(SettingsError, match=r"the form postgresql\+psycopg2://USER:PASSWORD") as caught:
        prepare_home()
    assert "secret" not in str(caught.value)
    monkeypatch.setenv(DATABASE_VARIABLE, ADDRESS)
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    with pytest.raises(SettingsError, match="make team"):
        prepare_home()
    assert not settings.exists()


def test_a_file_that_was_written_here_is_updated(settings):
    settings.parent.mkdir()
    settings.write_text("# an earlier comment\n" + yaml.safe_dump(home._FIRST_SETTINGS))
    prepare_home()
    assert settings.read_text() == home._DAGSTER_YAML


def test_a_file_that_is_not_yaml_is_named(settings):
    settings.parent.mkdir()
    settings.write_text("a: [")
    with pytest.raises(DataError, match=r"dagster\.yaml: is not YAML .* correct it, or delete it"):
        prepare_home()


def test_a_home_that_is_a_file_is_refused(tmp_path, monkeypatch):
    (tmp_path / "file").touch()
    for path in ("file", "file/below"):
        monkeypatch.setenv("DELTASAFE_HOME", str(tmp_path / path))
        with pytest.raises(DataError, match=f"{path}: is not a folder, or is below a file; set DELTASAFE_HOME"):
            prepare_home()


def test_an_unknown_preset_creates_no_home(settings, monkeypatch):
    monkeypatch.setenv("DELTASAFE_PRESET", "papre")
    with pytest.raises(SettingsError, match="'papre' is not a preset"):
        prepare_home()
    assert not settings.parent.exists()


@dg.op
def nothing():
    pass


def test_runs_of_another_machine_are_not_failed(tmp_path, monkeypatch):
    @dg.job
    def work():
        nothing()

    unused_pid = 2**22 + 1  # above the maximum PID
    with dg.DagsterInstance.local_temp(str(tmp_path)) as instance:

        def started(**tags):
            run = instance.create_run_for_job(work, status=dg.DagsterRunStatus.STARTED, tags=tags)
            data = dg._core.events.EngineEventData.in_process(unused_pid)
            instance.report_engine_event("Started process for run", run, data)
            return run.run_id

        mine, other = started(**{MACHINE_TAG: platform.node()}), started(**{MACHINE_TAG: "elsewhere"})
        untagged = started()
        monkeypatch.setenv(DATABASE_VARIABLE, ADDRESS)
        assert fail_lost_runs(instance) == [mine]
        monkeypatch.delenv(DATABASE_VARIABLE)
        assert set(fail_lost_runs(instance)) == {other, untagged}, (
            "without a shared database, all runs are of this machine"
        )


def test_runs_are_tagged_with_their_machine_if_the_database_is_shared(tmp_path, monkeypatch):
    monkeypatch.setenv(DATABASE_VARIABLE, ADDRESS)

    @dg.job(executor_def=supervised(dg.in_process_executor))
    def work():
        nothing()

    with dg.DagsterInstance.local_temp(str(tmp_path)) as instance:
        result = work.execute_in_process(instance=instance)
        assert MACHINE_TAG not in instance.get_run_by_id(result.run_id).tags, "execute_in_process replaces the executor"
        with dg.execute_job(dg.reconstructable(tagged), instance=instance) as result:
            assert result.success
            assert instance.get_run_by_id(result.run_id).tags[MACHINE_TAG] == platform.node()


def tagged():
    @dg.job(executor_def=supervised(dg.in_process_executor))
    def work():
        nothing()

    return work
