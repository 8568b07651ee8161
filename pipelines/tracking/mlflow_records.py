"""The content of MLflow: runs of ensembles and members, and versions of the model.

Every call has the same effect when it is made again: runs are found by tags, versions by the content of the ensemble,
and the points of a curve have the time of the call.
"""

import dataclasses
import json
import os
import pathlib
import warnings
from collections.abc import Mapping, Sequence
from importlib.metadata import version
from typing import Any

from pipelines.home import PROJECT, TRACKING_VARIABLE, mlflow_ui
from pipelines.tracking.model_versions import MODEL_NAME, ModelVersions

__all__ = ["EXPERIMENT", "MlflowRecords"]

EXPERIMENT = "deltasafe"

_MODEL_CODE = pathlib.Path(__file__).with_name("mlflow_model.py")
_REQUIREMENTS = ("torch", "torchvision", "timm", "safetensors", "numpy", "opencv-python-headless")
_IDENTITY_TAG = "deltasafe.identity"
_MEMBER_TAG = "deltasafe.member"
_NO_MEMBER = "-"
_MAX_POINTS = 200
_MAX_DIGEST_LENGTH = 36
_BATCH = 1000


@dataclasses.dataclass(frozen=True)
class _Origin:
    """Tags and time of the original call."""

    tags: Mapping[str, str]
    at_ms: int


@dataclasses.dataclass(frozen=True)
class _Member:
    """Arguments of the call `member`, besides the identity of the ensemble.

    Attributes:
        name: name of the member.
        parameters: settings and seed.
        losses: loss of every step.
        epochs: values of every epoch, by metric.
        data: digests of the training data, by name.
        figure: path of the figure of the loss.
    """

    name: str
    parameters: Mapping[str, str]
    losses: Sequence[float]
    epochs: Mapping[str, Sequence[float]]
    data: Mapping[str, str]
    figure: str


