"""Versions of the registered model: aliases, decisions, and the history of champions.

Every method has the same effect when it is called again with the same arguments.
"""

import json
from collections.abc import Sequence
from typing import Any

MODEL_NAME = "deltasafe-hand-ensemble"
CHAMPION = "champion"
CHALLENGER = "challenger"
DEMOTED_TAG = "taken_out_of_use"
"""Tag of a version with the reason of its demotion."""
_HISTORY_TAG = "champions"
_HISTORY_LENGTH = 100


class ModelVersions:
    """Versions of the model in MLflow's registry. Each holds a frozen ensemble, named by its tag ``artifact``.

    Args:
        client: an `mlflow.MlflowClient`.
    """

    def __init__(self, client: Any) -> None:
        self.client = client

    def versions(self) -> list[Any]:
        """Return all versions with their aliases, newest first."""
        found = self.client.search_model_versions(f"name='{MODEL_NAME}'")
        whole = [self.client.get_model_version(MODEL_NAME, version.version) for version in found]
        return sorted(whole, key=lambda version: int(version.version), reverse=True)

    def version_of(self, artifact: str) -> Any | None:
        """Return the version of a frozen ensemble; None if it is not registered."""
        return next((version for version in self.versions() if version.tags.get("artifact") == artifact), None)

    def champion(self) -> Any | None:
        """Return the version with the alias `champion`; None if there is none."""
        return next((version for version in self.versions() if CHAMPION in version.aliases), None)

    def history(self) -> list[str]:
        """Return the numbers of the versions that were champion, in that order; the last one is in use."""
        if not self.versions():
            return []
        return list(json.loads(self.client.get_registered_model(MODEL_NAME).tags.get(_HISTORY_TAG, "[]")))

    def make_challenger(self, version: Any) -> None:
        """Set the alias `challenger`, unless the version is the champion."""
        if not self._has_alias(CHAMPION, version):
            self.client.set_registered_model_alias(MODEL_NAME, CHALLENGER, version.version)

    def promote(self, artifact: str, reason: str, only_as_first: bool = False) -> Any:
        """Set the alias `champion`, and append the version to the history; return the version.

        Args:
            only_as_first: the decision was made without the registry. If it has another champion, refuse instead.
        """
        version, present = self._require(artifact), self.champion()
        if only_as_first and present is not None and present.version != version.version:
            reason = f"was never compared with version {present.version}, since the registry was away; freeze it again"
            return self.refuse(artifact, reason)
        self.client.set_registered_model_alias(MODEL_NAME, CHAMPION, version.version)
        if self._has_alias(CHALLENGER, version):
            self.client.delete_registered_model_alias(MODEL_NAME, CHALLENGER)
        self.client.set_model_version_tag(MODEL_NAME, version.version, "promoted", reason)
        for tag in ("refused", DEMOTED_TAG):
            if tag in version.tags:
                self.client.delete_model_version_tag(MODEL_NAME, version.version, tag)
        history = self.history()
        if history[-1:] != [str(version.version)]:
            self._write_history([*history, str(version.version)])
        return version

    def refuse(self, artifact: str, reason: str) -> Any:
        """Tag a version with the reason why it stays challenger; return the version."""
        version = self._require(artifact)
        self.client.set_model_version_tag(MODEL_NAME, version.version, "refused", reason)
        return version

    def demote(self, artifact: str, reason: str) -> Any:
        """Tag a version with the reason why it is no longer used, and remove it from the history; return it."""
        version = self._require(artifact)
        self.client.set_model_version_tag(MODEL_NAME, version.version, DEMOTED_TAG, reason)
        self._write_history([number for number in self.history() if number != str(version.version)])
        return version

    def _write_history(self, history: Sequence[str]) -> None:
        value = json.dumps(list(history)[-_HISTORY_LENGTH:])
        self.client.set_registered_model_tag(MODEL_NAME, _HISTORY_TAG, value)

    def _has_alias(self, alias: str, version: Any) -> bool:
        return alias in self.client.get_model_version(MODEL_NAME, version.version).aliases

    def _require(self, artifact: str) -> Any:
        version = self.version_of(artifact)
        if version is None:
            raise LookupError(f"{MODEL_NAME} has no version with the content {artifact}; freeze and register it again")
        return version
