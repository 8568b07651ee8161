"""Experiment tracking: the calls of the assets are queued on disk, and sent to MLflow when it can be reached."""

import contextlib
import logging
import pathlib
import sqlite3
import time
import urllib.error
import urllib.request
from collections.abc import Iterator, Mapping
from typing import Any

from assets.interfaces import TrainedMember
from deltasafe.io.locks import FileLock
from pipelines.home import set_quiet_environment, tracking_uri
from pipelines.tracking.call_queue import CallQueue
from pipelines.tracking.mlflow_records import MlflowRecords

_log = logging.getLogger("deltasafe.tracking")

_ESSENTIAL = ("register", "promote", "demote")
RECORDING_LOG_PREFIX = "MLflow was busy for"
"""Start of the log line with the time that recording took; the seconds follow."""


class MlflowTracker:
    """Records one parent run per ensemble, one child run per member, and versions of one registered model.

    Every call is written to a file below the home first. The next call, another process, or
    `python -m pipelines.tracking.registry replay` sends the pending calls in order. So a server that is away causes
    only a warning.

    Args:
        home: `$DELTASAFE_HOME`.
        tags: set on every MLflow run and version (Dagster's run id and its page).
    """

    def __init__(self, home: pathlib.Path, tags: Mapping[str, str] | None = None) -> None:
        self.home = home
        self.tags = dict(tags or {})
        self.pending = CallQueue(home / "mlflow" / "pending")

    def member(self, identity: str, member: TrainedMember) -> str | None:
        """Record a trained member; return the address of its run, or None if the call is pending."""
        per_epoch = member.steps_per_epoch
        epochs = [member.losses[first : first + per_epoch] for first in range(0, len(member.losses), per_epoch)]
        return self.call(
            "member",
            identity=identity,
            name=member.name,
            parameters={key: str(value) for key, value in member.parameters.items()},
            losses=list(member.losses),
            epochs={
                "loss_epoch": [sum(losses) / len(losses) for losses in epochs],
                "images_per_s": list(member.images_per_s),
            },
            data=dict(member.data),
            figure=str(member.figure),
        )

    def report(
        self, identity: str, figures: Mapping[str, float], folder: pathlib.Path, data: Mapping[str, str]
    ) -> str | None:
        """Record a calibration report in the ensemble's run; return its address, or None if the call is pending."""
        values = {key: float(value) for key, value in figures.items()}
        return self.call("report", identity=identity, figures=values, folder=str(folder), data=dict(data))

    def register(self, identity: str, folder: pathlib.Path) -> str | None:
        """Register a frozen ensemble as challenger; one with the same content keeps its version."""
        return self.call("register", identity=identity, folder=str(folder))

    def call(self, kind: str, /, **arguments: Any) -> str | None:
        """Queue a call and send all pending calls; return the address of its page, or None if it is pending.

        Raises:
            WriteError: an essential call (a registration or a decision) cannot be queued. Others cause a warning.
        """
        try:
            file = self.pending.add(kind, {**arguments, "tags": self.tags, "at_ms": int(time.time() * 1000)})
        except OSError as error:
            if kind in _ESSENTIAL:
                raise
            _log.warning("the call %s could not be queued: %s", kind, error)
            return None
        address: str | None = self.replay().get(file)
        return address

    def replay(self) -> dict[pathlib.Path, Any]:
        """Send the pending calls in order, each once; return their results by file."""
        if not self.pending.files():
            return {}
        uri = tracking_uri(self.home)
        if not is_reachable(uri):
            _log.warning("%s cannot be reached; %d calls wait for it", uri, len(self.pending.files()))
            return {}
        try:
            with self.records() as records:
                return self.pending.replay(records.make, lambda: is_reachable(uri))
        except Exception as error:  # e.g. a database that cannot be opened: the calls stay in the queue
            _log.warning("MLflow at %s cannot be used now (%s); %d calls wait", uri, error, len(self.pending.files()))
            return {}

    @contextlib.contextmanager
    def records(self) -> Iterator[MlflowRecords]:
        """Open MLflow, for one process at a time: two processes must not migrate a new SQLite database in parallel."""
        set_quiet_environment()
        (self.home / "mlflow").mkdir(parents=True, exist_ok=True)
        began_s = time.monotonic()
        with FileLock(self.home / "mlflow" / "lock"):
            yield MlflowRecords(tracking_uri(self.home), self.home)
        _log.info("%s %.2f s", RECORDING_LOG_PREFIX, time.monotonic() - began_s)


def is_reachable(uri: str, timeout_s: float = 5.0) -> bool:
    """Return whether a server answers at an address, or a database file can be opened or does not exist yet.

    MLflow itself would retry for a minute and a half in every call.
    """
    if uri.startswith("sqlite:///"):
        return _can_open(pathlib.Path(uri.removeprefix("sqlite:///")), timeout_s)
    if not uri.startswith(("http://", "https://")):
        return True
    try:
        urllib.request.urlopen(f"{uri.rstrip('/')}/health", timeout=timeout_s).close()
    except urllib.error.HTTPError:
        return True  # the server answers, perhaps with a request to log in
    except (OSError, ValueError):
        return False
    return True


def _can_open(database: pathlib.Path, timeout_s: float) -> bool:
    if not database.exists():
        return True  # it will be created
    try:
        with contextlib.closing(sqlite3.connect(database, timeout=timeout_s)) as connection:
            connection.execute("PRAGMA schema_version")
    except sqlite3.OperationalError as error:
        return "locked" in str(error)  # another process is writing
    except sqlite3.DatabaseError:
        return False
    return True
