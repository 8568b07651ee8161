"""Measure and record how the project operates.

share    fraction of the last complete run that orchestration took
tests    new images, a worse ensemble and a rollback, by the tests of these
browser  the UI, by the browser tests
faults   faults that were found by trying public trouble on the product, by the tests that fail without their repair
"""

import argparse
import os
import pathlib
import subprocess
import sys
import tempfile
from collections.abc import Mapping, Sequence
from xml.etree import ElementTree

from deltasafe.errors import DataError, DeltasafeError
from deltasafe.presets import VARIABLE
from evidence.reporting import command_parser, finish
from pipelines.home import PROJECT, prepare_home

_REGISTRY_TEST = (
    "tests/pipelines/tracking/test_registry.py::"
    "test_a_worse_ensemble_is_refused_another_promoted_and_taken_back_by_one_command"
)
TESTS = {
    "sensor_to_challenger_passed": "tests/pipelines/test_unattended.py::"
    "test_a_changed_image_becomes_a_new_challenger_and_what_follows_is_made_again",
    "worse_ensemble_refused": _REGISTRY_TEST,
    "rollback_passed": _REGISTRY_TEST,
}
"""Figures, and the test that must pass for each."""
BROWSER_TESTS = "tests/browser"

_P, _T = "tests/pipelines", "tests/pipelines/tracking"
_BY_HAND, _ADDRESSES = f"{_T}/test_decisions_by_hand.py", f"{_T}/test_addresses.py"
_SENSORS, _LINE = f"{_P}/automation/test_sensors.py", f"{_P}/test_command_line.py"
FAULTS = {
    "C1": f"{_P}/test_supervision.py::test_an_interrupted_run_ends_all_processes_and_frees_its_pool_slots",
    "C2": "tests/unit/compute/test_executor.py::test_interrupts_end_all_workers",
    "C3": f"{_P}/test_supervision.py::test_another_uptime_in_a_container_fails_no_run",
    "C4": f"{_T}/test_registry.py::test_rollback_skips_deleted_versions_and_changes_nothing_if_it_fails",
    "C5": f"{_BY_HAND}::test_a_moved_alias_is_followed_and_figures_do_not_overrule_it",
    "C6": f"{_BY_HAND}::test_calls_wait_while_the_experiment_is_deleted",
    "C7": f"{_BY_HAND}::test_without_a_champion_nothing_is_promoted_until_a_person_chooses",
    "C8": f"{_BY_HAND}::test_an_asset_that_was_wiped_is_not_used",
    "C9": f"{_SENSORS}::test_a_folder_that_returns_to_an_earlier_content_is_trained_on_again",
    "C10": f"{_SENSORS}::test_a_defect_is_named_in_every_tick_until_it_is_mended",
    "C11": f"{_SENSORS}::test_only_changed_files_are_read_and_only_when_they_are_settled",
    "C13": f"{_ADDRESSES}::test_an_address_with_a_password_is_reachable_and_logs_in",
    "C14": f"{_ADDRESSES}::test_settings_for_certificates_apply",
    "C15": f"{_LINE}::test_a_used_port_is_named_before_anything_starts",
    "C16": f"{_LINE}::test_a_home_has_one_ui",
    "C17": f"{_P}/commands/test_ui_stop.py::test_a_second_signal_leaves_no_server",
    "C18": f"{_LINE}::test_an_invalid_dagster_yaml_is_named",
    "C19": f"{_ADDRESSES}::test_mlflow_answers_a_browser_that_calls_this_machine_by_name",
    "C20": f"{_BY_HAND}::test_a_copied_home_uses_its_own_artifacts",
    "C21": "tests/unit/compute/test_numba_cache.py::"
    "test_without_a_writable_cache_the_home_is_used_unless_others_can_write_there",
    "C22": f"{_LINE}::test_a_home_that_is_a_file_is_named",
    "C23": f"{_P}/test_definitions.py::test_definitions_without_a_dagster_home_say_so",
    "C24": "tests/unit/io/test_storage.py::test_files_and_folders_have_the_mode_that_the_umask_gives",
    "C25": f"{_T}/test_tracker.py::test_recording_again_changes_no_duration_and_a_member_alone_ends_its_parent",
    "C26": f"{_P}/test_definitions.py::test_a_missing_input_is_not_retried_and_is_the_first_line_of_the_error",
    "C27": f"{_P}/automation/test_launch_check.py::"
    "test_all_assets_of_the_lineage_are_refused_in_a_run_and_in_a_run_of_a_backfill",
    "C28": f"{_P}/test_supervision.py::test_failed_checks_are_a_tag_of_the_green_run",
    "C29": "tests/assets/test_staleness.py::test_the_sensor_reports_a_changed_result_once",
    "C30": f"{_P}/test_retention.py::test_what_a_pointer_or_a_kept_run_refers_to_stays_and_the_rest_goes",
}
"""Faults of the operation that are repaired, each with the test that fails without the repair."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run ``python -m evidence.operation``; 1 if something did not pass."""
    parser = command_parser("operation", __doc__)
    parser.add_argument("what", choices=("share", "tests", "browser", "faults"))
    parser.add_argument("--run", default="", help="share: ID of a run; default: the last one of the job `everything`")
    options = parser.parse_args(arguments)
    measure = {"share": _share, "tests": _tests, "browser": _browser, "faults": _faults}[options.what]
    try:
        return measure(options)
    except DeltasafeError as error:
        print(error, file=sys.stderr)
        return 1


