"""`$DELTASAFE_HOME`: everything that is made lies below it, Dagster's and MLflow's records included."""

import fcntl
import os
import pathlib

from deltasafe.presets import VARIABLE
from deltasafe.storage import atomic_file

__all__ = ["DATASETS", "PROJECT", "TRACKING_VARIABLE", "home", "mlflow_ui", "prepare_home", "run_page", "tracking_uri"]

TRACKING_VARIABLE = "MLFLOW_TRACKING_URI"
_DAGSTER_UI, _MLFLOW_UI = "DELTASAFE_DAGSTER_UI", "DELTASAFE_MLFLOW_UI"

PROJECT = pathlib.Path(__file__).resolve().parent.parent
DATASETS = PROJECT / "datasets"

_DAGSTER_YAML = """\
telemetry:
  enabled: false
nux:
  enabled: false
python_logs:
  python_log_level: INFO
  managed_python_loggers: [deltasafe]
# steps of one pool never run side by side, in whichever runs they are: each of them uses all cores
concurrency:
  pools:
    default_limit: 1
    granularity: op
  runs:
    max_concurrent_runs: 4
run_monitoring:
  enabled: true
  start_timeout_seconds: 300
  cancel_timeout_seconds: 120
  poll_interval_seconds: 30
  free_slots_after_run_end_seconds: 60
# a run whose process died is tried again where its tag dagster/max_retries says so (the unattended ones)
run_retries:
  enabled: true
  max_retries: 0
  retry_on_asset_or_op_failure: false
"""

_EARLIER = ("telemetry:\n  enabled: false\nnux:\n  enabled: false\npython_logs:\n  python_log_level: INFO\n",)


def home() -> pathlib.Path:
    """`$DELTASAFE_HOME`; by default `.deltasafe/` in the checkout, and a folder of its own in it for other presets.

    A smoke run must not replace what the default preset has made and registered.
    """
    preset = os.environ.get(VARIABLE) or "default"
    usual = PROJECT / ".deltasafe" / ("" if preset == "default" else preset)
    return pathlib.Path(os.environ.get("DELTASAFE_HOME") or usual).expanduser().resolve()


def tracking_uri(root: pathlib.Path) -> str:
    """`$MLFLOW_TRACKING_URI`, the address of a server, or else MLflow's database below the home ``root``."""
    chosen = os.environ.get(TRACKING_VARIABLE)
    if chosen:
        return chosen.rstrip("/")
    return f"sqlite:///{root / 'mlflow' / 'mlflow.db'}"


def mlflow_ui(uri: str) -> str:
    """Where a browser finds MLflow: at its server, or where `make ui` shows the database."""
    return uri if uri.startswith("http") else os.environ.get(_MLFLOW_UI, "http://127.0.0.1:5000").rstrip("/")


def run_page(run_id: str) -> str:
    """Page of a Dagster run."""
    return f"{os.environ.get(_DAGSTER_UI, 'http://127.0.0.1:3000').rstrip('/')}/runs/{run_id}"


def prepare_home() -> pathlib.Path:
    """Create the home with its Dagster instance, and point this process and its children at both."""
    root = home()
    instance = root / "dagster"
    instance.mkdir(parents=True, exist_ok=True)
    settings = instance / "dagster.yaml"
    # one that was edited is the user's; one that an earlier version wrote is brought up to date
    if not settings.is_file() or settings.read_text(encoding="utf-8") in _EARLIER:
        with atomic_file(settings) as temporary:
            temporary.write_text(_DAGSTER_YAML, encoding="utf-8")
    os.environ["DELTASAFE_HOME"] = str(root)
    os.environ["DAGSTER_HOME"] = str(instance)
    set_quiet_environment()
    return root


def set_quiet_environment() -> None:
    """No telemetry, no update checks: nothing here calls home."""
    os.environ.setdefault("DAGSTER_DISABLE_TELEMETRY", "1")
    os.environ.setdefault("MLFLOW_DISABLE_TELEMETRY", "true")
    os.environ.setdefault("NO_ALBUMENTATIONS_UPDATE", "1")
    # MLflow's server would otherwise start ten processes for jobs that nobody submits here
    os.environ.setdefault("MLFLOW_SERVER_ENABLE_JOB_EXECUTION", "false")
    os.environ.setdefault("MLFLOW_ENABLE_ARTIFACTS_PROGRESS_BAR", "false")
    os.environ.setdefault("MLFLOW_LOGGING_LEVEL", "ERROR")
    # a server that is away is tried again at the next call, not for minutes within one
    os.environ.setdefault("MLFLOW_HTTP_REQUEST_MAX_RETRIES", "2")
    os.environ.setdefault("MLFLOW_HTTP_REQUEST_TIMEOUT", "30")


class FileLock:
    """Exclusive lock between processes, held inside a `with` block."""

    def __init__(self, path: pathlib.Path) -> None:
        self.path = path

    def __enter__(self) -> "FileLock":
        self.path.parent.mkdir(parents=True, exist_ok=True)
        self._file = self.path.open("w")
        fcntl.flock(self._file, fcntl.LOCK_EX)
        return self

    def __exit__(self, *exception: object) -> None:
        self._file.close()
