"""What the assets ask of whoever runs them: a store of folders, a tracker of experiments, a registry of ensembles."""

import dataclasses
import pathlib
from collections.abc import Mapping, Sequence
from typing import Protocol

from deltasafe.errors import SettingsError

__all__ = ["Registry", "Store", "Tracker", "TrainedMember"]


@dataclasses.dataclass(frozen=True)
class Store:
    """Where inputs lie and where everything that is made is written.

    Attributes:
        home: `$DELTASAFE_HOME`.
        datasets: the packaged inputs, immutable.
        refused: why nothing may be made in this run; empty if it may.
    """

    home: pathlib.Path
    datasets: pathlib.Path
    refused: str = ""

    def folder(self, asset: str, name: str) -> pathlib.Path:
        """Folder of one version of an asset; the caller writes it atomically.

        Raises:
            SettingsError: the name, which may come from a partition's, would lead out of the asset's folder.
        """
        if pathlib.PurePath(name).name != name or name in ("", "..") or not name.isprintable():
            raise SettingsError(f"{name!r:.80} cannot be the name of a folder; give one without slashes")
        return self.home / "store" / asset / name

    def dataset(self, chosen: str, packaged: str) -> tuple[pathlib.Path, pathlib.Path | None]:
        """Folder and registry of an input: the user's (without registry) or the packaged one."""
        if chosen:
            return pathlib.Path(chosen).expanduser(), None
        return self.datasets / packaged, self.datasets / "registry.sha256"


@dataclasses.dataclass(frozen=True)
class TrainedMember:
    """What is recorded of a member.

    Attributes:
        name: of the member.
        parameters: settings and seed, nested names joined by a dot.
        losses: a step.
        steps_per_epoch: so many of them are an epoch.
        images_per_s: at the end of each epoch; empty if the member was found finished.
        data: digests of what it was trained on, by name.
        figure: the picture of its loss.
    """

    name: str
    parameters: Mapping[str, object]
    losses: Sequence[float]
    steps_per_epoch: int
    images_per_s: Sequence[float]
    data: Mapping[str, str]
    figure: pathlib.Path


class Tracker(Protocol):
    """Experiment tracking: one parent run an ensemble, found by its identity; one child run a member.

    Nothing here raises: what cannot be recorded now is kept and recorded later. Each returns the address of the run's
    page, or None where it has none yet.
    """

    def member(self, identity: str, member: TrainedMember) -> str | None:
        """Record a trained member."""

    def report(
        self, identity: str, figures: Mapping[str, float], folder: pathlib.Path, data: Mapping[str, str]
    ) -> str | None:
        """Record a calibration report on the test images ``data`` (digests by name)."""

    def register(self, identity: str, folder: pathlib.Path) -> str | None:
        """Register a frozen ensemble as a version of the model, with the alias `challenger`."""


class Registry(Protocol):
    """Which frozen ensemble is in use."""

    def champion(self) -> pathlib.Path | None:
        """Folder of the ensemble in use; None if there is none yet."""

    def objection(self, folder: pathlib.Path) -> str:
        """Why a person took the ensemble ``folder`` out of use; empty if nobody did."""

    def decide(self, folder: pathlib.Path, promoted: bool, reason: str) -> pathlib.Path:
        """Put ``folder`` in use, or write down why not; returns the folder of the ensemble in use."""
