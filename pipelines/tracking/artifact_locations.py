"""Where MLflow's database of a home looks for artifacts. MLflow stores absolute addresses; a home can be moved."""

import contextlib
import pathlib
import sqlite3

_COLUMNS = (
    ("experiments", "artifact_location"),
    ("runs", "artifact_uri"),
    ("logged_models", "artifact_location"),
    ("model_versions", "source"),
    ("model_versions", "storage_location"),
)
_TIMEOUT_S = 30.0


def artifact_location(home: pathlib.Path) -> str:
    """Return the address of the artifacts below a home."""
    return (home / "mlflow" / "artifacts").as_uri()


def follow_home(home: pathlib.Path) -> None:
    """Change all addresses in MLflow's database below ``home`` to the artifacts below the same home.

    Otherwise a copy would use the artifacts of its original, and a moved home would download empty folders. Locations
    that were chosen by hand, outside of a home, stay.
    """
    database, new = home / "mlflow" / "mlflow.db", artifact_location(home)
    if not database.is_file():
        return
    with (
        contextlib.suppress(sqlite3.DatabaseError),  # no tables yet, or unusable: MLflow itself will say so
        contextlib.closing(sqlite3.connect(database, timeout=_TIMEOUT_S)) as connection,
        connection,
    ):
        places = {place for (place,) in connection.execute("SELECT artifact_location FROM experiments")}
        for old in places - {new}:
            if not (str(old).startswith("file:") and str(old).endswith("/mlflow/artifacts")):
                continue
            for table, column in _COLUMNS:
                connection.execute(
                    f"UPDATE {table} SET {column} = ? || substr({column}, ?) WHERE {column} = ? OR {column} LIKE ?",
                    (new, len(old) + 1, old, f"{old}/%"),
                )
