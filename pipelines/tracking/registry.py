"""The ensemble in use: the alias `champion` in MLflow, and a note below the home."""

import pathlib
from typing import Any

from deltasafe.errors import DataError
from deltasafe.io.storage import read_json, write_json
from pipelines.home import tracking_uri
from pipelines.tracking.frozen_folder import frozen_folder
from pipelines.tracking.model_versions import CHOOSE
from pipelines.tracking.tracker import MlflowTracker, is_reachable


class EnsembleRegistry:
    """The alias `champion` of the registered model, and a copy of it in ``champion.json`` below the home.

    The registry decides. The copy decides while calls of this home are pending or MLflow is away.

    Args:
        tracker: the tracker of the same home.
    """

    def __init__(self, tracker: MlflowTracker) -> None:
        self.tracker = tracker
        self._copy = tracker.home / "champion.json"

    def champion(self) -> pathlib.Path | None:
        """Return the folder of the ensemble in use, downloaded if it is missing here; None if there is none yet.

        Raises:
            DataError: a person took the last one out of use in MLflow, or its artifact is missing.
        """
        self.tracker.replay()
        noted = read_json(self._copy)["artifact"] if self._copy.is_file() else None
        if not self.is_behind():
            with self.tracker.records() as records:
                records.adopt_decisions()
                version, none = records.champion(), records.none_in_use()
                if none:
                    raise DataError(records.name, f"{none}; {CHOOSE}")
                if version is not None:
                    folder = frozen_folder(version, self.tracker.home)
                    if folder.name != noted:
                        self._write_copy(folder.name, str(version.tags.get("promoted", "")))
                    return folder
        return None if noted is None else self.tracker.home / "frozen" / noted

    def objection(self, folder: pathlib.Path) -> str:
        """Return the decision of a person that forbids to promote ``folder`` for its figures; empty if none does."""
        if not is_reachable(tracking_uri(self.tracker.home)):
            return ""
        with self.tracker.records() as records:
            records.adopt_decisions()
            return records.objection(folder.name)

    def decide(self, folder: pathlib.Path, promoted: bool, reason: str) -> pathlib.Path:
        """Promote or refuse ``folder`` and record the reason; return the folder of the ensemble in use."""
        present = self.champion()
        if promoted or present is None:
            # if MLflow is away, it may have a champion that is not known here: then it refuses this call
            over = "" if present is None else present.name
            self.tracker.call("promote", artifact=folder.name, because=reason, by_hand=False, over=over)
            self._write_copy(folder.name, reason)
            return self.champion() or folder
        self.tracker.call("refuse", artifact=folder.name, because=reason)
        return present

    def versions(self) -> list[Any]:
        """Return all versions, newest first."""
        with self.tracker.records() as records:
            return records.versions()

    def promote(self, number: str, because: str) -> pathlib.Path:
        """Use a version, as decided by a person; return its folder.

        Raises:
            DataError: the version does not exist, its artifact is missing, or the decision was not recorded.
        """
        version = next((each for each in self.versions() if str(each.version) == number), None)
        if version is None:
            raise DataError(tracking_uri(self.tracker.home), f"has no version {number}; `make registry` lists them")
        return self._choose(version, because)

    def rollback(self, because: str) -> pathlib.Path:
        """Use the previous version again, and demote the present one: only a person can promote it again.

        Nothing changes if the previous version cannot be used. Deleted versions are skipped.

        Raises:
            DataError: there is no previous version, or its artifact is missing.
        """
        with self.tracker.records() as records:
            records.adopt_decisions()
            history, present = records.history(), records.champion()
            versions = {str(version.version): version for version in records.versions()}
        number = "" if present is None else str(present.version)
        earlier = [each for each in history if each in versions and each != number]
        if not earlier:
            raise DataError(records.name, "has no version that was in use before; `make registry` lists all")
        if present is None:
            return self._choose(versions[earlier[-1]], f"rolled back: {because}")
        reason = f"rolled back from version {number}: {because}"
        return self._choose(versions[earlier[-1]], reason, demoted=str(present.tags.get("artifact", "")))

    def _choose(self, version: Any, because: str, demoted: str = "") -> pathlib.Path:
        folder = frozen_folder(version, self.tracker.home)
        arguments = {"artifact": folder.name, "because": because, "by_hand": True, "demoted": demoted}
        if self.tracker.call("promote", **arguments) is None:
            raise DataError(self.tracker.pending.folder, "holds the decision, which MLflow did not record: see above")
        self._write_copy(folder.name, because)
        return folder

    def is_behind(self) -> bool:
        """Return whether the registry lacks calls of this home, or is away."""
        return bool(self.tracker.pending.files()) or not is_reachable(tracking_uri(self.tracker.home))

    def _write_copy(self, artifact: str, because: str) -> None:
        write_json(self._copy, {"artifact": artifact, "because": because})
