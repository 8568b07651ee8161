"""The executor as it is chosen; and where ray is installed, a study on a cluster of two hosts, killed in the middle."""

import importlib.util
import json
import os
import pathlib
import subprocess
import sys

import pytest

from deltasafe.compute.executor import LOCAL
from deltasafe.compute.ray_executor import RayExecutor, RaySettings
from deltasafe.errors import SettingsError
from pipelines.executors import ADDRESS, CPUS, EXECUTOR, GPUS, STEPS, ExecutorResource, ray_step_executor

ROOT = pathlib.Path(__file__).parents[2]
installed = pytest.mark.skipif(
    not importlib.util.find_spec("ray") or not importlib.util.find_spec("dagster_ray"),
    reason="needs the group `cluster`, as `make scale` installs it",
)


def test_the_local_executor_is_the_default():
    assert ExecutorResource.from_environment({}).executor() is LOCAL
    assert ray_step_executor({}) is None


@installed
def test_environment_variables_choose_a_cluster():
    executor = ExecutorResource.from_environment(
        {EXECUTOR: "ray", ADDRESS: "ray://head:10001", GPUS: "0.5", CPUS: "4"}
    ).executor()
    assert executor.settings == RaySettings("ray://head:10001", 4, 0.5)
    assert executor.rounds(7, 2) == [(7, 4)]
    assert ray_step_executor({EXECUTOR: "ray", STEPS: "ray"}).name == "ray"


@installed
def test_steps_on_a_cluster_reserve_no_core_and_get_no_secrets(monkeypatch):
    import pipelines.executors as module

    class Executor:
        def configured(self, config):
            return config

    monkeypatch.setattr("dagster_ray.ray_executor", Executor())
    environment = {
        EXECUTOR: "ray",
        STEPS: "ray",
        "AWS_SECRET_ACCESS_KEY": "hush",
        "DAGSTER_HOME": "there",
        "PATH": "/bin",
    }
    found = module.ray_step_executor(environment)["ray"]
    *names, path, modules = found["env_vars"]
    assert set(names) == {EXECUTOR, STEPS, "DAGSTER_HOME"}
    assert path == f"PATH={pathlib.Path(sys.executable).parent}:/bin", "so that steps find dagster"
    assert modules == f"PYTHONPATH={ROOT}", "so that steps find the assets"
    assert not {"num_cpus", "num_gpus"} & set(found), (
        "in the configuration of the executor, they would override op_tags"
    )


@pytest.mark.parametrize(
    ("environment", "message"),
    [
        ({EXECUTOR: "dask"}, "local or ray, got 'dask'"),
        ({ADDRESS: "nowhere"}, "got 'nowhere'"),
        ({ADDRESS: "http://head:8265"}, "auto, host:port"),
        ({GPUS: "1.5"}, r"gpus_per_member must lie in \[0, 1\]"),
        ({GPUS: "nan"}, "gpus_per_member"),
        ({GPUS: "half"}, f"{GPUS} must be a number"),
        ({CPUS: "0"}, "cpus_per_member must be at least 1"),
        ({CPUS: "1.5"}, f"{CPUS} must be a whole number"),
    ],
)
def test_invalid_variables_are_refused(environment, message):
    with pytest.raises(SettingsError, match=message):
        ExecutorResource.from_environment(environment).executor()


@pytest.mark.parametrize("environment", [{STEPS: "moon"}, {STEPS: "ray"}, {STEPS: "ray", EXECUTOR: "local"}])
def test_steps_on_ray_need_the_ray_executor(environment):
    with pytest.raises(SettingsError, match=STEPS):
        ray_step_executor(environment)


def test_a_missing_package_is_reported_with_its_installation(monkeypatch):
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    with pytest.raises(SettingsError, match=r"deltasafe\[ray\]"):
        RayExecutor()
    with pytest.raises(SettingsError, match="cluster"):
        ray_step_executor({EXECUTOR: "ray", STEPS: "ray"})


@installed
def test_a_cluster_makes_what_one_machine_makes_though_a_process_and_a_host_are_killed(tmp_path):
    command = [sys.executable, "-m", "pipelines.scale", "--parts", "study", "driver", "--runs", "2"]
    command += ["--iterations", "300", "--out", str(tmp_path / "figures.json")]
    ended = subprocess.run(command, cwd=ROOT, env=os.environ, capture_output=True, text=True, check=False)
    if "network namespaces are needed" in ended.stderr:
        pytest.skip("no network namespaces here")
    assert ended.returncode == 0, ended.stdout + ended.stderr[-4000:]
    figures = json.loads((tmp_path / "figures.json").read_text())
    assert (figures["digests_equal"], figures["killed_worker_completed"], figures["workers"]) == (1, 1, 2)
    assert figures["killed_driver_left_nothing"] == 1
    assert figures["plans"] == 2 * 14 * 11 * 2


@installed
def test_what_tasks_report_and_raise_comes_back(tmp_path):
    """In a process of its own: Ray, and what it listens on, is not for the other tests."""
    program = tmp_path / "reporting.py"
    program.write_text(REPORTING)
    environment = {**os.environ, "PYTHONPATH": f"{ROOT}:{tmp_path}", "RAY_USAGE_STATS_ENABLED": "0"}
    del environment["OMP_NUM_THREADS"]  # which Ray would leave as it is
    command = [sys.executable, "-m", "reporting"]
    ended = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True, check=False)
    if "network namespaces are needed" in ended.stderr:
        pytest.skip("no network namespaces here")
    assert ended.returncode == 0, ended.stdout + ended.stderr[-4000:]


REPORTING = """
from deltasafe.compute.executor import Needs, Task
from deltasafe.errors import DataError, WorkerLostError
from deltasafe.compute.ray_executor import RayExecutor, RaySettings
from pipelines.local_cluster import LocalCluster, apart

def speak(tell, name):
    import os
    for number in range(3):
        tell((name, number))
    return os.environ["OMP_NUM_THREADS"]

def refuse(path):
    raise DataError(path, "is wrong")

def die(times):
    import os, signal
    os.kill(os.getpid(), signal.SIGKILL)

def try_all(executor):
    import reporting  # functions are found by the name of their module

    heard = []
    tasks = [Task(name, reporting.speak, (name,)) for name in "ab"]
    found = dict(executor.run(tasks, 1, Needs(threads=2), heard.append))
    assert found == {0: "2", 1: "2"}, found
    assert sorted(heard) == [(name, number) for name in "ab" for number in range(3)], heard
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
    apart("reporting", [])
    with LocalCluster(jobs=False) as cluster:
        cluster.add_host(cores=2)
        executor = RayExecutor(RaySettings(cluster.address))
        try:
            try_all(executor)
        finally:
            executor.disconnect()  # which would else end this process once the cluster is gone
"""
