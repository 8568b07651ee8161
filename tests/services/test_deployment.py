"""The commands of deploy/compose.yaml without containers, on real servers."""

import contextlib
import json
import os
import pathlib
import platform
import shutil
import socket
import subprocess
import sys
import time
import urllib.error
import urllib.request

import pytest
import yaml

from deltasafe.compute.processes import stop_session
from pipelines.home import DATABASE_VARIABLE
from pipelines.storage.shared_store import STORE_VARIABLE, SharedStore
from pipelines.supervision import MACHINE_TAG
from pipelines.tracking.mlflow_server import ARTIFACTS_VARIABLE, BACKEND_VARIABLE
from tests.loopback import answers, free_ports
from tests.services.servers import PASSWORD, SECRET

ROOT = pathlib.Path(__file__).parents[2]
COMPOSE = yaml.safe_load((ROOT / "deploy" / "compose.yaml").read_text(encoding="utf-8"))["services"]

LAUNCH = """
mutation ($params: ExecutionParams!) {
  launchRun(executionParams: $params) {
    __typename
    ... on LaunchRunSuccess { run { runId } }
    ... on PythonError { message stack }
    ... on RunConfigValidationInvalid { errors { message } }
  }
}
"""
RUN = "query ($id: ID!) { runOrError(runId: $id) { __typename ... on Run { status tags { key value } } } }"


@pytest.fixture
def services(database, s3, tmp_path):
    """Start the four services with the environment and commands of the compose file; yield their ports by name."""
    home = tmp_path / "home"
    (home / "dagster").mkdir(parents=True)
    shutil.copy(ROOT / "deploy" / "dagster.yaml", home / "dagster" / "dagster.yaml")
    code, webserver, mlflow = free_ports(3)
    workspace = tmp_path / "workspace.yaml"
    text = (ROOT / "deploy" / "workspace.yaml").read_text()
    workspace.write_text(text.replace("host: code", "host: 127.0.0.1").replace("4000", str(code)))
    environment = {
        **{name: value for name, value in os.environ.items() if not name.startswith(("DELTASAFE_", "MLFLOW_"))},
        **s3.environment,
        "DELTASAFE_PRESET": "smoke",
        "DELTASAFE_HOME": str(home),
        "DAGSTER_HOME": str(home / "dagster"),
        "DELTASAFE_SENSOR_INTERVAL_S": "3600",
        "MLFLOW_SERVER_ENABLE_JOB_EXECUTION": "false",
        DATABASE_VARIABLE: database.database("deployment"),
        STORE_VARIABLE: "s3://team/deployment",
        BACKEND_VARIABLE: database.database("deployment-mlflow"),
        ARTIFACTS_VARIABLE: "s3://team/deployment/mlflow",
    }
    replacements = {
        "0.0.0.0": "127.0.0.1",
        "4000": str(code),
        "3000": str(webserver),
        "5000": str(mlflow),
        "/app/deploy/workspace.yaml": str(workspace),
    }
    processes = {}
    try:
        for name in ("code", "mlflow", "webserver", "daemon"):
            program, *arguments = COMPOSE[name]["command"]
            command = [
                str(pathlib.Path(sys.executable).with_name(program)),
                *(replacements.get(a, a) for a in arguments),
            ]
            assert PASSWORD not in " ".join(command)
            with (tmp_path / f"{name}.log").open("w") as log:
                processes[name] = subprocess.Popen(
                    command, cwd=ROOT, env=environment, stdout=log, stderr=log, start_new_session=True
                )
            if name == "code":
                while not listens(code):
                    check_alive(processes, tmp_path)
        while not (answers(f"http://127.0.0.1:{webserver}/server_info") and listens(mlflow)):
            check_alive(processes, tmp_path)
        yield {"webserver": webserver, "mlflow": mlflow, "check_alive": lambda: check_alive(processes, tmp_path)}
    finally:
        for process in reversed(processes.values()):
            stop_session(process)


def check_alive(processes, folder):
    time.sleep(0.5)
    for name, process in processes.items():
        assert process.poll() is None, f"{name}: " + (folder / f"{name}.log").read_text()[-4000:]


def listens(port):
    with contextlib.suppress(OSError), socket.create_connection(("127.0.0.1", port), timeout=5):
        return True
    return False


def graphql(port, query, **variables):
    body = json.dumps({"query": query, "variables": variables}).encode()
    headers = {"Content-Type": "application/json"}
    request = urllib.request.Request(f"http://127.0.0.1:{port}/graphql", body, headers)
    with urllib.request.urlopen(request, timeout=120) as answer:
        return json.load(answer)["data"]


def status_for(port, host):
    request = urllib.request.Request(f"http://127.0.0.1:{port}/api/2.0/mlflow/experiments/get?experiment_id=0")
    request.add_header("Host", host)
    try:
        return urllib.request.urlopen(request, timeout=60).status
    except urllib.error.HTTPError as error:
        return error.code


def test_an_asset_launched_in_the_webserver_is_made_in_the_code_location(services, s3, tmp_path, monkeypatch):
    selector = {
        "repositoryLocationName": "deltasafe",
        "repositoryName": "__repository__",
        "pipelineName": "__ASSET_JOB",
        "assetSelection": [{"path": ["test_hands"]}],
        "assetCheckSelection": [],
    }
    launched = graphql(services["webserver"], LAUNCH, params={"selector": selector, "mode": "default"})["launchRun"]
    assert launched["__typename"] == "LaunchRunSuccess", launched
    run_id, status, tags = launched["run"]["runId"], "", []
    while status not in ("SUCCESS", "FAILURE", "CANCELED"):
        services["check_alive"]()
        run = graphql(services["webserver"], RUN, id=run_id)["runOrError"]
        status, tags = run["status"], run["tags"]
    assert status == "SUCCESS", (tmp_path / "code.log").read_text()[-4000:]
    assert {"key": MACHINE_TAG, "value": platform.node()} in tags
    for name, value in s3.environment.items():
        monkeypatch.setenv(name, value)
    pointer = SharedStore("s3://team/deployment").read_json("pointers/current/test_hands.json")
    assert (pointer["packaged"], pointer["run_id"]) == ("hands/test", run_id)

    assert status_for(services["mlflow"], "mlflow:5000") == 200
    assert status_for(services["mlflow"], "elsewhere.example.com") == 403
    for log in tmp_path.glob("*.log"):
        assert not any(secret in log.read_text() for secret in (PASSWORD, SECRET)), log
