"""Where a study keeps what it made: every folder is named by the digest of all that determines it."""

import dataclasses
import pathlib

__all__ = ["StudyStore"]


@dataclasses.dataclass(frozen=True)
class StudyStore:
    """Folders below one home. Members lie where the chain keeps its own, so neither trains what the other has.

    Attributes:
        home: the folder in which everything lies; it may hold other things as well.
    """

    home: pathlib.Path

    def augmented_set(self, digest: str) -> pathlib.Path:
        return self.home / "study" / "sets" / digest[:16]

    def member(self, identity: str) -> pathlib.Path:
        return self.home / "ensemble_member" / identity[:16]

    def predictions(self, digest: str) -> pathlib.Path:
        return self.home / "study" / "predictions" / digest[:16]

    def report(self, digest: str) -> pathlib.Path:
        return self.home / "study" / "reports" / digest[:16]
