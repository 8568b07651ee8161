"""The command of MLflow's server that `make ui` starts."""

import os
import pathlib
import socket
import sys
import urllib.parse

from pipelines.home import TRACKING_VARIABLE, tracking_uri
from pipelines.storage.shared_store import STORE_VARIABLE
from pipelines.tracking.artifact_locations import follow_home

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
        follow_home(root)
        return [sys.executable, "-m", "mlflow", "ui", "--backend-store-uri", tracking_uri(root), *address]
    store = os.environ.get(STORE_VARIABLE, "").rstrip("/")
    artifacts = f"{store}/mlflow" if store else (root / "mlflow" / "artifacts").as_uri()
    os.environ.setdefault(ARTIFACTS_VARIABLE, artifacts)
    os.environ[TRACKING_VARIABLE] = f"http://{local_address(host)}:{port}"
    # one worker: on a busy machine, the server would kill and restart slow ones of several workers forever
    return [sys.executable, "-m", "mlflow", "server", "--workers", "1", *address]


def allow_names(host: str, address: str) -> None:
    """Let MLflow's server answer browsers that call it by a name of this machine, by setting its environment.

    MLflow checks the Host header against rebound DNS names, and the Origin header of requests that change something.
    Variables that the user has set are kept.

    Args:
        host: address to listen on.
        address: address that links lead to.
    """
    from mlflow.server.security_utils import get_default_allowed_hosts

    names = {socket.gethostname(), host, urllib.parse.urlsplit(address).hostname or host} - {"0.0.0.0", "::"}
    shown = sorted(f"[{name}]" if ":" in name else name for name in names)
    hosts = [*get_default_allowed_hosts(), *shown, *(f"{name.replace('[', '[[]')}:*" for name in shown)]
    origins = [address, *(f"http://{name}:{urllib.parse.urlsplit(address).port or 80}" for name in shown)]
    os.environ.setdefault("MLFLOW_SERVER_ALLOWED_HOSTS", ",".join(hosts))
    os.environ.setdefault("MLFLOW_SERVER_CORS_ALLOWED_ORIGINS", ",".join(origins))


def local_address(host: str) -> str:
    """Return the address at which this machine reaches its own server that listens on ``host``."""
    return "127.0.0.1" if host in ("0.0.0.0", "::") else host
