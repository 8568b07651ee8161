"""Expected errors of commands: one sentence and exit status 1."""

import os
import pathlib
import sys
from collections.abc import Callable

from deltasafe.errors import DeltasafeError
from pipelines.addresses import masked


def run_command(main: Callable[[], int]) -> int:
    """Call ``main`` and return its exit status; print expected errors and return 1."""
    try:
        return main()
    except Exception as error:
        message = _message(error)
        if not message:
            raise
        print(masked(message), file=sys.stderr)
        return 1


def _message(error: Exception) -> str:
    """Describe an expected error in one sentence; return an empty string for other errors."""
    if isinstance(error, DeltasafeError):
        return str(error)
    import dagster as dg
    from mlflow import MlflowException
    from sqlalchemy.exc import SQLAlchemyError

    if isinstance(error, dg.DagsterInvalidConfigError):
        file = pathlib.Path(os.environ.get("DAGSTER_HOME", "")) / "dagster.yaml"
        problems = "; ".join(problem.message.partition(" Expected: ")[0] for problem in error.errors)
        return f"{file}: is not valid ({problems}); correct it, or delete it"
    reason = str(getattr(error, "orig", None) or error).partition("\n")[0]
    if isinstance(error, SQLAlchemyError):
        return f"a database cannot be used ({reason}); if another process uses it, wait for it, and run this again"
    if isinstance(error, MlflowException):
        return f"MLflow reports: {reason}"
    return ""
