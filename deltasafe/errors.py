"""Exceptions of this package. Each message names the object, the value and the remedy."""

import pathlib
from collections.abc import Sequence

_MAX_LISTED = 50
"""Defects that one message lists."""


class DeltasafeError(Exception):
    """Base class of all errors that this package raises on purpose."""


class SettingsError(DeltasafeError, ValueError):
    """A setting is outside its valid range."""


class _PathError(DeltasafeError):
    """Error about a file or folder.

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
    """A file or folder that was given as input is unusable."""

    @classmethod
    def combined(cls, folder: str | pathlib.Path, errors: "Sequence[DataError]") -> "DataError":
        """Combine the errors about files of ``folder`` into one that lists them; a single one is returned as it is."""
        if len(errors) == 1:
            return errors[0]
        listed = [f"\n- {error}" for error in errors[:_MAX_LISTED]]
        more = f"\n- and {len(errors) - _MAX_LISTED} more" if len(errors) > _MAX_LISTED else ""
        return cls(folder, f"has {len(errors)} defects:{''.join(listed)}{more}")


class ArtifactError(DataError):
    """A frozen ensemble is incomplete, altered, or of a format that this version cannot read."""


class WriteError(_PathError, OSError):
    """A file or folder cannot be written; an earlier version of it is unchanged."""


class LockedError(_PathError, RuntimeError):
    """A folder is in use by another process; the message names the process."""


class PlanningError(DeltasafeError, ValueError):
    """A path or trajectory cannot be made safe; the message names the place along it."""


class StaleImageError(DeltasafeError, RuntimeError):
    """The image behind a motion may no longer show the scene; take a new image and plan again."""


class WorkerLostError(DeltasafeError, RuntimeError):
    """A worker process was lost on every attempt; finished work is kept."""
