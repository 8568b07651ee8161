"""The choice of the executor by the environment."""

import importlib.util
import pathlib
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
        ({GPUS: "1.5"}, r"gpus_per_member must be in \[0, 1\]"),
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
