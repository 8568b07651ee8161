"""Errors that callers can catch by kind; each message names the thing, the value and what to do."""

import pathlib

__all__ = [
    "ArtifactError",
    "DataError",
    "DeltasafeError",
    "LockedError",
    "PlanningError",
    "SettingsError",
    "StaleImageError",
    "WorkerLostError",
    "WriteError",
]


class DeltasafeError(Exception):
    """Base of every error that this package raises on purpose."""


class SettingsError(DeltasafeError, ValueError):
    """A setting is outside its domain."""


class _PathError(DeltasafeError):
    """About a file or folder.

    Attributes:
        path: the file or folder.
        reason: what is wrong with it and what to do.
    """

    def __init__(self, path: str | pathlib.Path, reason: str) -> None:
        self.path = pathlib.Path(path)
        self.reason = reason
        super().__init__(f"{self.path}: {reason}")

    def __reduce__(self) -> tuple[type, tuple[pathlib.Path, str]]:
        return type(self), (self.path, self.reason)


class DataError(_PathError, ValueError):
    """A file or folder given as input is unusable."""


class ArtifactError(DataError):
    """A frozen ensemble is incomplete, altered, or of a format that this version cannot read."""


class WriteError(_PathError, OSError):
    """A file or folder cannot be written; what was there before is as it was."""


class LockedError(_PathError, RuntimeError):
    """A folder is in use by another process, which the message names."""


class PlanningError(DeltasafeError, ValueError):
    """A path or trajectory cannot be made safe; the message names the place."""


class StaleImageError(DeltasafeError, RuntimeError):
    """The image that a motion was planned from no longer shows the scene, or may not; take a new one and plan again."""


class WorkerLostError(DeltasafeError, RuntimeError):
    """A process that did a part of the work was lost again and again; what is finished is kept, and found."""
