"""Dagster resources that create the plain objects which assets use."""

import contextlib
import dataclasses
import functools
import getpass
import pathlib

import dagster as dg

from assets.interfaces import Store
from pipelines.automation.launch_check import wrong_settings
from pipelines.commands.provenance import commit
from pipelines.home import run_page
from pipelines.storage.artifact_store import artifact_store
from pipelines.tracking.registry import EnsembleRegistry
from pipelines.tracking.tracker import MlflowTracker


class StoreResource(dg.ConfigurableResource[Store]):
    """Folders of inputs and results. Every step uses it, so it also validates the settings of the run (`refused`)."""

    home: str
    datasets: str

    def create_resource(self, context: dg.InitResourceContext) -> Store:
        refused = "" if context.run is None else wrong_settings(context.run.run_config)
        return _SharedStore(pathlib.Path(self.home), pathlib.Path(self.datasets), refused)


@dataclasses.dataclass(frozen=True)
class _SharedStore(Store):
    """Also finds results of other machines, e.g. a trained member or cells of a study."""

    def folder(self, asset: str, name: str) -> pathlib.Path:
        folder = super().folder(asset, name)
        artifact_store(self.home).restore(folder)
        return folder


class TrackerResource(dg.ConfigurableResource[MlflowTracker]):
    """The MLflow tracker. It tags every MLflow run with the Dagster run and its page."""

    home: str

    def create_resource(self, context: dg.InitResourceContext) -> MlflowTracker:
        return MlflowTracker(pathlib.Path(self.home), _tags(context))


class RegistryResource(dg.ConfigurableResource[EnsembleRegistry]):
    """The registry of frozen ensembles and the one in use."""

    home: str

    def create_resource(self, context: dg.InitResourceContext) -> EnsembleRegistry:
        return EnsembleRegistry(MlflowTracker(pathlib.Path(self.home), _tags(context)))


def _tags(context: dg.InitResourceContext) -> dict[str, str]:
    """Return tags with the Dagster run, and what MLflow shows as created by, source and version."""
    if not context.run_id:
        return {}
    user = ""
    with contextlib.suppress(KeyError, OSError):  # a user without a name
        user = getpass.getuser()
    job = context.run.job_name if context.run else "?"
    return {
        "dagster_run_id": context.run_id,
        "dagster_run": run_page(context.run_id),
        "mlflow.user": user,
        "mlflow.source.name": f"deltasafe, Dagster job {job}",
        "mlflow.source.type": "JOB",
        "mlflow.source.git.commit": _commit(),
    }


_commit = functools.cache(commit)
