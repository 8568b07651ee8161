"""Where a study keeps what it made: every folder is named by the digest of all that determines it."""

import dataclasses
import functools
import pathlib

import deltasafe
from deltasafe.io.storage import digest_of, sha256_of_file

__all__ = ["StudyStore", "digest_of_sources"]


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


@functools.cache
def digest_of_sources(*modules: str) -> str:
    """SHA-256 over sources of this package, read once: modules (``a/b.py``) or packages (``a/b``)."""
    root = pathlib.Path(deltasafe.__file__).parent
    files = [
        file for name in modules for file in ([root / name] if name.endswith(".py") else (root / name).rglob("*.py"))
    ]
    return digest_of({file.relative_to(root).as_posix(): sha256_of_file(file) for file in files})
