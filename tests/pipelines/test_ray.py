"""The choice of the engine by the environment."""

import importlib.util
import pathlib
import sys

import pytest

from deltasafe.engine import LOCAL
from deltasafe.errors import SettingsError
from deltasafe.ray_engine import RayEngine, RaySettings
from pipelines.engines import ADDRESS, CPUS, ENGINE, GPUS, STEPS, EngineResource, steps_on_ray

ROOT = pathlib.Path(__file__).parents[2]
installed = pytest.mark.skipif(
    not importlib.util.find_spec("ray") or not importlib.util.find_spec("dagster_ray"),
    reason="needs the group `cluster`, as `make scale` installs it",
)


def test_one_machine_is_the_default():
    assert EngineResource.chosen({}).engine() is LOCAL
    assert steps_on_ray({}) is None


@installed
def test_a_cluster_is_chosen_by_the_environment():
    engine = EngineResource.chosen({ENGINE: "ray", ADDRESS: "ray://head:10001", GPUS: "0.5", CPUS: "4"}).engine()
    assert engine.settings == RaySettings("ray://head:10001", 4, 0.5)
    assert engine.rounds(7, 2) == [(7, 4)]
    assert steps_on_ray({ENGINE: "ray", STEPS: "ray"}).name == "ray"


@installed
def test_steps_on_a_cluster_hold_no_core_and_are_told_no_secrets(monkeypatch):
    import pipelines.engines as module

    class Listener:
        def configured(self, config):
            return config

    monkeypatch.setattr("dagster_ray.ray_executor", Listener())
    environment = {
        ENGINE: "ray",
        STEPS: "ray",
        "AWS_SECRET_ACCESS_KEY": "hush",
        "DAGSTER_HOME": "there",
        "PATH": "/bin",
    }
    found = module.steps_on_ray(environment)["ray"]
    *names, path, modules = found["env_vars"]
    assert set(names) == {ENGINE, STEPS, "DAGSTER_HOME"}
    assert path == f"PATH={pathlib.Path(sys.executable).parent}:/bin", "where steps find dagster"
    assert modules == f"PYTHONPATH={ROOT}", "and where they find the assets"
    assert not {"num_cpus", "num_gpus"} & set(found), "in the executor's own configuration they would win over tags"


@pytest.mark.parametrize(
    ("environment", "told"),
    [
        ({ENGINE: "dask"}, "local or ray, got 'dask'"),
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
        EngineResource.chosen(environment).engine()


@pytest.mark.parametrize("environment", [{STEPS: "moon"}, {STEPS: "ray"}, {STEPS: "ray", ENGINE: "local"}])
def test_steps_elsewhere_need_an_engine_elsewhere(environment):
    with pytest.raises(SettingsError, match=STEPS):
        steps_on_ray(environment)


def test_an_engine_that_is_not_installed_says_how_it_would_be(monkeypatch):
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    with pytest.raises(SettingsError, match=r"deltasafe\[ray\]"):
        RayEngine()
    with pytest.raises(SettingsError, match="cluster"):
        steps_on_ray({ENGINE: "ray", STEPS: "ray"})