class MlflowRecords(ModelVersions):
    """MLflow at an address.

    Args:
        uri: address of a database or a server.
        home: artifacts of a database are below it; a server stores them itself.
    """

    def __init__(self, uri: str, home: pathlib.Path) -> None:
        import mlflow

        # MLflow also writes the address to the environment, where it would look like a choice of the user
        chosen = os.environ.get(TRACKING_VARIABLE)
        mlflow.set_tracking_uri(uri)
        os.environ.pop(TRACKING_VARIABLE, None)
        if chosen is not None:
            os.environ[TRACKING_VARIABLE] = chosen
        self.uri = uri
        super().__init__(mlflow.MlflowClient(uri))
        known = self.client.get_experiment_by_name(EXPERIMENT)
        location = None if uri.startswith("http") else (home / "mlflow" / "artifacts").as_uri()
        self.experiment = known.experiment_id if known else self.client.create_experiment(EXPERIMENT, location)

    def make(self, name: str, arguments: Mapping[str, Any]) -> str:
        """Make a queued call of `MlflowTracker`; return the address of the page that shows the result."""
        values = dict(arguments)
        origin = _Origin(values.pop("tags"), values.pop("at_ms"))
        if name == "member":
            return self._record_member(values.pop("identity"), _Member(**values), origin)
        if name == "report":
            return self._record_report(origin, **values)
        if name == "register":
            return self._register(origin, **values)
        # queued as `take_out` by earlier versions
        decide = {"promote": self.promote, "refuse": self.refuse, "demote": self.demote, "take_out": self.demote}[name]
        decided = decide(values.pop("artifact"), values.pop("because"), **values)
        return self._page(decided.run_id) if decided.run_id else self.uri

    def _record_member(self, identity: str, member: _Member, origin: _Origin) -> str:
        """Record a child run: parameters, metrics by step and by epoch, training data, figure of the loss."""
        from mlflow.entities import Metric, Param

        parent = self._run(identity, "", origin.tags)
        child = self._run(identity, member.name, {**origin.tags, "mlflow.parentRunId": parent})
        if "loss" not in self.client.get_run(child).data.metrics:
            n_steps = len(member.losses)
            steps = range(0, n_steps, max(1, n_steps // _MAX_POINTS))
            metrics = [Metric("loss", member.losses[step], origin.at_ms, step) for step in steps]
            for key, values in member.epochs.items():
                metrics += [Metric(key, value, origin.at_ms, epoch) for epoch, value in enumerate(values, start=1)]
            for first in range(0, len(metrics), _BATCH):
                self.client.log_batch(child, metrics=metrics[first : first + _BATCH])
        shared = {key: value for key, value in member.parameters.items() if key != "seed"}
        for run, parameters in ((child, member.parameters), (parent, shared)):
            known = self.client.get_run(run).data.params
            new = [Param(key, value) for key, value in parameters.items() if key not in known]
            self.client.log_batch(run, params=new)
        self._log_data(child, member.data, "training")
        if pathlib.Path(member.figure).is_file():
            self.client.log_artifact(child, member.figure, "figures")
        self.client.set_terminated(child)
        return self._page(child)

    def _record_report(
        self, origin: _Origin, identity: str, figures: Mapping[str, float], folder: str, data: Mapping[str, str]
    ) -> str:
        """Record figures, files and test images of a calibration report in the run of the ensemble."""
        from mlflow.entities import Metric

        if not pathlib.Path(folder).is_dir():
            raise FileNotFoundError(f"{folder} is missing; make the report again")
        run = self._run(identity, "", origin.tags)
        self.client.log_batch(run, metrics=[Metric(key, value, origin.at_ms, 0) for key, value in figures.items()])
        self._log_data(run, data, "testing")
        self.client.log_artifacts(run, folder, "calibration_report")
        self.client.set_terminated(run)
        return self._page(run)

    def _register(self, origin: _Origin, identity: str, folder: str) -> str:
        """Register a frozen ensemble as a version of the model, with signature, example and alias `challenger`."""
        import mlflow

        artifact = pathlib.Path(folder).name
        run = self._run(identity, "", origin.tags)
        found = self.version_of(artifact)
        if found is None:
            with mlflow.start_run(run_id=run), warnings.catch_warnings():
                # MLflow recommends type hints; the signature below says more
                warnings.simplefilter("ignore", UserWarning)
                model = mlflow.pyfunc.log_model(
                    name="ensemble",
                    python_model=str(_MODEL_CODE),
                    artifacts={"ensemble": folder},
                    code_paths=[str(PROJECT / "deltasafe")],
                    pip_requirements=[f"{name}=={version(name)}" for name in _REQUIREMENTS],
                    signature=_signature(),
                    input_example=_example(),
                    tags={"artifact": artifact},
                )
            tags = {**origin.tags, "artifact": artifact, _IDENTITY_TAG: identity}
            found = mlflow.register_model(model.model_uri, MODEL_NAME, tags=tags)
        self.make_challenger(found)
        return self._page(run)

    def _run(self, identity: str, member: str, tags: Mapping[str, str]) -> str:
        """Find or create the run of an ensemble (``member`` is empty) or of a member, and set its tags."""
        name = member or f"ensemble {identity[:8]}"
        query = f"tags.`{_IDENTITY_TAG}` = '{identity}' and tags.`{_MEMBER_TAG}` = '{member or _NO_MEMBER}'"
        found = self.client.search_runs([self.experiment], query, max_results=1)
        wanted = {**tags, _IDENTITY_TAG: identity, _MEMBER_TAG: member or _NO_MEMBER}
        if not found:
            run_id: str = self.client.create_run(self.experiment, tags=wanted, run_name=name).info.run_id
            return run_id
        for key, value in wanted.items():
            if found[0].data.tags.get(key) != value:
                self.client.set_tag(found[0].info.run_id, key, value)
        return str(found[0].info.run_id)

    def _log_data(self, run: str, data: Mapping[str, str], use: str) -> None:
        from mlflow.entities import Dataset, DatasetInput, InputTag

        inputs = [
            DatasetInput(
                Dataset(name, digest[:_MAX_DIGEST_LENGTH], "local", json.dumps({"sha256": digest})),
                [InputTag("mlflow.data.context", use)],
            )
            for name, digest in data.items()
        ]
        self.client.log_inputs(run, datasets=inputs)

    def _page(self, run: str) -> str:
        return f"{mlflow_ui(self.uri)}/#/experiments/{self.experiment}/runs/{run}"


def _example() -> Any:
    """Return two images: one alone would suggest that the batch size is always one."""
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
