"""The home's `dagster.yaml`: ours is kept up to date, the user's is left alone, and no secret gets into either."""

import importlib.util
import platform

import dagster as dg
import pytest

from deltasafe.errors import DataError, SettingsError
from pipelines.automation.lost_runs import fail_lost_runs
from pipelines.home import DATABASE_VARIABLE, prepare_home
from pipelines.run_owner import MACHINE_TAG
from pipelines.supervision import supervised

ADDRESS = "postgresql+psycopg2://user:secret@127.0.0.1:1/dagster"


@pytest.fixture
def settings(tmp_path, monkeypatch):
    for variable in ("DAGSTER_HOME", DATABASE_VARIABLE):
        monkeypatch.setenv(variable, "")
    monkeypatch.setenv("DELTASAFE_HOME", str(tmp_path))
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: object())
    return tmp_path / "dagster" / "dagster.yaml"


def test_the_database_is_named_by_its_variable_and_goes_again_with_it(settings, monkeypatch):
    prepare_home()
    usual = settings.read_text()
    assert "storage" not in usual
    monkeypatch.setenv(DATABASE_VARIABLE, ADDRESS)
    prepare_home()
    assert settings.read_text().startswith(usual)
    assert f"env: {DATABASE_VARIABLE}" in settings.read_text()
    assert "secret" not in settings.read_text()
    monkeypatch.setenv(DATABASE_VARIABLE, "")
    prepare_home()
    assert settings.read_text() == usual


def test_one_that_was_edited_stays_and_has_to_name_the_database(settings, monkeypatch):
    settings.parent.mkdir()
    settings.write_text("telemetry: {enabled: false}\n")
    prepare_home()
    monkeypatch.setenv(DATABASE_VARIABLE, ADDRESS)
    with pytest.raises(DataError, match=f"was edited and does not use {DATABASE_VARIABLE}"):
        prepare_home()
    mine = f"storage: {{postgres: {{postgres_url: {{env: {DATABASE_VARIABLE}}}}}}}\n"
    settings.write_text(mine)
    prepare_home()
    assert settings.read_text() == mine


def test_an_address_of_another_form_is_refused_without_showing_it(settings, monkeypatch):
    monkeypatch.setenv(DATABASE_VARIABLE, "postgresql://user:secret@127.0.0.1/dagster")
    with pytest.raises(SettingsError, match=r"the form postgresql\+psycopg2://USER:PASSWORD") as caught:
        prepare_home()
    assert "secret" not in str(caught.value)
    monkeypatch.setenv(DATABASE_VARIABLE, ADDRESS)
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    with pytest.raises(SettingsError, match="make team"):
        prepare_home()
    assert not settings.exists()


@dg.op
def nothing():
    pass


def test_runs_of_another_machine_are_not_looked_for_here(tmp_path, monkeypatch):
    @dg.job
    def work():
        nothing()

    gone = 2**22 + 1  # beyond what numbers of processes reach
    with dg.DagsterInstance.local_temp(str(tmp_path)) as instance:

        def started(**tags):
            run = instance.create_run_for_job(work, status=dg.DagsterRunStatus.STARTED, tags=tags)
            data = dg._core.events.EngineEventData.in_process(gone)
            instance.report_engine_event("Started process for run", run, data)
            return run.run_id

        mine, other = started(**{MACHINE_TAG: platform.node()}), started(**{MACHINE_TAG: "elsewhere"})
        untold = started()
        monkeypatch.setenv(DATABASE_VARIABLE, ADDRESS)
        assert fail_lost_runs(instance) == [mine]
        monkeypatch.delenv(DATABASE_VARIABLE)
        assert set(fail_lost_runs(instance)) == {other, untold}, "a home of its own has no others"


def test_runs_say_on_which_machine_they_are_where_the_database_is_shared(tmp_path, monkeypatch):
    monkeypatch.setenv(DATABASE_VARIABLE, ADDRESS)

    @dg.job(executor_def=supervised(dg.in_process_executor))
    def work():
        nothing()

    with dg.DagsterInstance.local_temp(str(tmp_path)) as instance:
        result = work.execute_in_process(instance=instance)
        assert MACHINE_TAG not in instance.get_run_by_id(result.run_id).tags, "another executor was put in its place"
        with dg.execute_job(dg.reconstructable(tagged), instance=instance) as result:
            assert result.success
            assert instance.get_run_by_id(result.run_id).tags[MACHINE_TAG] == platform.node()


def tagged():
    @dg.job(executor_def=supervised(dg.in_process_executor))
    def work():
        nothing()

    return work
