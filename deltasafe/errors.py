"""Errors that callers can catch by kind; each message names the thing, the value and what to do."""

import pathlib

__all__ = ["ArtifactError", "DataError", "DeltasafeError", "PlanningError", "SettingsError", "StaleImageError"]


class DeltasafeError(Exception):
    """Base of every error that this package raises on purpose."""


class SettingsError(DeltasafeError, ValueError):
    """A setting is outside its domain."""


class DataError(DeltasafeError, ValueError):
    """A file or folder given as input is unusable.

    Attributes:
        path: the offending file or folder.
        reason: what is wrong with it and what to do.
    """

    def __init__(self, path: str | pathlib.Path, reason: str) -> None:
        self.path = pathlib.Path(path)
        self.reason = reason
        super().__init__(f"{self.path}: {reason}")

    def __reduce__(self) -> tuple[type, tuple[pathlib.Path, str]]:
        return type(self), (self.path, self.reason)


class ArtifactError(DataError):
    """A frozen ensemble is incomplete, altered, or of a format that this version cannot read."""


class PlanningError(DeltasafeError, ValueError):
    """A path or trajectory cannot be made safe; the message names the place."""


class StaleImageError(DeltasafeError, RuntimeError):
    """The image that a motion was planned from no longer shows the scene, or may not; take a new one and plan again."""
