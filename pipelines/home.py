"""`$DELTASAFE_HOME`: everything that is made lies below it, Dagster's and MLflow's records included.

A team keeps Dagster's records in PostgreSQL instead: `$DELTASAFE_DATABASE` (docs/how-to/team.md).
"""

import importlib.util
import os
import pathlib

from deltasafe.errors import DataError, SettingsError
from deltasafe.io.storage import atomic_file
from deltasafe.presets import VARIABLE

__all__ = [
    "DATABASE_VARIABLE",
    "DATASETS",
    "PROJECT",
    "TRACKING_VARIABLE",
    "home",
    "mlflow_ui",
    "prepare_home",
    "run_page",
    "tracking_uri",
]

TRACKING_VARIABLE = "MLFLOW_TRACKING_URI"
DATABASE_VARIABLE = "DELTASAFE_DATABASE"
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

# the address, which holds a password, stays in the environment
_POSTGRES = f"""\
storage:
  postgres:
    postgres_url:
      env: {DATABASE_VARIABLE}
"""
_DIALECT = "postgresql+psycopg2://"

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
    """Create the home with its Dagster instance, and point this process and its children at both.

    Raises:
        SettingsError: `$DELTASAFE_DATABASE` is of another form, or what speaks to it is not installed.
        DataError: it is set, and a `dagster.yaml` that was edited knows nothing of it.
    """
    root, database = home(), _checked_database()
    instance = root / "dagster"
    instance.mkdir(parents=True, exist_ok=True)
    settings, wanted = instance / "dagster.yaml", _DAGSTER_YAML + (_POSTGRES if database else "")
    there = settings.read_text(encoding="utf-8") if settings.is_file() else ""
    # one that was edited is the user's; one that was written here is brought up to date
    if there in ("", _DAGSTER_YAML, _DAGSTER_YAML + _POSTGRES, *_EARLIER):
        if there != wanted:
            with atomic_file(settings) as temporary:
                temporary.write_text(wanted, encoding="utf-8")
    elif database and DATABASE_VARIABLE not in there:
        raise DataError(settings, f"was edited and does not use {DATABASE_VARIABLE}, which is set; add:\n{_POSTGRES}")
    os.environ["DELTASAFE_HOME"] = str(root)
    os.environ["DAGSTER_HOME"] = str(instance)
    set_quiet_environment()
    return root


def _checked_database() -> bool:
    """Whether Dagster's records are in PostgreSQL; the address is never shown."""
    address = os.environ.get(DATABASE_VARIABLE, "")
    if not address:
        return False
    if not address.startswith(_DIALECT):
        raise SettingsError(f"{DATABASE_VARIABLE} has to have the form {_DIALECT}USER:PASSWORD@HOST:PORT/DATABASE")
    if importlib.util.find_spec("dagster_postgres") is None:
        raise SettingsError(f"{DATABASE_VARIABLE} is set, but dagster-postgres is not installed; run: make team")
    return True


def set_quiet_environment() -> None:
    """No telemetry, no update checks: nothing here calls home, and MLflow loads no pickle."""
    os.environ.setdefault("DAGSTER_DISABLE_TELEMETRY", "1")
    os.environ.setdefault("MLFLOW_DISABLE_TELEMETRY", "true")
    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
    os.environ.setdefault("NO_ALBUMENTATIONS_UPDATE", "1")
    # MLflow's server would otherwise start ten processes for jobs that nobody submits here
    os.environ.setdefault("MLFLOW_SERVER_ENABLE_JOB_EXECUTION", "false")
    os.environ.setdefault("MLFLOW_ENABLE_ARTIFACTS_PROGRESS_BAR", "false")
    os.environ.setdefault("MLFLOW_LOGGING_LEVEL", "ERROR")
    os.environ.setdefault("MLFLOW_ALLOW_PICKLE_DESERIALIZATION", "false")
    # a server that is away is tried again at the next call, not for minutes within one
    os.environ.setdefault("MLFLOW_HTTP_REQUEST_MAX_RETRIES", "2")
    os.environ.setdefault("MLFLOW_HTTP_REQUEST_TIMEOUT", "30")
