"""The content of MLflow: runs of ensembles and members, and versions of the model.

Every call has the same effect when it is made again: runs are found by tags, versions by the content of the ensemble,
and the points of a curve have the time of the call.
"""

import json
import os
import pathlib
import warnings
from collections.abc import Mapping
from importlib.metadata import version
from typing import Any

from deltasafe.errors import DeltasafeError
from pipelines.addresses import masked
from pipelines.home import PROJECT, TRACKING_VARIABLE, mlflow_ui, obstacle_of
from pipelines.tracking.artifact_locations import artifact_location
from pipelines.tracking.model_versions import ModelVersions, model_name

EXPERIMENT = "deltasafe"

_MODEL_CODE = pathlib.Path(__file__).with_name("mlflow_model.py")
_REQUIREMENTS = ("torch", "torchvision", "timm", "safetensors", "numpy", "opencv-python-headless")
IDENTITY_TAG = "deltasafe.identity"
PARENT_TAG = "mlflow.parentRunId"
_MEMBER_TAG = "deltasafe.member"
_NO_MEMBER = "-"
_MAX_POINTS = 200
_MAX_DIGEST_LENGTH = 36
_BATCH = 1000
_MAX_DESCRIPTION = 5000
_KIND_TAG, _KIND = "mlflow.experimentKind", "custom_model_development"
"""Lets MLflow's UI open the view for trainings; by default it opens the one for generative AI."""
_DECISION = ("by_hand", "over", "demoted")
"""Arguments of a promotion besides artifact and reason."""


