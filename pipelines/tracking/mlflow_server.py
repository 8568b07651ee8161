"""The command of MLflow's server that `make ui` starts."""

import os
import pathlib
import sys

from pipelines.home import TRACKING_VARIABLE, tracking_uri
from pipelines.storage.shared_store import STORE_VARIABLE

BACKEND_VARIABLE = "MLFLOW_BACKEND_STORE_URI"
ARTIFACTS_VARIABLE = "MLFLOW_ARTIFACTS_DESTINATION"


def mlflow_command(root: pathlib.Path, port: int, host: str = "127.0.0.1") -> list[str]:
    """Return the command for a server on the database of the home, or on that of a team.

    With `$MLFLOW_BACKEND_STORE_URI` (PostgreSQL), this function also sets the environment: all calls go through the
    server, artifacts included. They are stored at `$MLFLOW_ARTIFACTS_DESTINATION`, by default in `$DELTASAFE_STORE`
    or below the home. The database address contains a password, so it is not part of the command.
    """
    address = ["--host", host, "--port", str(port)]
    if not os.environ.get(BACKEND_VARIABLE):
        return [sys.executable, "-m", "mlflow", "ui", "--backend-store-uri", tracking_uri(root), *address]
    store = os.environ.get(STORE_VARIABLE, "").rstrip("/")
    artifacts = f"{store}/mlflow" if store else (root / "mlflow" / "artifacts").as_uri()
    os.environ.setdefault(ARTIFACTS_VARIABLE, artifacts)
    os.environ[TRACKING_VARIABLE] = f"http://{local_address(host)}:{port}"
    # one worker: on a busy machine, the server would kill and restart slow ones of several workers forever
    return [sys.executable, "-m", "mlflow", "server", "--workers", "1", *address]


def local_address(host: str) -> str:
    """Return the address at which this machine reaches its own server that listens on ``host``."""
    return "127.0.0.1" if host in ("0.0.0.0", "::") else host
