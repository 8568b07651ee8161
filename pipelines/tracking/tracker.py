"""Experiment tracking: the calls of the assets are queued on disk, and sent to MLflow when it can be reached."""

import contextlib
import logging
import pathlib
import re
import sqlite3
import time
from collections.abc import Iterator, Mapping
from typing import Any

from assets.interfaces import TrainedMember
from deltasafe.io.locks import FileLock
from deltasafe.perception.data.dataset_info import HANDS
from pipelines.addresses import masked
from pipelines.home import require_obstacle, set_quiet_environment, tracking_uri
from pipelines.tracking.artifact_locations import follow_home
from pipelines.tracking.call_queue import CallQueue
from pipelines.tracking.mlflow_records import MlflowRecords, RecordingBlockedError

_log = logging.getLogger("deltasafe.tracking")

_ESSENTIAL = ("register", "promote")
_TEMPORARY = (401, 403, 408, 429, 499, 502, 503, 504)
"""HTTP status of answers that depend on a login, or on the load of the server."""
_TRANSIENT = re.compile(
    r"disk is full|disk I/O|No space left|too large|is locked|error code (401|403|408|429|502|503|504) "
    r"|readonly database|unable to open|Permission denied|Read-only"
)
RECORDING_LOG_PREFIX = "MLflow was busy for"
"""Start of the log line with the time that recording took; the seconds follow."""


class MlflowTracker:
    """Records one parent run per ensemble, one child run per member, and versions of one registered model.

    Every call is written to a file below the home first. The next call, another process, or
    `python -m pipelines.commands.registry replay` sends the pending calls in order. So a server that is away causes
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
            trained_ms=member.trained_ms,
        )

    def report(
        self, identity: str, figures: Mapping[str, float], folder: pathlib.Path, data: Mapping[str, str]
    ) -> str | None:
        """Record a calibration report in the ensemble's run; return its address, or None if the call is pending."""
        values = {key: float(value) for key, value in figures.items()}
        return self.call("report", identity=identity, figures=values, folder=str(folder), data=dict(data))

    def register(self, identity: str, folder: pathlib.Path) -> str | None:
        """Register a frozen ensemble as challenger; one with the same content keeps its version.

        Raises:
            DataError: the ensemble detects another obstacle than those of the home.
        """
        from deltasafe.perception.artifact.manifest import info_of_manifest, load_manifest

        if (folder / "manifest.json").is_file():  # an incomplete folder is set aside with its reason when it is sent
            info = info_of_manifest(folder, load_manifest(folder))
            require_obstacle(self.home, info.obstacle)
            if info.obstacle != HANDS.obstacle:
                info.save(self.home)
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
            _log.warning("%s cannot be reached; %d calls wait for it", masked(uri), len(self.pending.files()))
            return {}
        try:
            with self.records() as records:
                return self.pending.replay(records.make, lambda error: _waits(error, uri))
        except Exception as error:  # e.g. a database that cannot be opened: the calls stay in the queue
            left = len(self.pending.files())
            _log.warning("MLflow at %s cannot be used now (%s); %d calls wait", masked(uri), masked(error), left)
            return {}

    def why_pending(self) -> str:
        """Return why calls wait, and what sends them."""
        with self.records() as records:
            return records.obstacle() or "the next call or `python -m pipelines.commands.registry replay` sends them"

    @contextlib.contextmanager
    def records(self) -> Iterator[MlflowRecords]:
        """Open MLflow, for one process at a time: two processes must not migrate a new SQLite database in parallel.

        Errors of MLflow show no password.
        """
        from mlflow import MlflowException

        set_quiet_environment()
        (self.home / "mlflow").mkdir(parents=True, exist_ok=True)
        began_s = time.monotonic()
        with FileLock(self.home / "mlflow" / "lock"):
            follow_home(self.home)
            try:
                yield MlflowRecords(tracking_uri(self.home), self.home)
            except MlflowException as error:
                error.message = masked(error)
                error.args = (error.message,)
                raise
        _log.info("%s %.2f s", RECORDING_LOG_PREFIX, time.monotonic() - began_s)


def is_reachable(uri: str, timeout_s: float = 5.0) -> bool:
    """Return whether a server answers at an address, or a database file can be opened or does not exist yet.

    MLflow's own client asks, so that its settings for login and TLS apply, but without its retries: they take a minute
    and a half in every call.
    """
    if uri.startswith("sqlite:///"):
        return _can_open(pathlib.Path(uri.removeprefix("sqlite:///")), timeout_s)
    if not uri.startswith(("http://", "https://")):
        return True
    from mlflow.utils.credentials import get_default_host_creds
    from mlflow.utils.rest_utils import http_request

    try:
        # any answer counts, a request to log in included
        http_request(
            get_default_host_creds(uri), "/health", "GET", max_retries=0, timeout=timeout_s, raise_on_status=False
        )
    except Exception as error:  # whatever MLflow's client makes of a wrong address or certificate
        _log.debug("%s", masked(error))
        return False
    return True


def _waits(error: Exception, uri: str) -> bool:
    """Return whether a failed call may succeed later: no space, no permission, a locked database, no login."""
    status = getattr(error, "get_http_status_code", lambda: None)()
    temporary = status in _TEMPORARY or _TRANSIENT.search(f"{error} {error.__cause__}") is not None
    return temporary or isinstance(error, RecordingBlockedError) or not is_reachable(uri)


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
