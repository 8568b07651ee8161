"""Experiment tracking and model registry: MLflow on SQLite below the home, written to directly."""

import contextlib
import pathlib
import time
import warnings
from collections.abc import Iterator, Mapping, Sequence
from importlib.metadata import version
from typing import TYPE_CHECKING, Any

from pipelines.home import PROJECT, FileLock, set_quiet_environment, tracking_uri

if TYPE_CHECKING:
    from mlflow import MlflowClient

__all__ = ["ALIAS", "EXPERIMENT", "MODEL_NAME", "MlflowTracker"]

EXPERIMENT = "deltasafe"
MODEL_NAME = "deltasafe-hand-ensemble"
ALIAS = "champion"

_MODEL_CODE = pathlib.Path(__file__).with_name("mlflow_model.py")
_REQUIREMENTS = ("torch", "torchvision", "timm", "safetensors", "numpy", "opencv-python-headless")
_IDENTITY = "deltasafe.identity"
_MEMBER = "deltasafe.member"


class MlflowTracker:
    """One parent run an ensemble, found or created by its identity; one child run a member.

    A backfill is many Dagster runs in many processes, so runs are looked up by tag, under a lock, and never
    kept in memory.

    Args:
        home: `$DELTASAFE_HOME`.
        tags: written to every run that is touched (Dagster's run id).
    """

    def __init__(self, home: pathlib.Path, tags: Mapping[str, str] | None = None) -> None:
        self.home = home
        self.tags = dict(tags or {})

    def member(self, identity: str, name: str, parameters: Mapping[str, object], losses: Sequence[float]) -> None:
        """Record a trained member, once, as a child run of its ensemble."""
        from mlflow.entities import Metric, Param

        with self._client() as client:
            parent = self._run(client, identity, {"mlflow.runName": f"ensemble {identity[:8]}"}, "")
            child = self._run(client, identity, {"mlflow.runName": name, "mlflow.parentRunId": parent}, member=name)
            now_ms = int(time.time() * 1000)
            stride = max(1, len(losses) // 200)
            metrics = [Metric("loss", losses[k], now_ms, k) for k in range(0, len(losses), stride)]
            known = client.get_run(child).data.params
            new = [Param(key, str(value)) for key, value in parameters.items() if key not in known]
            if client.get_metric_history(child, "loss"):
                metrics = []  # this member is known already
            client.log_batch(child, metrics=metrics, params=new)
            client.set_terminated(child)

    def report(self, identity: str, figures: Mapping[str, float], folder: pathlib.Path) -> None:
        """Record the figures of a calibration report and its files with the ensemble's run."""
        from mlflow.entities import Metric

        with self._client() as client:
            run = self._run(client, identity, {"mlflow.runName": f"ensemble {identity[:8]}"}, "")
            now_ms = int(time.time() * 1000)
            client.log_batch(run, metrics=[Metric(k, float(v), now_ms, 0) for k, v in figures.items()])
            client.log_artifacts(run, str(folder), "calibration_report")
            client.set_terminated(run)

    def register(self, identity: str, folder: pathlib.Path, tags: Mapping[str, str]) -> str:
        """Log the frozen ``folder`` as a model, register it, and move the alias to it; unchanged content is kept."""
        import mlflow

        with self._client() as client:
            for known in self._versions(client):
                if known.tags.get("artifact") == folder.name:
                    client.set_registered_model_alias(MODEL_NAME, ALIAS, known.version)
                    return f"models:/{MODEL_NAME}@{ALIAS}"
            run = self._run(client, identity, {"mlflow.runName": f"ensemble {identity[:8]}"}, "")
            mlflow.set_tracking_uri(tracking_uri(self.home))
            with mlflow.start_run(run_id=run), warnings.catch_warnings():
                # it advises type hints and an input example; the signature below says more than either
                warnings.simplefilter("ignore", UserWarning)
                mlflow.pyfunc.log_model(
                    name="ensemble",
                    python_model=str(_MODEL_CODE),
                    artifacts={"ensemble": str(folder)},
                    code_paths=[str(PROJECT / "deltasafe")],
                    pip_requirements=[f"{name}=={version(name)}" for name in _REQUIREMENTS],
                    signature=_signature(),
                    registered_model_name=MODEL_NAME,
                )
            newest = max(self._versions(client), key=lambda found: int(found.version))
            for key, value in {**tags, "artifact": folder.name}.items():
                client.set_model_version_tag(MODEL_NAME, newest.version, key, value)
            client.set_registered_model_alias(MODEL_NAME, ALIAS, newest.version)
        return f"models:/{MODEL_NAME}@{ALIAS}"

    @contextlib.contextmanager
    def _client(self) -> "Iterator[MlflowClient]":
        """A client, alone in the database: a fresh SQLite file does not survive two migrations at once."""
        set_quiet_environment()
        (self.home / "mlflow").mkdir(parents=True, exist_ok=True)
        with FileLock(self.home / "mlflow" / "lock"):
            from mlflow import MlflowClient

            client = MlflowClient(tracking_uri(self.home))
            if client.get_experiment_by_name(EXPERIMENT) is None:
                client.create_experiment(EXPERIMENT, artifact_location=(self.home / "mlflow" / "artifacts").as_uri())
            yield client

    def _run(self, client: "MlflowClient", identity: str, tags: Mapping[str, str], member: str) -> str:
        experiment = client.get_experiment_by_name(EXPERIMENT).experiment_id
        query = f"tags.`{_IDENTITY}` = '{identity}' and tags.`{_MEMBER}` = '{member or '-'}'"
        found = client.search_runs([experiment], query, max_results=1)
        if found:
            run_id: str = found[0].info.run_id
        else:
            run_id = client.create_run(
                experiment, tags={**tags, _IDENTITY: identity, _MEMBER: member or "-"}
            ).info.run_id
        for key, value in self.tags.items():
            client.set_tag(run_id, key, value)
        return run_id

    @staticmethod
    def _versions(client: "MlflowClient") -> list[Any]:
        return list(client.search_model_versions(f"name='{MODEL_NAME}'"))


def _signature() -> Any:
    import numpy as np
    from mlflow.models import ModelSignature
    from mlflow.types import Schema, TensorSpec

    images = TensorSpec(np.dtype(np.uint8), (-1, -1, -1, 3), "images")
    p_occupied = TensorSpec(np.dtype(np.float32), (-1, -1, -1), "p_occupied")
    return ModelSignature(inputs=Schema([images]), outputs=Schema([p_occupied]))
