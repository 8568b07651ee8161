"""Dagster resources that hand plain objects to the assets."""

import dataclasses
import pathlib

import dagster as dg

from assets.interfaces import Store
from pipelines.automation.launch_check import wrong_settings
from pipelines.home import run_page
from pipelines.storage.artifact_store import places_of
from pipelines.tracking.registry import EnsembleRegistry
from pipelines.tracking.tracker import MlflowTracker

__all__ = ["RegistryResource", "StoreResource", "TrackerResource"]


class StoreResource(dg.ConfigurableResource[Store]):
    """Where inputs lie and where results go. Every step asks for it, the first ones before anything is computed."""

    home: str
    datasets: str

    def create_resource(self, context: dg.InitResourceContext) -> Store:
        refused = "" if context.run is None else wrong_settings(context.run.run_config)
        return _SharedStore(pathlib.Path(self.home), pathlib.Path(self.datasets), refused)


@dataclasses.dataclass(frozen=True)
class _SharedStore(Store):
    """Finds what another machine has finished (a member, cells of a study) as it finds what was finished here."""

    def folder(self, asset: str, name: str) -> pathlib.Path:
        folder = super().folder(asset, name)
        places_of(self.home).recall(folder)
        return folder


class TrackerResource(dg.ConfigurableResource[MlflowTracker]):
    """MLflow; every MLflow run names the Dagster run that wrote it, and its page."""

    home: str

    def create_resource(self, context: dg.InitResourceContext) -> MlflowTracker:
        return MlflowTracker(pathlib.Path(self.home), _tags(context))


class RegistryResource(dg.ConfigurableResource[EnsembleRegistry]):
    """Which frozen ensemble is in use."""

    home: str

    def create_resource(self, context: dg.InitResourceContext) -> EnsembleRegistry:
        return EnsembleRegistry(MlflowTracker(pathlib.Path(self.home), _tags(context)))


def _tags(context: dg.InitResourceContext) -> dict[str, str]:
    return {"dagster_run_id": context.run_id, "dagster_run": run_page(context.run_id)} if context.run_id else {}
