"""Measurement of orchestration, and outcomes of the tests that stand for operation."""

import logging
import time

import dagster as dg
import pytest
from hypothesis import given
from hypothesis import strategies as st

from deltasafe.errors import DataError
from deltasafe.io.storage import read_json
from evidence import input_faults, operation
from evidence.orchestration import time_outside, times_of_run
from pipelines.tracking.tracker import MlflowTracker

WHOLE = 20
intervals = st.tuples(st.integers(-5, WHOLE + 5), st.integers(0, 10)).map(lambda pair: (pair[0], pair[0] + pair[1]))


@given(st.lists(intervals, max_size=8))
def test_time_outside_equals_count_of_free_seconds(work):
    free = sum(not any(began <= second < ended for began, ended in work) for second in range(WHOLE))
    assert time_outside((0, WHOLE), work) == free


@pytest.fixture
def finished_run(tmp_path):
    """Run two steps: one sleeps, one sleeps while it records with MLflow."""

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


def test_recording_and_dagster_overhead_are_not_work(finished_run):
    times = times_of_run(*finished_run)
    worked_s = sum(ended - began for began, ended in times.work_s)
    whole_s = times.run_s[1] - times.run_s[0]
    assert times.recording_s >= 0.39
    assert 0.4 <= worked_s <= whole_s - times.recording_s + 0.02
    assert times.share == pytest.approx(1 - worked_s / whole_s)


def test_unknown_run_is_rejected(finished_run):
    with pytest.raises(DataError, match="is unknown"):
        times_of_run(finished_run[0], "0" * 8)


def test_share_of_a_run_is_recorded(finished_run, tmp_path, monkeypatch):
    instance, run_id = finished_run
    monkeypatch.setattr(operation, "prepare_home", lambda: tmp_path)
    monkeypatch.setattr(dg.DagsterInstance, "get", staticmethod(lambda: instance))
    record = tmp_path / "operation.json"
    assert operation.main(["share", "--record", str(record)]) == 1, "no run of the job `everything`"
    assert operation.main(["share", "--run", run_id, "--record", str(record)]) == 0
    assert 0 < read_json(record)["figures"]["orchestration_share"] < 1


def test_skipped_and_failed_tests_did_not_pass(tmp_path, monkeypatch):
    file = tmp_path / "test_some.py"
    file.write_text(
        "import pytest\n"
        "def test_fine(): pass\n"
        "def test_wrong(): assert False\n"
        "@pytest.mark.skip\n"
        "def test_skipped(): pass\n"
    )
    assert operation.outcomes_of([str(file)]) == {"test_fine": True, "test_wrong": False, "test_skipped": False}
    assert operation.outcomes_of([str(tmp_path / "none.py")]) == {}

    monkeypatch.setattr(operation, "BROWSER_TESTS", str(file))
    record = tmp_path / "operation.json"
    assert operation.main(["browser", "--record", str(record)]) == 1
    assert read_json(record)["figures"] == {"browser_test_passed": False}


def test_a_fault_is_fixed_if_all_its_tests_pass(monkeypatch):
    outcomes = {"test_one[a]": True, "test_one[b]": False, "test_two": True}
    monkeypatch.setattr(operation, "outcomes_of", lambda tests: outcomes)
    faults = {"A1": ("f.py::test_one", "f.py::test_two"), "A2": ("f.py::test_two",), "A3": ("f.py::test_none",)}
    figures, failures = operation.fixed_faults(faults)
    assert figures == {"faults_fixed": 1}
    assert failures == ["A1: f.py::test_one did not pass", "A3: f.py::test_none did not pass"]


def test_tests_of_figures_exist():
    of_inputs = {test for tests in input_faults.FAULTS.values() for test in tests}
    for name in {*operation.TESTS.values(), *operation.FAULTS.values(), *of_inputs}:
        path, test = name.split("::")
        assert f"def {test}(" in (operation.PROJECT / path).read_text(encoding="utf-8")
