"""A study on a Ray cluster of two hosts with kills, and the executor on a cluster."""

import importlib.util
import os
import subprocess
import sys

import pytest

from deltasafe.io.storage import read_json
from pipelines.home import PROJECT

pytestmark = pytest.mark.skipif(
    not importlib.util.find_spec("ray") or not importlib.util.find_spec("dagster_ray"),
    reason="needs the group `cluster`, which `make scale` installs",
)


def test_cluster_with_kills_gives_the_results_of_one_machine(tmp_path):
    command = [sys.executable, "-m", "evidence.scale", "--parts", "study", "driver", "--runs", "2"]
    command += ["--iterations", "300", "--record", str(tmp_path / "scale.json")]
    ended = subprocess.run(command, cwd=PROJECT, env=os.environ, capture_output=True, text=True, check=False)
    if "network namespaces are needed" in ended.stderr:
        pytest.skip("cannot create network namespaces")
    assert ended.returncode == 0, ended.stdout + ended.stderr[-4000:]
    figures = read_json(tmp_path / "scale.json")["figures"]
    assert (figures["digests_equal"], figures["killed_worker_completed"], figures["workers"]) == (1, 1, 2)
    assert figures["killed_driver_left_nothing"] == 1
    assert figures["plans"] == 2 * 14 * 11 * 2


def test_reports_and_errors_of_tasks_reach_the_caller(tmp_path):
    """Run in a separate process, because Ray leaves sockets open."""
    program = tmp_path / "reporting.py"
    program.write_text(REPORTING)
    environment = {**os.environ, "PYTHONPATH": f"{PROJECT}:{tmp_path}", "RAY_USAGE_STATS_ENABLED": "0"}
    del environment["OMP_NUM_THREADS"]  # Ray would not overwrite it
    command = [sys.executable, "-m", "reporting"]
    ended = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True, check=False)
    if "network namespaces are needed" in ended.stderr:
        pytest.skip("cannot create network namespaces")
    assert ended.returncode == 0, ended.stdout + ended.stderr[-4000:]


REPORTING = """
from deltasafe.compute.executor import Needs, Task
from deltasafe.errors import DataError, WorkerLostError
from deltasafe.compute.ray_executor import RayExecutor, RaySettings
from evidence.scale.local_cluster import LocalCluster, enter_namespaces

def speak(report, name):
    import os
    for number in range(3):
        report((name, number))
    return os.environ["OMP_NUM_THREADS"]

def refuse(path):
    raise DataError(path, "is wrong")

def die(times):
    import os, signal
    os.kill(os.getpid(), signal.SIGKILL)

def try_all(executor):
    import reporting  # Ray finds functions by the name of their module

    reports = []
    tasks = [Task(name, reporting.speak, (name,)) for name in "ab"]
    found = dict(executor.run(tasks, 1, Needs(threads=2), reports.append))
    assert found == {0: "2", 1: "2"}, found
    assert sorted(reports) == [(name, number) for name in "ab" for number in range(3)], reports
    for name, work, kind, words in (
        ("wrong", reporting.refuse, DataError, "some/file: is wrong"),
        ("deadly", reporting.die, WorkerLostError, "deadly: the process"),
    ):
        try:
            dict(executor.run([Task(name, work, ("some/file",))], 1))
        except kind as error:
            assert type(error) is kind and words in str(error), error
        else:
            raise AssertionError("no error")

if __name__ == "__main__":
    enter_namespaces("reporting", [])
    with LocalCluster(jobs=False) as cluster:
        cluster.add_host(cores=2)
        executor = RayExecutor(RaySettings(cluster.address))
        try:
            try_all(executor)
        finally:
            executor.disconnect()  # Ray ends a process whose cluster is gone
"""
