"""Resumable jobs: finished batches are reused, only if arguments and code match, and damaged ones are named."""

import numpy as np
import pytest

from deltasafe.errors import DataError, SettingsError
from deltasafe.studies.resumable_jobs import run_batches


def double(value, factor):
    return {"value": np.array(value * factor)}


def fail(value, factor):
    raise RuntimeError("failed")


def test_finished_batches_are_reused_only_if_arguments_and_code_match(tmp_path):
    jobs = [(f"job-{value}", (value, 2)) for value in range(4)]
    reports = []
    batches, effort = run_batches(double, jobs, tmp_path, progress=lambda *report: reports.append(report))
    assert [int(batch["value"]) for batch in batches] == [0, 2, 4, 6]
    assert effort.minutes >= 0
    assert reports[0][:2] == (0, 4)
    assert reports[-1][:2] == (4, 4)
    files = sorted(tmp_path.iterdir())
    stamps = [file.stat().st_mtime_ns for file in files]
    again, _ = run_batches(double, jobs, tmp_path, workers=2)
    assert [int(batch["value"]) for batch in again] == [0, 2, 4, 6]
    assert [file.stat().st_mtime_ns for file in sorted(tmp_path.iterdir())] == stamps
    files[1].unlink()
    run_batches(double, jobs, tmp_path)
    assert sorted(tmp_path.iterdir()) == files
    other, _ = run_batches(double, [("job-0", (5, 2))], tmp_path)
    assert int(other[0]["value"]) == 10
    with pytest.raises(RuntimeError, match="failed"):
        run_batches(fail, jobs, tmp_path)


def test_interrupted_jobs_resume(tmp_path):
    def stop_after_two(done, total, message):
        if done == 2:
            raise KeyboardInterrupt

    jobs = [(f"job-{value}", (value, 3)) for value in range(4)]
    with pytest.raises(KeyboardInterrupt):
        run_batches(double, jobs, tmp_path, progress=stop_after_two)
    assert len(list(tmp_path.iterdir())) == 2
    reports = []
    batches, _ = run_batches(double, jobs, tmp_path, progress=lambda *report: reports.append(report))
    assert reports[0][0] == 2
    assert [int(batch["value"]) for batch in batches] == [0, 3, 6, 9]


def test_damaged_batches_and_impossible_workers_are_named(tmp_path):
    run_batches(double, [("job", (1, 1))], tmp_path)
    (file,) = tmp_path.iterdir()
    file.write_bytes(file.read_bytes()[:40])
    with pytest.raises(DataError, match="delete it"):
        run_batches(double, [("job", (1, 1))], tmp_path)
    with pytest.raises(SettingsError, match="workers"):
        run_batches(double, [], tmp_path, workers=0)
