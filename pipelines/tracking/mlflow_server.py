"""MLflow's server as `make ui` starts it: on the database of the home, or on a team's."""

import os
import pathlib
import sys

from pipelines.home import TRACKING_VARIABLE, tracking_uri
from pipelines.storage.shared_store import STORE_VARIABLE

__all__ = ["ARTIFACTS_VARIABLE", "BACKEND_VARIABLE", "mlflow_command", "reached_at"]

BACKEND_VARIABLE = "MLFLOW_BACKEND_STORE_URI"
ARTIFACTS_VARIABLE = "MLFLOW_ARTIFACTS_DESTINATION"


def mlflow_command(root: pathlib.Path, port: int, host: str = "127.0.0.1") -> list[str]:
    """What to start, on the loopback address unless told otherwise; this process and its children are pointed at it.

    With `$MLFLOW_BACKEND_STORE_URI` (PostgreSQL) the server is asked for everything, artifacts included; these lie
    where `$MLFLOW_ARTIFACTS_DESTINATION` says, else in the store of `$DELTASAFE_STORE`, else below the home. The
    address of the database, which holds a password, is left to the environment, out of the list of processes.
    """
    address = ["--host", host, "--port", str(port)]
    if not os.environ.get(BACKEND_VARIABLE):
        return [sys.executable, "-m", "mlflow", "ui", "--backend-store-uri", tracking_uri(root), *address]
    store = os.environ.get(STORE_VARIABLE, "").rstrip("/")
    own = f"{store}/mlflow" if store else (root / "mlflow" / "artifacts").as_uri()
    os.environ.setdefault(ARTIFACTS_VARIABLE, own)
    os.environ[TRACKING_VARIABLE] = f"http://{reached_at(host)}:{port}"
    # one worker: of several, those that start slowly on a busy machine would be killed and started again, for ever
    return [sys.executable, "-m", "mlflow", "server", "--workers", "1", *address]


def reached_at(host: str) -> str:
    """Where this machine finds a server of its own that listens at ``host``."""
    return "127.0.0.1" if host in ("0.0.0.0", "::") else host
