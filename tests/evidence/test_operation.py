"""How the project operates, as it is measured and recorded."""

import logging
import time

import dagster as dg
import pytest
from hypothesis import given
from hypothesis import strategies as st

from deltasafe.errors import DataError
from deltasafe.storage import read_json
from evidence import operation
from evidence.orchestration import outside_of, times_of_run
from pipelines.tracking import MlflowTracker

WHOLE = 20
intervals = st.tuples(st.integers(-5, WHOLE + 5), st.integers(0, 10)).map(lambda pair: (pair[0], pair[0] + pair[1]))


@given(st.lists(intervals, max_size=8))
def test_what_lies_outside_all_work_is_counted_second_by_second(work):
    free = sum(not any(began <= second < ended for began, ended in work) for second in range(WHOLE))
    assert outside_of((0, WHOLE), work) == free


@pytest.fixture
def ran(tmp_path):
    """A run of two steps: one sleeps, one records with MLflow while it works."""

    @dg.asset
    def works():
        time.sleep(0.4)

    @dg.asset(deps=[works])
    def records():
        with MlflowTracker(tmp_path).records():
            time.sleep(0.4)

    (tmp_path / "dagster").mkdir()
    logs = {"python_logs": {"python_log_level": "INFO", "managed_python_loggers": ["deltasafe"]}}
    with dg.DagsterInstance.local_temp(str(tmp_path / "dagster"), overrides=logs) as instance:
        yield instance, dg.materialize([works, records], instance=instance).run_id
    logging.getLogger("deltasafe").handlers.clear()


def test_recording_and_dagsters_own_time_are_no_work(ran):
    times = times_of_run(*ran)
    worked_s = sum(ended - began for began, ended in times.work)
    whole_s = times.whole[1] - times.whole[0]
    assert times.recording_s >= 0.39
    assert 0.4 <= worked_s <= whole_s - times.recording_s + 0.02
    assert times.share == pytest.approx(1 - worked_s / whole_s)


def test_a_run_that_is_not_known_is_refused(ran):
    with pytest.raises(DataError, match="is not known"):
        times_of_run(ran[0], "0" * 8)


def test_the_share_of_the_last_whole_run_is_recorded(ran, tmp_path, monkeypatch):
    instance, run_id = ran
    monkeypatch.setattr(operation, "prepare_home", lambda: tmp_path)
    monkeypatch.setattr(dg.DagsterInstance, "get", staticmethod(lambda: instance))
    record = tmp_path / "operation.json"
    assert operation.main(["share", "--record", str(record)]) == 1, "there is no run of the job `everything`"
    assert operation.main(["share", "--run", run_id, "--record", str(record)]) == 0
    assert 0 < read_json(record)["figures"]["orchestration_share"] < 1


def test_only_what_really_passed_counts(tmp_path, monkeypatch):
    file = tmp_path / "test_some.py"
    file.write_text(
        "import pytest\n"
        "def test_fine(): pass\n"
        "def test_wrong(): assert False\n"
        "@pytest.mark.skip\n"
        "def test_skipped(): pass\n"
    )
    assert operation.passed([str(file)]) == {"test_fine": True, "test_wrong": False, "test_skipped": False}
    assert operation.passed([str(tmp_path / "none.py")]) == {}

    monkeypatch.setattr(operation, "BROWSER_TESTS", str(file))
    record = tmp_path / "operation.json"
    assert operation.main(["browser", "--record", str(record)]) == 1
    assert read_json(record)["figures"] == {"browser_test_passed": False}


def test_the_tests_that_figures_are_named_after_exist():
    for name in operation.TESTS.values():
        path, test = name.split("::")
        assert f"def {test}(" in (operation.PROJECT / path).read_text(encoding="utf-8")
