"""Publish ensembles as the chain does, and read the registry of a home."""

import importlib
import pathlib
import shutil
import tempfile
import warnings

import dagster as dg
import mlflow

from assets.perception import champion
from pipelines.home import tracking_uri
from pipelines.resources import RegistryResource, StoreResource
from pipelines.storage.io_manager import FolderPointers
from pipelines.tracking.model_versions import MODEL_NAME
from pipelines.tracking.tracker import MlflowTracker

HANDS = dg.AssetKey("test_hands")
FROZEN = dg.AssetKey("frozen_ensemble")


def materialize(home, instance, folder):
    """Register ``folder`` and materialize `champion` as the chain does; return the result of the run."""
    MlflowTracker(home).register("i" * 64, folder)
    FolderPointers(home=str(home)).point(FROZEN, folder)
    resources = {
        "io_manager": FolderPointers(home=str(home)),
        "store": StoreResource(home=str(home), datasets=str(home)),
        "registry": RegistryResource(home=str(home)),
    }
    upstream = [dg.AssetSpec(FROZEN), dg.AssetSpec(HANDS)]
    return dg.materialize([champion, *upstream], resources=resources, instance=instance, raise_on_error=False)


def publish(home, instance, folder):
    """Materialize `champion`; return the check and the folder in use."""
    result = materialize(home, instance, folder)
    (check,) = result.get_asset_check_evaluations()
    return check, FolderPointers(home=str(home)).folder(dg.AssetKey("champion"), run_id=result.run_id)


def aliases(home):
    from mlflow import MlflowClient

    client = MlflowClient(tracking_uri(home))
    found = client.get_registered_model(MODEL_NAME).aliases
    return {alias: client.get_model_version(MODEL_NAME, number).tags["artifact"] for alias, number in found.items()}


def versions(home):
    with MlflowTracker(home).records() as records:
        return {found.tags["artifact"]: found for found in records.versions()}


def light_registration(patch):
    """Let ``patch`` replace the slow part of a registration by `_log_files`."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of MLflow, as it is imported
        # `mlflow.pyfunc` is a placeholder until its first use, and then replaced: a patch of the placeholder is lost
        module = importlib.import_module("mlflow.pyfunc")
    patch.setattr(module, "log_model", _log_files)


def _log_files(*, name, artifacts, **_):
    """Log the files of an ensemble alone: MLflow would run the model to infer its requirements, for seconds."""
    run, client, folder = mlflow.active_run().info, mlflow.MlflowClient(), pathlib.Path(artifacts["ensemble"])
    model = client.create_logged_model(run.experiment_id, name, run.run_id)
    with tempfile.TemporaryDirectory() as files:
        shutil.copytree(folder, pathlib.Path(files, "artifacts", folder.name))
        client.log_model_artifacts(model.model_id, files)
    return client.finalize_logged_model(model.model_id, "READY")