def _share(options: argparse.Namespace) -> int:
    root = prepare_home()

    import dagster as dg

    from evidence.orchestration import times_of_run

    with dg.DagsterInstance.get() as instance:
        complete = dg.RunsFilter(job_name="everything", statuses=[dg.DagsterRunStatus.SUCCESS])
        runs = [options.run] if options.run else [run.run_id for run in instance.get_runs(complete, limit=1)]
        if not runs:
            raise DataError(root, "has no complete run yet; make one with `make demo`")
        times = times_of_run(instance, runs[0])
    minutes = (times.run_s[1] - times.run_s[0]) / 60
    print(f"{times.share:.1%} of {minutes:.1f} minutes were outside the library (MLflow: {times.recording_s:.1f} s)")
    return finish(
        options,
        {"orchestration_share": round(times.share, 4)},
        part="orchestration",
        command="python -m evidence.operation share",
        preset=os.environ.get(VARIABLE) or "default",
        run_minutes=round(minutes, 2),
        recording_s=round(times.recording_s, 2),
    )


def _tests(options: argparse.Namespace) -> int:
    outcomes = outcomes_of(sorted(set(TESTS.values())))
    figures = {figure: outcomes.get(test.rpartition("::")[2], False) for figure, test in TESTS.items()}
    failures = [f"{figure}: {TESTS[figure]} did not pass" for figure, passed in figures.items() if not passed]
    return finish(options, figures, failures, part="tests", command="python -m evidence.operation tests", tests=TESTS)


def _browser(options: argparse.Namespace) -> int:
    outcomes = outcomes_of([BROWSER_TESTS], "-v", "-s")
    failures = [f"{name} did not pass" for name, passed in outcomes.items() if not passed]
    if not outcomes:
        failures = ["no browser test was run"]
    figures = {"browser_test_passed": not failures}
    command = "make browser-test RECORD=docs/results/operation.json"
    return finish(options, figures, failures, part="browser", command=command, tests=sorted(outcomes))


def _faults(options: argparse.Namespace) -> int:
    figures, failures = fixed_faults({fault: (test,) for fault, test in FAULTS.items()})
    command = "python -m evidence.operation faults"
    return finish(options, figures, failures, part="faults", command=command, tests=FAULTS)


def fixed_faults(faults: Mapping[str, Sequence[str]]) -> tuple[dict[str, int], list[str]]:
    """Run the tests of each fault; return the figure ``faults_fixed``, and the tests that did not pass."""
    outcomes: dict[str, bool] = {}
    for name, passed in outcomes_of(sorted({test for tests in faults.values() for test in tests})).items():
        function = name.partition("[")[0]
        outcomes[function] = passed and outcomes.get(function, True)
    failed = {
        fault: [test for test in tests if not outcomes.get(test.rpartition("::")[2], False)]
        for fault, tests in faults.items()
    }
    failures = [f"{fault}: {test} did not pass" for fault, tests in failed.items() for test in tests]
    return {"faults_fixed": sum(not tests for tests in failed.values())}, failures


def outcomes_of(tests: Sequence[str], *options: str) -> dict[str, bool]:
    """Run tests in a separate process; return for each whether it passed. A skipped test did not pass."""
    with tempfile.TemporaryDirectory() as folder:
        report = pathlib.Path(folder) / "report.xml"
        command = [sys.executable, "-m", "pytest", *options, f"--junit-xml={report}", *tests]
        subprocess.run(command, cwd=PROJECT, check=False)
        if not report.is_file():
            return {}
        cases = ElementTree.parse(report).iter("testcase")
        return {
            str(case.get("name")): not any(case.find(kind) is not None for kind in ("failure", "error", "skipped"))
            for case in cases
        }


if __name__ == "__main__":
    sys.exit(main())
