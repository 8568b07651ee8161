"""Which executor does the long work, as the environment chooses it: processes of this machine, or a Ray cluster.

| variable | values |
|---|---|
| `DELTASAFE_EXECUTOR` | `local` (default) or `ray` |
| `DELTASAFE_RAY_ADDRESS` | `auto` (default: the cluster that this machine is part of), `host:port`, `ray://host:port` |
| `DELTASAFE_GPUS_PER_MEMBER` | share of a GPU of a member's training, from 0 (default: none) to 1 |
| `DELTASAFE_CPUS_PER_MEMBER` | cores and threads of a member's training (default 1) |
| `DELTASAFE_STEPS` | where Dagster's steps are processes: `local` (default), or `ray`: jobs of the cluster |
"""

import importlib.util
import os
import pathlib
import sys
from collections.abc import Mapping

import dagster as dg

from deltasafe.compute.executor import LOCAL, Executor
from deltasafe.compute.ray_executor import RayExecutor, RaySettings
from deltasafe.errors import SettingsError
from pipelines.home import DATABASE_VARIABLE, PROJECT

__all__ = ["ADDRESS", "CPUS", "EXECUTOR", "GPUS", "STEPS", "ExecutorResource", "steps_on_ray"]

EXECUTOR, ADDRESS = "DELTASAFE_EXECUTOR", "DELTASAFE_RAY_ADDRESS"
STEPS = "DELTASAFE_STEPS"
GPUS, CPUS = "DELTASAFE_GPUS_PER_MEMBER", "DELTASAFE_CPUS_PER_MEMBER"


class ExecutorResource(dg.ConfigurableResource[Executor]):
    """The executor that assets are given; settings of Ray mean nothing to the local one."""

    name: str
    address: str
    cpus_per_member: int
    gpus_per_member: float

    @classmethod
    def chosen(cls, environment: Mapping[str, str] = os.environ) -> "ExecutorResource":
        """As the environment has it.

        Raises:
            SettingsError: a variable has a value that it cannot have, or the executor is not installed.
        """
        name, usual = environment.get(EXECUTOR) or "local", RaySettings()
        if name not in ("local", "ray"):
            raise SettingsError(f"{EXECUTOR} must be local or ray, got {name!r}")
        found = cls(
            name=name,
            address=environment.get(ADDRESS) or usual.address,
            cpus_per_member=int(_number(environment, CPUS, usual.cpus_per_member)),
            gpus_per_member=_number(environment, GPUS, usual.gpus_per_member),
        )
        found.executor()
        return found

    def executor(self) -> Executor:
        """Not connected to anything yet."""
        settings = RaySettings(self.address, self.cpus_per_member, self.gpus_per_member)
        return RayExecutor(settings) if self.name == "ray" else LOCAL

    def create_resource(self, context: dg.InitResourceContext) -> Executor:
        return self.executor()


_HANDED_ON = ("DELTASAFE_", "DAGSTER_", "MLFLOW_TRACKING_URI", "OMP_NUM_THREADS", "NO_ALBUMENTATIONS_UPDATE")
"""Variables that steps need on the cluster. Secrets (of the database, of the store) are not among them, since Ray shows
a job's variables to everybody: hosts have them in their own environment."""


def steps_on_ray(environment: Mapping[str, str] = os.environ) -> dg.ExecutorDefinition | None:
    """What runs each step as a job of the Ray cluster, where the environment asks for that.

    Such a job holds no core, so that it never keeps one from the tasks that it waits for; a GPU or cores of its own
    are given to an asset by ``op_tags={"dagster-ray/config": {"num_cpus": 1}}``.

    Raises:
        SettingsError: another value, an executor that is not Ray, or dagster-ray is not installed.
    """
    where = environment.get(STEPS) or "local"
    if where == "local":
        return None
    if where != "ray":
        raise SettingsError(f"{STEPS} must be local or ray, got {where!r}")
    if environment.get(EXECUTOR) != "ray":
        raise SettingsError(f"{STEPS}=ray needs {EXECUTOR}=ray: steps on a cluster do their work there")
    if importlib.util.find_spec("dagster_ray") is None:
        raise SettingsError(f"{STEPS}=ray needs dagster-ray; install the group `cluster` of pyproject.toml")
    from dagster_ray import ray_executor

    paths = {"PATH": str(pathlib.Path(sys.executable).parent), "PYTHONPATH": str(PROJECT)}  # a step is begun by name
    variables = [name for name in environment if name.startswith(_HANDED_ON) and name != DATABASE_VARIABLE]
    variables += [f"{name}={':'.join(filter(None, (own, environment.get(name))))}" for name, own in paths.items()]
    address = environment.get(ADDRESS) or "auto"
    return ray_executor.configured({"ray": {"address": address, "env_vars": variables}})


def _number(environment: Mapping[str, str], name: str, usual: float) -> float:
    text = environment.get(name) or str(usual)
    try:
        value = float(text)
        if name == CPUS and value != int(value):
            raise ValueError
    except (ValueError, OverflowError):
        kind = "a whole number" if name == CPUS else "a number"
        raise SettingsError(f"{name} must be {kind}, got {text!r}") from None
    return value
