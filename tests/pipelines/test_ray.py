"""The choice of the executor by the environment."""

import importlib.util
import pathlib
import sys

import pytest

from deltasafe.compute.executor import LOCAL
from deltasafe.compute.ray_executor import RayExecutor, RaySettings
from deltasafe.errors import SettingsError
from pipelines.executors import ADDRESS, CPUS, EXECUTOR, GPUS, STEPS, ExecutorResource, steps_on_ray

ROOT = pathlib.Path(__file__).parents[2]
installed = pytest.mark.skipif(
    not importlib.util.find_spec("ray") or not importlib.util.find_spec("dagster_ray"),
    reason="needs the group `cluster`, as `make scale` installs it",
)


def test_one_machine_is_the_default():
    assert ExecutorResource.chosen({}).executor() is LOCAL
    assert steps_on_ray({}) is None


@installed
def test_a_cluster_is_chosen_by_the_environment():
    executor = ExecutorResource.chosen(
        {EXECUTOR: "ray", ADDRESS: "ray://head:10001", GPUS: "0.5", CPUS: "4"}
    ).executor()
    assert executor.settings == RaySettings("ray://head:10001", 4, 0.5)
    assert executor.rounds(7, 2) == [(7, 4)]
    assert steps_on_ray({EXECUTOR: "ray", STEPS: "ray"}).name == "ray"


@installed
def test_steps_on_a_cluster_hold_no_core_and_are_told_no_secrets(monkeypatch):
    import pipelines.executors as module

    class Listener:
        def configured(self, config):
            return config

    monkeypatch.setattr("dagster_ray.ray_executor", Listener())
    environment = {
        EXECUTOR: "ray",
        STEPS: "ray",
        "AWS_SECRET_ACCESS_KEY": "hush",
        "DAGSTER_HOME": "there",
        "PATH": "/bin",
    }
    found = module.steps_on_ray(environment)["ray"]
    *names, path, modules = found["env_vars"]
    assert set(names) == {EXECUTOR, STEPS, "DAGSTER_HOME"}
    assert path == f"PATH={pathlib.Path(sys.executable).parent}:/bin", "where steps find dagster"
    assert modules == f"PYTHONPATH={ROOT}", "and where they find the assets"
    assert not {"num_cpus", "num_gpus"} & set(found), "in the executor's own configuration they would win over tags"


@pytest.mark.parametrize(
    ("environment", "told"),
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
def test_wrong_values_are_refused_before_anything_runs(environment, told):
    with pytest.raises(SettingsError, match=told):
        ExecutorResource.chosen(environment).executor()


@pytest.mark.parametrize("environment", [{STEPS: "moon"}, {STEPS: "ray"}, {STEPS: "ray", EXECUTOR: "local"}])
def test_steps_elsewhere_need_an_engine_elsewhere(environment):
    with pytest.raises(SettingsError, match=STEPS):
        steps_on_ray(environment)


def test_an_engine_that_is_not_installed_says_how_it_would_be(monkeypatch):
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    with pytest.raises(SettingsError, match=r"deltasafe\[ray\]"):
        RayExecutor()
    with pytest.raises(SettingsError, match="cluster"):
        steps_on_ray({EXECUTOR: "ray", STEPS: "ray"})
