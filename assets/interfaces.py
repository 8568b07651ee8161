"""What the assets ask of whoever runs them: a store of folders, and a tracker of experiments."""

import dataclasses
import pathlib
from collections.abc import Mapping, Sequence
from typing import Protocol

__all__ = ["Store", "Tracker"]


@dataclasses.dataclass(frozen=True)
class Store:
    """Where inputs lie and where everything that is made is written.

    Attributes:
        home: `$DELTASAFE_HOME`.
        datasets: the packaged inputs, immutable.
    """

    home: pathlib.Path
    datasets: pathlib.Path

    def folder(self, asset: str, name: str) -> pathlib.Path:
        """Folder of one version of an asset; the caller writes it atomically."""
        return self.home / "store" / asset / name

    def dataset(self, chosen: str, packaged: str) -> tuple[pathlib.Path, pathlib.Path | None]:
        """Folder and registry of an input: the user's (without registry) or the packaged one."""
        if chosen:
            return pathlib.Path(chosen).expanduser(), None
        return self.datasets / packaged, self.datasets / "registry.sha256"


class Tracker(Protocol):
    """Experiment tracking: one parent run an ensemble, found by its identity; one child run a member."""

    def member(self, identity: str, name: str, parameters: Mapping[str, object], losses: Sequence[float]) -> None:
        """Record a trained member."""

    def report(self, identity: str, figures: Mapping[str, float], folder: pathlib.Path) -> None:
        """Record a calibration report."""

    def register(self, identity: str, folder: pathlib.Path, tags: Mapping[str, str]) -> str:
        """Register a frozen ensemble, give it the alias that consumers pull, and return its URI."""
