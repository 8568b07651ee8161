"""Choose the executor of long work by environment variables: processes of this machine, or a Ray cluster.

| variable | values |
|---|---|
| `DELTASAFE_EXECUTOR` | `local` (default) or `ray` |
| `DELTASAFE_RAY_ADDRESS` | `auto` (default: the cluster of this machine), `host:port` or `ray://host:port` |
| `DELTASAFE_GPUS_PER_MEMBER` | fraction of a GPU to train a member, from 0 (default: train on CPUs) to 1 |
| `DELTASAFE_CPUS_PER_MEMBER` | cores and threads to train a member (default 1) |
| `DELTASAFE_STEPS` | where Dagster's steps run: `local` (default), or `ray` for jobs of the cluster |
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
from pipelines.addresses import masked
from pipelines.home import DATABASE_VARIABLE, PROJECT

EXECUTOR, ADDRESS = "DELTASAFE_EXECUTOR", "DELTASAFE_RAY_ADDRESS"
STEPS = "DELTASAFE_STEPS"
GPUS, CPUS = "DELTASAFE_GPUS_PER_MEMBER", "DELTASAFE_CPUS_PER_MEMBER"


class ExecutorResource(dg.ConfigurableResource[Executor]):
    """The executor that assets use. The settings besides `name` apply to Ray only."""

    name: str
    address: str
    cpus_per_member: int
    gpus_per_member: float

    @classmethod
    def from_environment(cls, environment: Mapping[str, str] = os.environ) -> "ExecutorResource":
        """Create the resource that the environment variables describe.

        Raises:
            SettingsError: a variable is invalid, or the executor is not installed.
        """
        name, default = environment.get(EXECUTOR) or "local", RaySettings()
        if name not in ("local", "ray"):
            raise SettingsError(f"{EXECUTOR} must be local or ray, got {name!r}")
        resource = cls(
            name=name,
            address=environment.get(ADDRESS) or default.address,
            cpus_per_member=int(_number(environment, CPUS, default.cpus_per_member)),
            gpus_per_member=_number(environment, GPUS, default.gpus_per_member),
        )
        resource.executor()
        return resource

    def executor(self) -> Executor:
        """Create the executor; it connects to a cluster when the first task is submitted."""
        settings = RaySettings(self.address, self.cpus_per_member, self.gpus_per_member)
        return RayExecutor(settings) if self.name == "ray" else LOCAL

    def create_resource(self, context: dg.InitResourceContext) -> Executor:
        return self.executor()


_FORWARDED = ("DELTASAFE_", "DAGSTER_", "MLFLOW_TRACKING_URI", "OMP_NUM_THREADS", "NO_ALBUMENTATIONS_UPDATE")
"""Prefixes of the variables that steps need on the cluster. Ray shows the variables of a job to all users, so secrets
and addresses with a password are not forwarded: the hosts set them in their own environment."""


def ray_step_executor(environment: Mapping[str, str] = os.environ) -> dg.ExecutorDefinition | None:
    """Return an executor that runs each step as a job of the Ray cluster, if `DELTASAFE_STEPS` is `ray`; else None.

    Such a job reserves no core, so that it never blocks the tasks that it waits for. An asset reserves cores or a GPU
    by ``op_tags={"dagster-ray/config": {"num_cpus": 1}}``.

    Raises:
        SettingsError: the variable is invalid, the executor is not Ray, or dagster-ray is not installed.
    """
    place = environment.get(STEPS) or "local"
    if place == "local":
        return None
    if place != "ray":
        raise SettingsError(f"{STEPS} must be local or ray, got {place!r}")
    if environment.get(EXECUTOR) != "ray":
        raise SettingsError(f"{STEPS}=ray needs {EXECUTOR}=ray: steps on a cluster use its executor")
    if importlib.util.find_spec("dagster_ray") is None:
        raise SettingsError(f"{STEPS}=ray needs dagster-ray; install the group `cluster` of pyproject.toml")
    from dagster_ray import ray_executor

    variables = [
        name
        for name, value in environment.items()
        if name.startswith(_FORWARDED) and name != DATABASE_VARIABLE and masked(value) == value
    ]
    paths = {"PATH": str(pathlib.Path(sys.executable).parent), "PYTHONPATH": str(PROJECT)}  # to find `dagster` and us
    variables += [f"{name}={':'.join(filter(None, (own, environment.get(name))))}" for name, own in paths.items()]
    address = environment.get(ADDRESS) or "auto"
    return ray_executor.configured({"ray": {"address": address, "env_vars": variables}})


def _number(environment: Mapping[str, str], name: str, default: float) -> float:
    text = environment.get(name) or str(default)
    try:
        value = float(text)
        if name == CPUS and value != int(value):
            raise ValueError
    except (ValueError, OverflowError):
        kind = "a whole number" if name == CPUS else "a number"
        raise SettingsError(f"{name} must be {kind}, got {text!r}") from None
    return value
