"""Measure and record how the project operates.

share    fraction of the last complete run that orchestration took
tests    new images, a worse ensemble and a rollback, by the tests of these
browser  the UI, by the browser tests
"""

import argparse
import os
import pathlib
import subprocess
import sys
import tempfile
from collections.abc import Sequence
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


def main(arguments: Sequence[str] | None = None) -> int:
    """Run ``python -m evidence.operation``; 1 if something did not pass."""
    parser = command_parser("operation", __doc__)
    parser.add_argument("what", choices=("share", "tests", "browser"))
    parser.add_argument("--run", default="", help="share: ID of a run; default: the last one of the job `everything`")
    options = parser.parse_args(arguments)
    measure = {"share": _share, "tests": _tests, "browser": _browser}[options.what]
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