class RecordingBlockedError(DeltasafeError, RuntimeError):
    """MLflow answers, but records nothing until a person acts; the message names the remedy."""


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
        super().__init__(mlflow.MlflowClient(uri), model_name(obstacle_of(home)))
        known = self.client.get_experiment_by_name(EXPERIMENT)
        location = None if uri.startswith("http") else artifact_location(home)
        self.experiment = known.experiment_id if known else self.client.create_experiment(EXPERIMENT, location)
        self._is_deleted = known is not None and known.lifecycle_stage == "deleted"
        if not self._is_deleted and (known is None or _KIND_TAG not in known.tags):
            self.client.set_experiment_tag(self.experiment, _KIND_TAG, _KIND)

    def obstacle(self) -> str:
        """Return why nothing can be recorded until a person acts, and the remedy; empty if nothing hinders."""
        if not self._is_deleted:
            return ""
        command = f"MLFLOW_TRACKING_URI={masked(self.uri)} mlflow experiments restore"
        return f"the experiment {EXPERIMENT} was deleted in MLflow; {command} --experiment-id {self.experiment}"

    def make(self, name: str, arguments: Mapping[str, Any]) -> str:
        """Make a queued call of `MlflowTracker`; return the address of the page that shows the result.

        Raises:
            RecordingBlockedError: the experiment was deleted.
        """
        if self._is_deleted:
            raise RecordingBlockedError(self.obstacle())
        if name in ("member", "report", "register"):
            run: str = getattr(self, f"_record_{name}")(arguments)
            return self._page(run)
        decision = {key: value for key, value in arguments.items() if key in _DECISION}
        version = {"promote": self.promote, "refuse": self.refuse}[name](
            arguments["artifact"], arguments["because"], **decision
        )
        return self._page(version.run_id) if version.run_id else mlflow_ui(self.uri)

    def _record_member(self, call: Mapping[str, Any]) -> str:
        """Record a child run: parameters, metrics by step and by epoch, training data, figure of the loss."""
        from mlflow.entities import Metric, Param

        began_ms, ended_ms = call.get("trained_ms") or (call["at_ms"], call["at_ms"])
        parent = self._run(call["identity"], "", call["tags"], began_ms)
        child = self._run(call["identity"], call["name"], {**call["tags"], PARENT_TAG: parent}, began_ms)
        if "loss" not in self.client.get_run(child).data.metrics:
            losses, took_ms = call["losses"], ended_ms - began_ms
            steps = range(0, len(losses), max(1, len(losses) // _MAX_POINTS))
            times_ms = {step: began_ms + took_ms * (step + 1) // len(losses) for step in steps}
            metrics = [Metric("loss", losses[step], times_ms[step], step) for step in steps]
            for key, values in call["epochs"].items():
                for epoch, value in enumerate(values, start=1):
                    metrics.append(Metric(key, value, began_ms + took_ms * epoch // len(values), epoch))
            for first in range(0, len(metrics), _BATCH):
                self.client.log_batch(child, metrics=metrics[first : first + _BATCH])
        shared = {key: value for key, value in call["parameters"].items() if key != "seed"}
        for run, parameters in ((child, call["parameters"]), (parent, shared)):
            known = self.client.get_run(run).data.params
            new = [Param(key, value) for key, value in parameters.items() if key not in known]
            self.client.log_batch(run, params=new)
        self._log_data(child, call["data"], "training")
        if pathlib.Path(call["figure"]).is_file():
            self.client.log_artifact(child, call["figure"], "figures")
        for run in (child, parent):
            self._finish(run, ended_ms, extend=call.get("trained_ms") is not None)
        return child

    def _record_report(self, call: Mapping[str, Any]) -> str:
        """Record figures, files and test images of a calibration report in the run of the ensemble."""
        from mlflow.entities import Metric

        if not pathlib.Path(call["folder"]).is_dir():
            raise FileNotFoundError(f"{call['folder']} is missing; make the report again")
        run = self._run(call["identity"], "", call["tags"])
        metrics = [Metric(key, value, call["at_ms"], 0) for key, value in call["figures"].items()]
        self.client.log_batch(run, metrics=metrics)
        self._log_data(run, call["data"], "testing")
        self.client.log_artifacts(run, call["folder"], "calibration_report")
        self._finish(run, call["at_ms"])
        return run

    def _record_register(self, call: Mapping[str, Any]) -> str:
        """Register a frozen ensemble as a version of the model, with signature, example and alias `challenger`."""
        import mlflow

        self.adopt_decisions()  # before the version exists: a person decided without it
        artifact = pathlib.Path(call["folder"]).name
        run = self._run(call["identity"], "", call["tags"])
        found = self.version_of(artifact)
        if found is None:
            ended_ms = self.client.get_run(run).info.end_time or call["at_ms"]
            with mlflow.start_run(run_id=run), warnings.catch_warnings():
                # MLflow recommends type hints; the signature below says more
                warnings.simplefilter("ignore", UserWarning)
                model = mlflow.pyfunc.log_model(
                    name="ensemble",
                    python_model=str(_MODEL_CODE),
                    artifacts={"ensemble": call["folder"]},
                    code_paths=[str(PROJECT / "deltasafe")],
                    pip_requirements=[f"{name}=={version(name)}" for name in _REQUIREMENTS],
                    signature=_signature(),
                    input_example=_example(),
                    tags={"artifact": artifact},
                )
            self.client.set_terminated(run, end_time=ended_ms)  # the block above has set it to now
            own = {key: value for key, value in call["tags"].items() if not key.startswith("mlflow.")}
            tags = {**own, "artifact": artifact, IDENTITY_TAG: call["identity"]}
            found = mlflow.register_model(model.model_uri, self.name, tags=tags)
            card = pathlib.Path(call["folder"], "model_card.md")
            if card.is_file():
                text = card.read_text(encoding="utf-8")[:_MAX_DESCRIPTION]
                self.client.update_model_version(self.name, found.version, text)
        self.make_challenger(found)
        return run

    def _finish(self, run: str, ended_ms: int, extend: bool = False) -> None:
        """End a run. Recording the same again later does not change its end; a member trained later extends it."""
        info = self.client.get_run(run).info
        if info.status != "FINISHED" or (extend and ended_ms > (info.end_time or 0)):
            self.client.set_terminated(run, end_time=max(ended_ms, info.start_time))

    def _run(self, identity: str, member: str, tags: Mapping[str, str], began_ms: int | None = None) -> str:
        """Find or create the run of an ensemble (``member`` is empty) or of a member, and set its tags."""
        name = member or f"ensemble {identity[:8]}"
        query = f"tags.`{IDENTITY_TAG}` = '{identity}' and tags.`{_MEMBER_TAG}` = '{member or _NO_MEMBER}'"
        found = self.client.search_runs([self.experiment], query, max_results=1)
        wanted = {**tags, IDENTITY_TAG: identity, _MEMBER_TAG: member or _NO_MEMBER}
        if not found:
            created = self.client.create_run(self.experiment, began_ms, wanted, run_name=name)
            return str(created.info.run_id)
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
