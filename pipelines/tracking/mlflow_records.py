"""What stands in MLflow: runs of ensembles and members, data sets, figures, versions of the model.

Every method does the same when it is called again with the same arguments: runs are found by tags, points of a curve
carry the time of the call, versions are found by the content of the ensemble.
"""

import json
import os
import pathlib
import warnings
from collections.abc import Mapping, Sequence
from importlib.metadata import version
from typing import Any

from pipelines.home import PROJECT, TRACKING_VARIABLE, mlflow_ui

__all__ = ["CHALLENGER", "CHAMPION", "EXPERIMENT", "MODEL_NAME", "MlflowRecords"]

EXPERIMENT = "deltasafe"
MODEL_NAME = "deltasafe-hand-ensemble"
CHAMPION = "champion"
CHALLENGER = "challenger"

_MODEL_CODE = pathlib.Path(__file__).with_name("mlflow_model.py")
_REQUIREMENTS = ("torch", "torchvision", "timm", "safetensors", "numpy", "opencv-python-headless")
_IDENTITY = "deltasafe.identity"
_MEMBER = "deltasafe.member"
_POINTS = 200
_DIGEST_LENGTH = 36


class MlflowRecords:
    """MLflow at an address.

    Args:
        uri: of a database or a server.
        home: artifacts of a database lie below it; a server keeps them itself.
    """

    def __init__(self, uri: str, home: pathlib.Path) -> None:
        import mlflow

        # MLflow also writes the address to the environment, where it would pass for what the user has chosen
        chosen = os.environ.get(TRACKING_VARIABLE)
        mlflow.set_tracking_uri(uri)
        os.environ.pop(TRACKING_VARIABLE, None)
        if chosen is not None:
            os.environ[TRACKING_VARIABLE] = chosen
        self.uri = uri
        self.client = mlflow.MlflowClient(uri)
        known = self.client.get_experiment_by_name(EXPERIMENT)
        location = None if uri.startswith("http") else (home / "mlflow" / "artifacts").as_uri()
        self.experiment = known.experiment_id if known else self.client.create_experiment(EXPERIMENT, location)

    def make(self, name: str, arguments: dict[str, Any]) -> str:
        """Make the call ``name`` of `MlflowTracker`; the address of the page that shows it."""
        address: str = getattr(self, f"record_{name}")(**arguments)
        return address

    def record_member(
        self,
        identity: str,
        name: str,
        parameters: Mapping[str, str],
        losses: Sequence[float],
        epochs: Mapping[str, Sequence[float]],
        data: Mapping[str, str],
        figure: str,
        tags: Mapping[str, str],
        at_ms: int,
    ) -> str:
        """A child run: parameters, loss by step, means by epoch, the data that it saw, the picture of its curve."""
        from mlflow.entities import Metric, Param

        parent = self._run(identity, "", tags)
        child = self._run(identity, name, {**tags, "mlflow.parentRunId": parent})
        run = self.client.get_run(child)
        if "loss" not in run.data.metrics:
            stride = max(1, len(losses) // _POINTS)
            metrics = [Metric("loss", losses[k], at_ms, k) for k in range(0, len(losses), stride)]
            for key, values in epochs.items():
                metrics += [Metric(key, value, at_ms, epoch) for epoch, value in enumerate(values, start=1)]
            for first in range(0, len(metrics), 1000):
                self.client.log_batch(child, metrics=metrics[first : first + 1000])
        shared = {key: value for key, value in parameters.items() if key != "seed"}
        for target, meant in ((child, dict(parameters)), (parent, shared)):
            known = self.client.get_run(target).data.params
            new = [Param(key, value) for key, value in meant.items() if key not in known]
            self.client.log_batch(target, params=new)
        self._log_data(child, data, "training")
        if pathlib.Path(figure).is_file():
            self.client.log_artifact(child, figure, "figures")
        self.client.set_terminated(child)
        return self._page(child)

    def record_report(
        self,
        identity: str,
        figures: Mapping[str, float],
        folder: str,
        data: Mapping[str, str],
        tags: Mapping[str, str],
        at_ms: int,
    ) -> str:
        """Figures of a calibration report, its files, and the images that it judged on, with the ensemble's run."""
        from mlflow.entities import Metric

        if not pathlib.Path(folder).is_dir():
            raise FileNotFoundError(f"{folder} is gone; make the report again")
        run = self._run(identity, "", tags)
        self.client.log_batch(run, metrics=[Metric(key, value, at_ms, 0) for key, value in figures.items()])
        self._log_data(run, data, "testing")
        self.client.log_artifacts(run, folder, "calibration_report")
        self.client.set_terminated(run)
        return self._page(run)

    def record_register(self, identity: str, folder: str, tags: Mapping[str, str], at_ms: int) -> str:
        """The frozen folder as a model with signature and example, as a version, with the alias `challenger`."""
        import mlflow

        frozen = pathlib.Path(folder)
        run = self._run(identity, "", tags)
        found = self.version_of(frozen.name)
        if found is None:
            with mlflow.start_run(run_id=run), warnings.catch_warnings():
                # it advises type hints; the signature below says more than they do
                warnings.simplefilter("ignore", UserWarning)
                model = mlflow.pyfunc.log_model(
                    name="ensemble",
                    python_model=str(_MODEL_CODE),
                    artifacts={"ensemble": folder},
                    code_paths=[str(PROJECT / "deltasafe")],
                    pip_requirements=[f"{name}=={version(name)}" for name in _REQUIREMENTS],
                    signature=_signature(),
                    input_example=_example(),
                    tags={"artifact": frozen.name},
                )
            known = {**tags, "artifact": frozen.name, _IDENTITY: identity}
            found = mlflow.register_model(model.model_uri, MODEL_NAME, tags=known)
        if not self._has_alias(CHAMPION, found.version):
            self.client.set_registered_model_alias(MODEL_NAME, CHALLENGER, found.version)
        return self._page(run)

    def record_promote(
        self, artifact: str, because: str, tags: Mapping[str, str], at_ms: int, only_as_first: bool = False
    ) -> str:
        """The alias `champion` to the version with that content, and a line in the history of champions.

        Args:
            only_as_first: it was promoted where no champion was known; if there is one after all, it stays.
        """
        found, present = self._require(artifact), self.champion()
        if only_as_first and present is not None and present.version != found.version:
            reason = f"was never compared with version {present.version}, since the registry was away; freeze it again"
            return self.record_refuse(artifact, reason, tags, at_ms)
        self.client.set_registered_model_alias(MODEL_NAME, CHAMPION, found.version)
        if self._has_alias(CHALLENGER, found.version):
            self.client.delete_registered_model_alias(MODEL_NAME, CHALLENGER)
        self.client.set_model_version_tag(MODEL_NAME, found.version, "promoted", because)
        for tag in ("refused", "taken_out_of_use"):
            if tag in found.tags:
                self.client.delete_model_version_tag(MODEL_NAME, found.version, tag)
        history = self.history()
        if history[-1:] != [str(found.version)]:
            self._write_history([*history, str(found.version)])
        return self._page(found.run_id) if found.run_id else self.uri

    def record_refuse(self, artifact: str, because: str, tags: Mapping[str, str], at_ms: int) -> str:
        """The version with that content stays challenger; the reason stands on it."""
        found = self._require(artifact)
        self.client.set_model_version_tag(MODEL_NAME, found.version, "refused", because)
        return self._page(found.run_id) if found.run_id else self.uri

    def record_take_out(self, artifact: str, because: str, tags: Mapping[str, str], at_ms: int) -> str:
        """The version with that content was in use and is no longer; it leaves the history of champions."""
        found = self._require(artifact)
        self.client.set_model_version_tag(MODEL_NAME, found.version, "taken_out_of_use", because)
        self._write_history([number for number in self.history() if number != str(found.version)])
        return self.uri

    def versions(self) -> list[Any]:
        """All versions, newest first, with their aliases."""
        found = self.client.search_model_versions(f"name='{MODEL_NAME}'")
        return sorted((self.client.get_model_version(MODEL_NAME, v.version) for v in found), key=_number)[::-1]

    def version_of(self, artifact: str) -> Any | None:
        """The version with that content, if there is one."""
        return next((found for found in self.versions() if found.tags.get("artifact") == artifact), None)

    def champion(self) -> Any | None:
        """The version with the alias `champion`."""
        return next((found for found in self.versions() if CHAMPION in found.aliases), None)

    def history(self) -> list[str]:
        """Versions in the order in which they became champion; the last one is in use. MLflow's own are str or int."""
        if not self.versions():
            return []
        return list(json.loads(self.client.get_registered_model(MODEL_NAME).tags.get("champions", "[]")))

    def _write_history(self, history: Sequence[str]) -> None:
        self.client.set_registered_model_tag(MODEL_NAME, "champions", json.dumps(list(history)[-100:]))

    def _has_alias(self, alias: str, number: Any) -> bool:
        return alias in self.client.get_model_version(MODEL_NAME, number).aliases

    def _require(self, artifact: str) -> Any:
        found = self.version_of(artifact)
        if found is None:
            raise LookupError(f"{MODEL_NAME} has no version with the content {artifact}; freeze and register it again")
        return found

    def _run(self, identity: str, member: str, tags: Mapping[str, str]) -> str:
        name = member or f"ensemble {identity[:8]}"
        query = f"tags.`{_IDENTITY}` = '{identity}' and tags.`{_MEMBER}` = '{member or '-'}'"
        found = self.client.search_runs([self.experiment], query, max_results=1)
        known = {**tags, _IDENTITY: identity, _MEMBER: member or "-"}
        if not found:
            run_id: str = self.client.create_run(self.experiment, tags=known, run_name=name).info.run_id
            return run_id
        for key, value in known.items():
            if found[0].data.tags.get(key) != value:
                self.client.set_tag(found[0].info.run_id, key, value)
        return str(found[0].info.run_id)

    def _log_data(self, run: str, data: Mapping[str, str], use: str) -> None:
        from mlflow.entities import Dataset, DatasetInput, InputTag

        inputs = [
            DatasetInput(
                Dataset(name, digest[:_DIGEST_LENGTH], "local", json.dumps({"sha256": digest})),
                [InputTag("mlflow.data.context", use)],
            )
            for name, digest in data.items()
        ]
        self.client.log_inputs(run, datasets=inputs)

    def _page(self, run: str) -> str:
        return f"{mlflow_ui(self.uri)}/#/experiments/{self.experiment}/runs/{run}"


def _number(found: Any) -> int:
    return int(found.version)


def _example() -> Any:
    """Two images: an example of one would suggest that batches of one are all there is."""
    import numpy as np

    gradient = np.linspace(0, 255, 48 * 64 * 3).reshape(48, 64, 3).astype(np.uint8)
    return np.stack([gradient, gradient[::-1]])


def _signature() -> Any:
    import numpy as np
    from mlflow.models import ModelSignature
    from mlflow.types import Schema, TensorSpec

    images = TensorSpec(np.dtype(np.uint8), (-1, -1, -1, 3), "images")
    p_occupied = TensorSpec(np.dtype(np.float32), (-1, -1, -1), "p_occupied")
    return ModelSignature(inputs=Schema([images]), outputs=Schema([p_occupied]))
