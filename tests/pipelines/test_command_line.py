"""Commands report expected errors in one sentence with exit status 1, and without a traceback."""

import contextlib
import os
import pathlib
import re
import socket
import sqlite3
import subprocess
import sys

import pytest

from deltasafe.io.locks import FileLock
from pipelines.commands import demo, registry, ui
from tests.loopback import free_ports

ROOT = pathlib.Path(__file__).parents[2]
COMMANDS = {"demo": (demo.main, []), "ui": (ui.main, ["--port", "1"]), "registry": (registry.main, ["list"])}


@pytest.fixture
def home(tmp_path, monkeypatch):
    for name in ("DAGSTER_HOME", "DELTASAFE_DATABASE", "MLFLOW_TRACKING_URI"):
        monkeypatch.setenv(name, "")
    monkeypatch.setenv("DELTASAFE_HOME", str(tmp_path / "home"))
    return tmp_path / "home"


def error_of(capsys, command, *options):
    """Run a command that must fail; return what it wrote to stderr."""
    main, arguments = COMMANDS[command]
    assert main([*arguments, *options]) == 1
    message = capsys.readouterr().err
    assert len(message.strip().splitlines()) == 1
    return message


@pytest.mark.parametrize(
    "module",
    [f"pipelines.commands.{name}" for name in ("demo", "ui", "registry", "perception_study", "planner_study")],
)
def test_an_unknown_preset_is_one_sentence_without_a_traceback(tmp_path, module):
    environment = {**os.environ, "DELTASAFE_PRESET": "papre", "DELTASAFE_HOME": str(tmp_path / "home")}
    command = [sys.executable, "-m", module, *(["list"] if module.endswith("registry") else [])]
    finished = subprocess.run(command, env=environment, cwd=ROOT, capture_output=True, text=True, check=False)
    assert finished.returncode == 1
    assert finished.stderr.splitlines() == [
        "DELTASAFE_PRESET='papre' is not a preset; choose one of smoke, default, paper"
    ]
    assert not (tmp_path / "home").exists()


@pytest.mark.parametrize("command", COMMANDS)
def test_a_home_that_is_a_file_is_named(home, capsys, command):
    home.touch()
    assert f"{home}: is not a folder" in error_of(capsys, command)


@pytest.mark.parametrize(
    ("text", "message"),
    [("a: [", "dagster.yaml: is not YAML"), ("nonsense: 1", 'dagster.yaml: is not valid .* entry "nonsense"')],
)
@pytest.mark.parametrize("command", ["demo", "ui"])
def test_an_invalid_dagster_yaml_is_named(home, capsys, command, text, message):
    (home / "dagster").mkdir(parents=True)
    (home / "dagster" / "dagster.yaml").write_text(text)
    found = error_of(capsys, command)
    assert re.search(message, found)
    assert len(found) < 500, "the schema of all settings is left out"


@contextlib.contextmanager
def locked(database):
    database.parent.mkdir(parents=True, exist_ok=True)
    with contextlib.closing(sqlite3.connect(database)) as connection:
        connection.execute("CREATE TABLE IF NOT EXISTS some (x)")
        connection.commit()
        connection.execute("BEGIN EXCLUSIVE")
        yield


@pytest.mark.parametrize(
    ("command", "database"),
    [("demo", "dagster/history/runs.db"), ("ui", "dagster/history/runs.db"), ("registry", "mlflow/mlflow.db")],
)
def test_a_locked_database_is_reported(home, capsys, command, database):
    with locked(home / database):
        assert "database is locked" in error_of(capsys, command)


def test_a_used_port_is_named_before_anything_starts(home, capsys, monkeypatch):
    monkeypatch.setattr(subprocess, "Popen", None)
    with socket.create_server(("127.0.0.1", 0)) as server:
        port = server.getsockname()[1]
        assert f"cannot listen on 127.0.0.1:{port} (Address already in use)" in error_of(
            capsys, "ui", "--port", str(port)
        )
        free = ["--port", str(free_ports(1)[0]), "--mlflow-port", str(port)]
        assert "choose another --mlflow-port" in error_of(capsys, "ui", *free)


def test_a_home_has_one_ui(home, capsys, monkeypatch):
    monkeypatch.setattr(subprocess, "Popen", None)
    monkeypatch.setattr(ui, "_check_port", lambda *_: None)
    with FileLock(home / "ui.lock"):
        assert f"{home}: is in use by process {os.getpid()}" in error_of(capsys, "ui")
