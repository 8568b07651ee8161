"""`$DELTASAFE_HOME`: everything that is made lies below it, Dagster's and MLflow's records included."""

import fcntl
import os
import pathlib

from deltasafe.presets import VARIABLE
from deltasafe.storage import atomic_file

__all__ = ["DATASETS", "PROJECT", "home", "prepare_home", "tracking_uri"]

PROJECT = pathlib.Path(__file__).resolve().parent.parent
DATASETS = PROJECT / "datasets"

_DAGSTER_YAML = """\
telemetry:
  enabled: false
nux:
  enabled: false
python_logs:
  python_log_level: INFO
"""


def home() -> pathlib.Path:
    """`$DELTASAFE_HOME`; by default `.deltasafe/` in the checkout, and a folder of its own in it for other presets.

    A smoke run must not replace what the default preset has made and registered.
    """
    preset = os.environ.get(VARIABLE) or "default"
    usual = PROJECT / ".deltasafe" / ("" if preset == "default" else preset)
    return pathlib.Path(os.environ.get("DELTASAFE_HOME") or usual).expanduser().resolve()


def tracking_uri(root: pathlib.Path) -> str:
    """MLflow's database below the home ``root``."""
    return f"sqlite:///{root / 'mlflow' / 'mlflow.db'}"


def prepare_home() -> pathlib.Path:
    """Create the home with its Dagster instance, and point this process and its children at both."""
    root = home()
    instance = root / "dagster"
    instance.mkdir(parents=True, exist_ok=True)
    if not (instance / "dagster.yaml").is_file():
        with atomic_file(instance / "dagster.yaml") as temporary:
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
