"""Pinned versions, and the interpretation of a vulnerability database's answers."""

import json
import pathlib

import pytest

from evidence.faults.dependencies import TOOLS, audit, unpinned, write_sbom

CVE = {"id": "PYSEC-2019-217", "aliases": ["CVE-2019-10906"]}
REPORTS_KNOWN = json.dumps({"dependencies": [{"name": "jinja2", "version": "2.4.1", "vulns": [CVE]}]})
REPORTS_NOTHING = json.dumps({"dependencies": [{"name": "jinja2", "version": "2.4.1", "vulns": []}]})
INSTALLED = json.dumps(
    {
        "dependencies": [
            {"name": "a", "version": "1.0", "vulns": []},
            {"name": "b", "version": "2.0", "vulns": [CVE]},
            {"name": "deltasafe", "skip_reason": "editable"},
        ]
    }
)


def test_all_installed_packages_are_pinned() -> None:
    assert unpinned() == []


def test_other_version_and_unlisted_package_are_reported(tmp_path: pathlib.Path) -> None:
    constraints = tmp_path / "constraints.txt"
    lines = pathlib.Path("constraints.txt").read_text().splitlines()
    kept = [line for line in lines if not line.startswith(("numpy==", "scipy=="))]
    constraints.write_text("\n".join([*kept, "numpy==1.0", ""]))
    assert [each.split()[0] for each in unpinned(constraints)] == ["numpy", "scipy"]


def test_database_that_reports_known_vulnerability_is_used() -> None:
    found = audit(lambda database, arguments: REPORTS_KNOWN if "--requirement" in arguments else INSTALLED)
    assert (found.database, found.packages) == ("pypi", 2)
    assert found.vulnerabilities == ("b 2.0: PYSEC-2019-217, CVE-2019-10906",)


@pytest.mark.parametrize("answer", ["", "<html>", "[]", "{}", REPORTS_NOTHING])
def test_database_that_misses_known_vulnerability_is_not_used(answer: str) -> None:
    queries = []

    def query(database: str, arguments: list[str]) -> str:
        queries.append((database, "--requirement" in arguments))
        return answer if database == "pypi" or "--requirement" in arguments else INSTALLED

    assert audit(query).database == ""
    assert queries == [("pypi", True), ("osv", True)], "no query about the installed packages"


@pytest.mark.skipif(not (TOOLS / "cyclonedx-py").exists(), reason="`make sbom` installs it")
def test_sbom_lists_installed_packages_without_audit_tools(tmp_path: pathlib.Path) -> None:
    assert write_sbom(tmp_path / "dist" / "sbom.json") > 100
    listed = json.loads((tmp_path / "dist" / "sbom.json").read_text())["components"]
    assert {"torch", "dagster", "mlflow", "numpy"} <= {each["name"] for each in listed}
    assert not {"pip_audit", "pip-audit", "cyclonedx-bom"} & {each["name"] for each in listed}
