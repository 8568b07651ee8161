"""Versions of the registered model: aliases, decisions, and the history of champions.

Every method has the same effect when it is called again with the same arguments. The last entry of the history is the
last decision that this project recorded. If the alias `champion` differs from it, a person changed the alias in MLflow:
`adopt_decisions` records that, and figures alone never overrule a person.
"""

import json
from collections.abc import Sequence
from typing import Any

CHOOSE = "choose one: `make rollback`, or python -m pipelines.commands.registry promote VERSION --because TEXT"
"""Remedy where no version is in use."""


def model_name(obstacle: str) -> str:
    """Return the name of the registered model whose versions detect an obstacle."""
    return f"deltasafe-{obstacle.replace('_', '-')}-ensemble"


MODEL_NAME = model_name("hand")
CHAMPION = "champion"
CHALLENGER = "challenger"
DEMOTED_TAG = "taken_out_of_use"
"""Tag of a version with the reason of its demotion."""
_HISTORY_TAG = "champions"
_CHOSEN_TAG = "chosen_by_hand"
"""Tag of a champion that a person chose: number of the newest version at that time."""
_NONE_TAG = "none_in_use"
"""Tag of the model: why no version is in use. Absent before the first promotion."""
_HISTORY_LENGTH = 100


class ModelVersions:
    """Versions of the model in MLflow's registry. Each holds a frozen ensemble, named by its tag ``artifact``.

    Args:
        client: an `mlflow.MlflowClient`.
        name: of the registered model.
    """

    def __init__(self, client: Any, name: str = MODEL_NAME) -> None:
        self.client = client
        self.name = name

    def versions(self) -> list[Any]:
        """Return all versions with their aliases, newest first."""
        model = self._model()
        found = [] if model is None else self.client.search_model_versions(f"name='{self.name}'")
        for version in found:  # the search leaves the aliases out
            version.aliases = [name for name, number in model.aliases.items() if str(number) == str(version.version)]
        return sorted(found, key=lambda version: int(version.version), reverse=True)

    def version_of(self, artifact: str) -> Any | None:
        """Return the version of a frozen ensemble; None if it is not registered."""
        return next((version for version in self.versions() if version.tags.get("artifact") == artifact), None)

    def champion(self) -> Any | None:
        """Return the version with the alias `champion`; None if there is none."""
        return next((version for version in self.versions() if CHAMPION in version.aliases), None)

    def history(self) -> list[str]:
        """Return the numbers of the versions that were champion, in that order; the last one is in use."""
        return list(json.loads(self._model_tags().get(_HISTORY_TAG, "[]")))

    def none_in_use(self) -> str:
        """Return how a person left the model without a champion; empty if it has one, or never had one."""
        return str(self._model_tags().get(_NONE_TAG, ""))

    def adopt_decisions(self) -> None:
        """Record what a person did in MLflow: an alias `champion` that was moved or removed, a deleted version."""
        history, present, none = self.history(), self.champion(), self.none_in_use()
        if present is not None:
            if none or history[-1:] != [str(present.version)]:
                self._use(present, "the alias champion was set by hand in MLflow", by_hand=True)
        elif history and not none:
            last = next((each for each in self.versions() if str(each.version) == history[-1]), None)
            if last is not None:
                self.demote(last, "the alias champion was removed by hand in MLflow")
            done = "was deleted" if last is None else "lost the alias champion"
            none = f"no version is in use, since version {history[-1]} {done} in MLflow"
            self.client.set_registered_model_tag(self.name, _NONE_TAG, none)

    def objection(self, artifact: str) -> str:
        """Return the decision of a person that forbids to promote a version for its figures; empty if none does."""
        version, present = self.version_of(artifact), self.champion()
        if version is None or (present is not None and present.version == version.version):
            return ""
        if DEMOTED_TAG in version.tags:
            return f"taken out of use by hand: {version.tags[DEMOTED_TAG]}"
        if present is not None and int(version.version) <= int(present.tags.get(_CHOSEN_TAG, 0)):
            return f"version {present.version} was chosen by hand when version {version.version} already existed"
        return self.none_in_use()

    def make_challenger(self, version: Any) -> None:
        """Set the alias `challenger`, unless the version is the champion."""
        if not self._has_alias(CHAMPION, version):
            self.client.set_registered_model_alias(self.name, CHALLENGER, version.version)

    def promote(self, artifact: str, reason: str, *, by_hand: bool = False, over: str = "", demoted: str = "") -> Any:
        """Set the alias `champion`, and append the version to the history; return the version.

        Args:
            by_hand: a person decided. Otherwise the version is refused if that overrules a person.
            over: without ``by_hand``: the artifact that was in use when this was decided. If another one is in use,
                the version is refused.
            demoted: artifact to take out of use, for the same reason.
        """
        version = self._require(artifact)
        if not by_hand:
            if self.history()[-1:] != [str(version.version)]:  # otherwise this promotion was interrupted
                self.adopt_decisions()
            present = self.champion()
            if present is not None and present.version == version.version and "promoted" in version.tags:
                return version  # already in use: the reason of that decision stays
            in_use = "" if present is None else present.tags.get("artifact", "")
            objection = self.objection(artifact)
            if present is not None and in_use not in (over, artifact):
                compared = f"compared with {over}" if over else "compared with no other ensemble"
                objection = f"was {compared}, but version {present.version} is in use; freeze it again"
            if objection:
                return self.refuse(artifact, objection)
        if demoted:
            self.demote(self._require(demoted), reason)
        self._use(version, reason, by_hand)
        return version

    def refuse(self, artifact: str, reason: str) -> Any:
        """Tag a version with the reason why it stays challenger; return the version."""
        version = self._require(artifact)
        self.client.set_model_version_tag(self.name, version.version, "refused", reason)
        return version

    def demote(self, version: Any, reason: str) -> None:
        """Tag a version with the reason why it is no longer used, and remove it from the history."""
        self.client.set_model_version_tag(self.name, version.version, DEMOTED_TAG, reason)
        self._write_history([number for number in self.history() if number != str(version.version)])

    def _use(self, version: Any, reason: str, by_hand: bool) -> None:
        history, number = self.history(), version.version
        if history[-1:] != [str(number)]:  # first, so that an interrupted promotion never looks like a person's
            self._write_history([*history, str(number)])
        self.client.set_registered_model_alias(self.name, CHAMPION, number)
        if self._has_alias(CHALLENGER, version):
            self.client.delete_registered_model_alias(self.name, CHALLENGER)
        self.client.set_model_version_tag(self.name, number, "promoted", reason)
        if by_hand:
            newest = str(self.versions()[0].version)
            self.client.set_model_version_tag(self.name, number, _CHOSEN_TAG, newest)
        for tag in ("refused", DEMOTED_TAG, *(() if by_hand else (_CHOSEN_TAG,))):
            if tag in version.tags:
                self.client.delete_model_version_tag(self.name, number, tag)
        if self.none_in_use():
            self.client.delete_registered_model_tag(self.name, _NONE_TAG)

    def _model(self) -> Any:
        return next(iter(self.client.search_registered_models(f"name='{self.name}'")), None)

    def _model_tags(self) -> dict[str, str]:
        model = self._model()
        return {} if model is None else dict(model.tags)

    def _write_history(self, history: Sequence[str]) -> None:
        value = json.dumps(list(history)[-_HISTORY_LENGTH:])
        self.client.set_registered_model_tag(self.name, _HISTORY_TAG, value)

    def _has_alias(self, alias: str, version: Any) -> bool:
        model = self._model()
        return model is not None and str(model.aliases.get(alias)) == str(version.version)

    def _require(self, artifact: str) -> Any:
        version = self.version_of(artifact)
        if version is None:
            raise LookupError(f"{self.name} has no version with the content {artifact}; freeze and register it again")
        return version
