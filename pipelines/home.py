"""The home folder `$DELTASAFE_HOME`: all results, and the records of Dagster and MLflow, are below it.

A team keeps Dagster's records in PostgreSQL instead: `$DELTASAFE_DATABASE` (docs/how-to/team.md).
"""

import importlib.util
import os
import pathlib

import yaml

from deltasafe.errors import DataError, SettingsError
from deltasafe.io.storage import atomic_file
from deltasafe.io.write_errors import translated_write_errors
from deltasafe.perception.data.dataset_info import DatasetInfo
from deltasafe.presets import VARIABLE, active
from pipelines.addresses import masked

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
# steps of one pool run one at a time, across all runs: each of them uses all cores
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
# a run whose process died is retried if its tag dagster/max_retries says so (runs of sensors and the schedule)
run_retries:
  enabled: true
  max_retries: 0
  retry_on_asset_or_op_failure: false
"""

# the address contains a password, so it stays in the environment
_POSTGRES = f"""\
storage:
  postgres:
    postgres_url:
      env: {DATABASE_VARIABLE}
"""
_DIALECT = "postgresql+psycopg2://"

_FIRST_SETTINGS = {
    "telemetry": {"enabled": False},
    "nux": {"enabled": False},
    "python_logs": {"python_log_level": "INFO"},
}
"""Content of the `dagster.yaml` that the first version wrote."""

_ENVIRONMENT = {
    "DAGSTER_DISABLE_TELEMETRY": "1",
    "MLFLOW_DISABLE_TELEMETRY": "true",
    "RAY_USAGE_STATS_ENABLED": "0",
    "NO_ALBUMENTATIONS_UPDATE": "1",
    # otherwise MLflow's server starts ten processes for jobs, which this project does not use
    "MLFLOW_SERVER_ENABLE_JOB_EXECUTION": "false",
    "MLFLOW_ENABLE_ARTIFACTS_PROGRESS_BAR": "false",
    "MLFLOW_LOGGING_LEVEL": "ERROR",
    "MLFLOW_ALLOW_PICKLE_DESERIALIZATION": "false",
    # fail fast if a server does not answer: the next call retries, and MLflow itself would retry for minutes
    "MLFLOW_HTTP_REQUEST_MAX_RETRIES": "2",
    "MLFLOW_HTTP_REQUEST_TIMEOUT": "30",
}


def home() -> pathlib.Path:
    """Return `$DELTASAFE_HOME`; by default `.deltasafe/` in the checkout, or `.deltasafe/PRESET` for other presets.

    The presets have separate homes, so that a smoke run does not replace results of the default preset.

    Raises:
        SettingsError: `$DELTASAFE_PRESET` is not a preset.
    """
    active()
    preset = os.environ.get(VARIABLE) or "default"
    folder = PROJECT / ".deltasafe" / ("" if preset == "default" else preset)
    return pathlib.Path(os.environ.get("DELTASAFE_HOME") or folder).expanduser().resolve()


def obstacle_of(root: pathlib.Path) -> str:
    """Return the identifier of the obstacle that the ensembles of the home ``root`` detect, by default a hand.

    A home is for one obstacle: its ensembles are compared with each other, and one of them is in use.
    """
    return DatasetInfo.load(root).obstacle


def require_obstacle(root: pathlib.Path, obstacle: str) -> None:
    """Check that the home ``root`` is for an obstacle, or has no ensemble yet.

    Raises:
        DataError: it is for another obstacle.
    """
    if obstacle != (present := obstacle_of(root)) and (root / "champion.json").is_file():
        reason = f"has ensembles for the obstacle {present!r}, not {obstacle!r}; set DELTASAFE_HOME to another home"
        raise DataError(root, reason)


def tracking_uri(root: pathlib.Path) -> str:
    """Return `$MLFLOW_TRACKING_URI`, the address of a server, or else MLflow's database below the home ``root``."""
    address = os.environ.get(TRACKING_VARIABLE)
    return address.rstrip("/") if address else f"sqlite:///{root / 'mlflow' / 'mlflow.db'}"


def mlflow_ui(uri: str) -> str:
    """Return the address of MLflow's pages: its server, or where `make ui` shows the database. It has no password."""
    return masked(uri) if uri.startswith("http") else os.environ.get(_MLFLOW_UI, "http://127.0.0.1:5000").rstrip("/")


def run_page(run_id: str) -> str:
    """Return the address of the page of a Dagster run."""
    return f"{os.environ.get(_DAGSTER_UI, 'http://127.0.0.1:3000').rstrip('/')}/runs/{run_id}"


def prepare_home() -> pathlib.Path:
    """Create the home with its `dagster.yaml`, and set the environment of this process and its children.

    Raises:
        SettingsError: `$DELTASAFE_PRESET` or `$DELTASAFE_DATABASE` is invalid, or the PostgreSQL client is missing.
        DataError: the home is not a folder; or `dagster.yaml` was edited, and is not YAML or lacks the database.
        WriteError: the home cannot be created.
    """
    root, database = home(), _checked_database()
    instance = root / "dagster"
    with translated_write_errors(instance):
        try:
            instance.mkdir(parents=True, exist_ok=True)
        except (FileExistsError, NotADirectoryError) as error:
            raise DataError(root, "is not a folder, or is below a file; set DELTASAFE_HOME to a folder") from error
    _write_dagster_yaml(instance / "dagster.yaml", database)
    os.environ["DELTASAFE_HOME"] = str(root)
    os.environ["DAGSTER_HOME"] = str(instance)
    set_quiet_environment()
    return root


def _write_dagster_yaml(path: pathlib.Path, database: bool) -> None:
    """Write or update Dagster's settings; a file that the user has edited is left alone."""
    text = path.read_text(encoding="utf-8") if path.is_file() else ""
    try:
        present = yaml.safe_load(text)
    except yaml.YAMLError as error:
        raise DataError(path, f"is not YAML ({' '.join(str(error).split())}); correct it, or delete it") from error
    wanted = _DAGSTER_YAML + (_POSTGRES if database else "")
    default = [yaml.safe_load(_DAGSTER_YAML), yaml.safe_load(_DAGSTER_YAML + _POSTGRES), _FIRST_SETTINGS]
    if not text or present in default:
        if text != wanted:
            with atomic_file(path) as temporary:
                temporary.write_text(wanted, encoding="utf-8")
    elif database and DATABASE_VARIABLE not in text:
        raise DataError(path, f"was edited and does not use {DATABASE_VARIABLE}, which is set; add:\n{_POSTGRES}")


def _checked_database() -> bool:
    """Return whether Dagster's records are in PostgreSQL; errors never show the address."""
    address = os.environ.get(DATABASE_VARIABLE, "")
    if not address:
        return False
    if not address.startswith(_DIALECT):
        raise SettingsError(f"{DATABASE_VARIABLE} must have the form {_DIALECT}USER:PASSWORD@HOST:PORT/DATABASE")
    if importlib.util.find_spec("dagster_postgres") is None:
        raise SettingsError(f"{DATABASE_VARIABLE} is set, but dagster-postgres is not installed; run: make team")
    return True


def set_quiet_environment() -> None:
    """Switch off telemetry, update checks and unpickling in MLflow, unless the environment already decides."""
    for name, value in _ENVIRONMENT.items():
        os.environ.setdefault(name, value)
