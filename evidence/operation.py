"""`make operation-record` and `make browser-test`: how the project operates, measured and recorded.

python -m evidence.operation share [--run ID]  what orchestration costs, of the last whole run of the home
python -m evidence.operation tests             new images, a worse ensemble and a rollback, by the tests that do them
python -m evidence.operation browser           the UI, used by a browser
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
from pipelines.home import PROJECT, prepare_home
from pipelines.records import merge_part

__all__ = ["TESTS", "main", "passed"]

TESTS = {
    "sensor_to_challenger_passed": "tests/pipelines/test_unattended.py::"
    "test_a_changed_image_becomes_a_new_challenger_and_what_follows_is_made_again",
    "worse_ensemble_refused": "tests/pipelines/test_registry.py::"
    "test_a_worse_ensemble_is_refused_another_promoted_and_taken_back_by_one_command",
    "rollback_passed": "tests/pipelines/test_registry.py::"
    "test_a_worse_ensemble_is_refused_another_promoted_and_taken_back_by_one_command",
}
"""Figures, and the test that has to pass for each."""

BROWSER_TESTS = "tests/browser"


def main(arguments: Sequence[str] | None = None) -> int:
    """0 if what was measured is as it has to be."""
    parser = argparse.ArgumentParser(
        prog="python -m evidence.operation", description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("what", choices=("share", "tests", "browser"))
    parser.add_argument("--run", default="", help="share: id of a run; otherwise the last one of the job `everything`")
    parser.add_argument("--record", type=pathlib.Path, help="also merge the figures into this file (docs/results/...)")
    options = parser.parse_args(arguments)
    try:
        if options.what == "share":
            return _share(options.run, options.record)
        if options.what == "tests":
            return _tests(options.record)
        return _browser(options.record)
    except DeltasafeError as error:
        print(error, file=sys.stderr)
        return 1


def _share(run_id: str, destination: pathlib.Path | None) -> int:
    root = prepare_home()

    import dagster as dg

    from evidence.orchestration import times_of_run

    with dg.DagsterInstance.get() as instance:
        whole = dg.RunsFilter(job_name="everything", statuses=[dg.DagsterRunStatus.SUCCESS])
        runs = [run_id] if run_id else [run.run_id for run in instance.get_runs(whole, limit=1)]
        if not runs:
            raise DataError(root, "holds no whole run yet; make one with `make demo`")
        times = times_of_run(instance, runs[0])
    minutes = (times.whole[1] - times.whole[0]) / 60
    print(f"  {times.share:.1%} of {minutes:.1f} minutes were outside the library (MLflow: {times.recording_s:.1f} s)")
    if destination:
        merge_part(
            destination,
            "orchestration",
            {"orchestration_share": round(times.share, 4)},
            command="python -m evidence.operation share",
            seeds={},
            preset=os.environ.get(VARIABLE) or "default",
            run_minutes=round(minutes, 2),
            recording_s=round(times.recording_s, 2),
        )
    return 0


def _tests(destination: pathlib.Path | None) -> int:
    outcomes = passed(sorted(set(TESTS.values())))
    figures = {figure: outcomes.get(test.rpartition("::")[2], False) for figure, test in TESTS.items()}
    for figure, fine in figures.items():
        print(f"  {figure:30s} {fine}")
    if destination:
        command = "python -m evidence.operation tests"
        merge_part(destination, "tests", figures, command=command, seeds={}, tests=TESTS)
    return 0 if all(figures.values()) else 1


def _browser(destination: pathlib.Path | None) -> int:
    outcomes = passed([BROWSER_TESTS], "-v", "-s")
    fine = bool(outcomes) and all(outcomes.values())
    if not fine:
        print(f"not passed: {', '.join(name for name, one in outcomes.items() if not one) or 'nothing was run'}")
    if destination:
        command = "make browser-test RECORD=docs/results/operation.json"
        figures = {"browser_test_passed": fine}
        merge_part(destination, "browser", figures, command=command, seeds={}, tests=sorted(outcomes))
    return 0 if fine else 1


def passed(tests: Sequence[str], *options: str) -> dict[str, bool]:
    """Run tests in a process of their own; by name whether each passed. One that was skipped did not."""
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
