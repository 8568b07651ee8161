"""Interfaces between the assets and `pipelines`: store of folders, experiment tracker, registry of ensembles."""

import dataclasses
import pathlib
from collections.abc import Mapping, Sequence
from typing import Protocol

from deltasafe.errors import SettingsError


@dataclasses.dataclass(frozen=True)
class Store:
    """Folders of inputs and results.

    Attributes:
        home: `$DELTASAFE_HOME`.
        datasets: the packaged inputs, read-only.
        refused: why this run must not start (invalid settings); empty if it may.
    """

    home: pathlib.Path
    datasets: pathlib.Path
    refused: str = ""

    def folder(self, asset: str, name: str) -> pathlib.Path:
        """Return the folder of one version of an asset. The caller writes it atomically.

        Raises:
            SettingsError: ``name`` (e.g. from a partition key) would lead out of the folder of the asset.
        """
        if pathlib.PurePath(name).name != name or name in ("", "..") or not name.isprintable():
            raise SettingsError(f"{name!r:.80} cannot be the name of a folder; give one without slashes")
        return self.home / "store" / asset / name

    def dataset(self, chosen: str, packaged: str) -> tuple[pathlib.Path, pathlib.Path | None]:
        """Return folder and checksum registry of an input: the packaged one, or ``chosen`` (without a registry)."""
        if chosen:
            return pathlib.Path(chosen).expanduser(), None
        return self.datasets / packaged, self.datasets / "registry.sha256"


@dataclasses.dataclass(frozen=True)
class TrainedMember:
    """The record of a trained member.

    Attributes:
        name: name of the member.
        parameters: settings and seed; nested names are joined by a dot.
        losses: loss of every step.
        steps_per_epoch: number of steps per epoch.
        images_per_s: training speed at the end of every epoch; empty if the member was already trained.
        data: digests of the training data, by name.
        figure: path of the figure of the loss.
        trained_ms: start and end of the training in this run, in Unix milliseconds; None if it was already trained.
    """

    name: str
    parameters: Mapping[str, object]
    losses: Sequence[float]
    steps_per_epoch: int
    images_per_s: Sequence[float]
    data: Mapping[str, str]
    figure: pathlib.Path
    trained_ms: tuple[int, int] | None = None


class Tracker(Protocol):
    """Experiment tracking: one parent run per ensemble, found by its identity, and one child run per member.

    A call that cannot be recorded now is queued. The methods return the address of the run's page, or None if the call
    is queued.
    """

    def member(self, identity: str, member: TrainedMember) -> str | None:
        """Record a trained member."""

    def report(
        self, identity: str, figures: Mapping[str, float], folder: pathlib.Path, data: Mapping[str, str]
    ) -> str | None:
        """Record a calibration report; ``data`` are the digests of the test images, by name."""

    def register(self, identity: str, folder: pathlib.Path) -> str | None:
        """Register a frozen ensemble as a version of the model, with the alias `challenger`."""


class Registry(Protocol):
    """The registry of frozen ensembles and the one in use."""

    def champion(self) -> pathlib.Path | None:
        """Return the folder of the ensemble in use; None before the first promotion."""

    def objection(self, folder: pathlib.Path) -> str:
        """Return the decision of a person that forbids to promote ``folder`` for its figures; empty if none does."""

    def decide(self, folder: pathlib.Path, promoted: bool, reason: str) -> pathlib.Path:
        """Promote or refuse ``folder`` and record the reason; return the folder of the ensemble in use."""
