"""Versions and runs in the MLflow database of a home that may be deleted, and their deletion."""

import pathlib
import urllib.parse
import urllib.request
from collections.abc import Collection
from typing import Any

from pipelines.tracking.mlflow_records import IDENTITY_TAG, PARENT_TAG, MlflowRecords
from pipelines.tracking.model_versions import DEMOTED_TAG


def superfluous_versions(records: MlflowRecords, n_kept: int, oldest_ms: int) -> list[Any]:
    """Return versions that are older than ``oldest_ms`` and not needed.

    Needed are the ``n_kept`` newest versions and latest champions, all with an alias, all that are newer than the
    champion, and those that a person took out of use: their tag forbids to promote the same content again. While a
    person has left the model without a champion, all are needed.
    """
    champion = records.champion()
    if champion is None:
        return []
    history = [*reversed(list(dict.fromkeys(reversed(records.history()))))]
    recent = set(history[max(0, len(history) - n_kept) :])
    return [
        version
        for version in records.versions()[n_kept:]
        if int(version.version) < int(champion.version)
        and str(version.version) not in recent
        and not version.aliases
        and DEMOTED_TAG not in version.tags
        and version.creation_timestamp < oldest_ms
    ]


def superfluous_runs(
    records: MlflowRecords, needed: Collection[str], dagster_runs: Collection[str], n_kept: int, oldest_ms: int
) -> list[tuple[str, list[pathlib.Path]]]:
    """Return ids and artifact folders of runs of ensembles, each after its members, that are not needed.

    Args:
        needed: ids of the runs of registered versions, and identities of their ensembles.
        dagster_runs: ids of the Dagster runs that are kept; what they recorded is needed.
        n_kept: number of the newest ensembles that are needed.
        oldest_ms: younger runs are needed.
    """
    found = records.client.search_runs([records.experiment], max_results=50_000)
    parents = [run for run in found if IDENTITY_TAG in run.data.tags and PARENT_TAG not in run.data.tags]
    parents.sort(key=lambda run: run.info.start_time, reverse=True)
    free = [
        run.info.run_id
        for run in parents[n_kept:]
        if not {run.info.run_id, run.data.tags[IDENTITY_TAG]}.intersection(needed)
        and run.data.tags.get("dagster_run_id") not in dagster_runs
        and max(run.info.start_time, run.info.end_time or 0) < oldest_ms
    ]
    by_id = {run.info.run_id: run for run in found}
    ordered = [run.info.run_id for run in found if run.data.tags.get(PARENT_TAG) in free] + free
    return [(run, _folders(records, by_id[run])) for run in ordered]


def delete_version(records: MlflowRecords, version: Any) -> None:
    """Delete a version of the model."""
    records.client.delete_model_version(records.name, version.version)


def delete_run(records: MlflowRecords, run: str) -> None:
    """Delete a run and its logged models for good. `mlflow gc` would also delete what a person can still restore."""
    store = records.client._tracking_client.store
    for model in _models(records, run):
        records.client.delete_logged_model(model.model_id)
        store._hard_delete_logged_model(model.model_id)
    records.client.delete_run(run)
    store._hard_delete_run(run)


def _models(records: MlflowRecords, run: str) -> list[Any]:
    return list(records.client.search_logged_models([records.experiment], f"source_run_id = '{run}'"))


def _folders(records: MlflowRecords, run: Any) -> list[pathlib.Path]:
    uris = [run.info.artifact_uri, *(model.artifact_location for model in _models(records, run.info.run_id))]
    paths = [pathlib.Path(urllib.request.url2pathname(urllib.parse.urlsplit(str(uri)).path)) for uri in uris]
    return [path.parent if path.name == "artifacts" else path for path in paths]
