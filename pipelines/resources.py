"""Dagster resources that hand plain objects to the assets."""

import pathlib

import dagster as dg

from assets.interfaces import Store
from pipelines.tracking import MlflowTracker

__all__ = ["StoreResource", "TrackerResource"]


class StoreResource(dg.ConfigurableResource[Store]):
    """Where inputs lie and where results go."""

    home: str
    datasets: str

    def create_resource(self, context: dg.InitResourceContext) -> Store:
        return Store(pathlib.Path(self.home), pathlib.Path(self.datasets))


class TrackerResource(dg.ConfigurableResource[MlflowTracker]):
    """MLflow below the home; every MLflow run carries the Dagster run that wrote it."""

    home: str

    def create_resource(self, context: dg.InitResourceContext) -> MlflowTracker:
        return MlflowTracker(pathlib.Path(self.home), {"dagster_run_id": context.run_id or ""})
