"""Experiment tracking: what the assets report, written down first and sent to MLflow as soon as it can be."""

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
from pipelines.tracking.call_queue import PendingCalls
from pipelines.tracking.mlflow_records import MlflowRecords

__all__ = ["RECORDED", "MlflowTracker", "is_reachable"]

_log = logging.getLogger("deltasafe.tracking")

_NOT_TO_BE_LOST = ("register", "promote", "take_out")
RECORDED = "MLflow was busy for"
"""How the line in a step's log begins that says what the recording cost; the seconds follow."""


class MlflowTracker:
    """One parent run an ensemble, one child run a member, and versions of one registered model.

    Every call is a file below the home before it is made, and files are made calls of in order, by whoever comes next:
    the next call, another process, or `python -m pipelines.tracking.registry replay`. So a server that is away costs a warning.

    Args:
        home: `$DELTASAFE_HOME`.
        tags: written to every MLflow run and version that is touched (Dagster's run id and its page).
    """

    def __init__(self, home: pathlib.Path, tags: Mapping[str, str] | None = None) -> None:
        self.home = home
        self.tags = dict(tags or {})
        self.pending = PendingCalls(home / "mlflow" / "pending")

    def member(self, identity: str, member: TrainedMember) -> str | None:
        """Record a trained member; the address of its run's page, if it could be recorded now."""
        per_epoch = member.steps_per_epoch
        means = [
            sum(member.losses[first : first + per_epoch]) / len(member.losses[first : first + per_epoch])
            for first in range(0, len(member.losses), per_epoch)
        ]
        return self.call(
            "member",
            identity=identity,
            name=member.name,
            parameters={key: str(value) for key, value in member.parameters.items()},
            losses=list(member.losses),
            epochs={"loss_epoch": means, "images_per_s": list(member.images_per_s)},
            data=dict(member.data),
            figure=str(member.figure),
        )

    def report(
        self, identity: str, figures: Mapping[str, float], folder: pathlib.Path, data: Mapping[str, str]
    ) -> str | None:
        """Record a calibration report with the ensemble's run."""
        values = {key: float(value) for key, value in figures.items()}
        return self.call("report", identity=identity, figures=values, folder=str(folder), data=dict(data))

    def register(self, identity: str, folder: pathlib.Path) -> str | None:
        """Register a frozen ensemble as challenger; a known one keeps its version."""
        return self.call("register", identity=identity, folder=str(folder))

    def call(self, kind: str, /, **arguments: Any) -> str | None:
        """Write a call down, make what can be made; the address of its page, or None if it waits.

        Raises:
            WriteError: an ensemble or a decision cannot even be written down; of anything else that costs a warning.
        """
        try:
            file = self.pending.add(kind, {**arguments, "tags": self.tags, "at_ms": int(time.time() * 1000)})
        except OSError as error:
            if kind in _NOT_TO_BE_LOST:
                raise
            _log.warning("%s could not even be written down: %s", kind, error)
            return None
        address: str | None = self.replay().get(file)
        return address

    def replay(self) -> dict[pathlib.Path, Any]:
        """Make the calls that wait, in order, each once; what they returned, by file."""
        if not self.pending.files():
            return {}
        uri = tracking_uri(self.home)
        if not is_reachable(uri):
            _log.warning("%s cannot be reached; %d calls wait for it", uri, len(self.pending.files()))
            return {}
        try:
            with self.records() as records:
                return self.pending.make_all(records.make, lambda: is_reachable(uri))
        except Exception as error:  # a database that cannot be opened: the calls wait
            _log.warning("MLflow at %s cannot be used now (%s); %d calls wait", uri, error, len(self.pending.files()))
            return {}

    @contextlib.contextmanager
    def records(self) -> Iterator[MlflowRecords]:
        """MLflow, for one process at a time: a fresh SQLite file does not survive two migrations at once."""
        set_quiet_environment()
        (self.home / "mlflow").mkdir(parents=True, exist_ok=True)
        began_s = time.monotonic()
        with FileLock(self.home / "mlflow" / "lock"):
            yield MlflowRecords(tracking_uri(self.home), self.home)
        _log.info("%s %.2f s", RECORDED, time.monotonic() - began_s)


def is_reachable(uri: str, timeout_s: float = 5.0) -> bool:
    """Whether something answers at the address of a server, or a database in a file can be opened, if it is there.

    MLflow would go on trying to open one for a minute and a half, at every call.
    """
    if uri.startswith("sqlite:///"):
        return _opens(pathlib.Path(uri.removeprefix("sqlite:///")), timeout_s)
    if not uri.startswith(("http://", "https://")):
        return True
    try:
        urllib.request.urlopen(f"{uri.rstrip('/')}/health", timeout=timeout_s).close()
    except urllib.error.HTTPError:
        return True  # it answers, if only to ask for a login
    except (OSError, ValueError):
        return False
    return True


def _opens(database: pathlib.Path, timeout_s: float) -> bool:
    if not database.exists():
        return True  # it will be made
    try:
        with contextlib.closing(sqlite3.connect(database, timeout=timeout_s)) as connection:
            connection.execute("PRAGMA schema_version")
    except sqlite3.OperationalError as error:
        return "locked" in str(error)  # by somebody who writes, for a moment
    except sqlite3.DatabaseError:
        return False
    return True
