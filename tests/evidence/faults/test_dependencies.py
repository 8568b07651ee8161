"""Pins and what is installed; and what is made of the answers of a database of vulnerabilities."""

import json
import pathlib

import pytest

from evidence.faults.dependencies import TOOLS, audit, unpinned, write_sbom

CVE = {"id": "PYSEC-2019-217", "aliases": ["CVE-2019-10906"]}
KNOWS = json.dumps({"dependencies": [{"name": "jinja2", "version": "2.4.1", "vulns": [CVE]}]})
KNOWS_NOTHING = json.dumps({"dependencies": [{"name": "jinja2", "version": "2.4.1", "vulns": []}]})
HERE = json.dumps(
    {
        "dependencies": [
            {"name": "a", "version": "1.0", "vulns": []},
            {"name": "b", "version": "2.0", "vulns": [CVE]},
            {"name": "deltasafe", "skip_reason": "editable"},
        ]
    }
)


def test_all_that_is_installed_is_what_the_constraints_say() -> None:
    assert unpinned() == []


def test_another_version_and_an_unknown_package_are_told(tmp_path: pathlib.Path) -> None:
    constraints = tmp_path / "constraints.txt"
    lines = pathlib.Path("constraints.txt").read_text().splitlines()
    constraints.write_text("\n".join(line for line in lines if not line.startswith(("numpy==", "scipy=="))))
    constraints.write_text(constraints.read_text() + "\nnumpy==1.0\n")
    assert [each.split()[0] for each in unpinned(constraints)] == ["numpy", "scipy"]


def test_a_database_that_knows_the_known_one_is_asked_about_all() -> None:
    found = audit(lambda database, arguments: KNOWS if "--requirement" in arguments else HERE)
    assert (found.database, found.packages) == ("pypi", 2)
    assert found.vulnerabilities == ("b 2.0: PYSEC-2019-217, CVE-2019-10906",)


@pytest.mark.parametrize("silence", ["", "<html>", "[]", "{}", KNOWS_NOTHING])
def test_one_that_does_not_is_not_believed(silence: str) -> None:
    asked = []

    def ask(database: str, arguments: list[str]) -> str:
        asked.append((database, "--requirement" in arguments))
        return silence if database == "pypi" or "--requirement" in arguments else HERE

    assert audit(ask).database == ""
    assert asked == [("pypi", True), ("osv", True)], "nothing is asked about what is installed"


@pytest.mark.skipif(not (TOOLS / "cyclonedx-py").exists(), reason="`make sbom` installs it")
def test_the_sbom_lists_what_is_installed(tmp_path: pathlib.Path) -> None:
    assert write_sbom(tmp_path / "dist" / "sbom.json") > 100
    listed = json.loads((tmp_path / "dist" / "sbom.json").read_text())["components"]
    assert {"torch", "dagster", "mlflow", "numpy"} <= {each["name"] for each in listed}
    assert not {"pip_audit", "pip-audit", "cyclonedx-bom"} & {each["name"] for each in listed}
