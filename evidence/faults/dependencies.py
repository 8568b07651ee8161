"""Compare the installed packages with constraints.txt, write an SBOM, and ask for known vulnerabilities.

cyclonedx-py writes the SBOM (CycloneDX, JSON). pip-audit queries a vulnerability database. The first query names a
version that is known to be vulnerable: a database that does not report it proves nothing about other packages.
"""

import dataclasses
import importlib.metadata
import json
import pathlib
import subprocess
import sys
import sysconfig
import tempfile
from collections.abc import Callable

from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

from evidence.reporting import command_parser, finish
from pipelines.home import PROJECT

TOOLS = pathlib.Path(sys.prefix) / "audit" / "bin"
"""A separate environment, so that the tools are not listed in the SBOM."""
DATABASES = ("pypi", "osv")
VULNERABLE = "jinja2==2.4.1"
"""CVE-2014-1402, CVE-2016-10745, CVE-2019-10906 and others: every Python vulnerability database lists it."""
NOT_PINNED = ("deltasafe", "pip", "setuptools", "wheel")
"""This project, and the packages that a new virtual environment contains."""


@dataclasses.dataclass(frozen=True)
class Audit:
    """Answer of a database: its name (empty if none answered), the number of packages, and the vulnerabilities."""

    database: str
    packages: int = 0
    vulnerabilities: tuple[str, ...] = ()


def unpinned(constraints: pathlib.Path = PROJECT / "constraints.txt") -> list[str]:
    """Return the installed packages that ``constraints`` does not list, or lists with another version."""
    pinned: dict[str, set[str]] = {}
    for line in constraints.read_text(encoding="utf-8").splitlines():
        if line.strip() and not line.startswith("#"):
            requirement = Requirement(line)
            pinned.setdefault(canonicalize_name(requirement.name), set()).add(str(requirement.specifier))
    installed = {
        canonicalize_name(found.metadata["Name"]): found.version for found in importlib.metadata.distributions()
    }
    return [
        f"{name} {version}"
        for name, version in sorted(installed.items())
        if name not in NOT_PINNED and f"=={version.partition('+')[0]}" not in pinned.get(name, set())
    ]


def write_sbom(destination: pathlib.Path) -> int:
    """Write the installed packages as a CycloneDX document; return the number of components."""
    destination.parent.mkdir(parents=True, exist_ok=True)
    command = [str(TOOLS / "cyclonedx-py"), "environment", "--output-reproducible", "--of", "JSON"]
    subprocess.run([*command, "-o", str(destination), sys.executable], check=True)
    return len(json.loads(destination.read_text(encoding="utf-8"))["components"])


def audit(query: "Callable[[str, list[str]], str] | None" = None) -> Audit:
    """Ask the first database that reports the known vulnerability about all installed packages.

    Args:
        query: returns pip-audit's answer (JSON) for a database and arguments; runs pip-audit by default.
    """
    query = query or _pip_audit
    with tempfile.TemporaryDirectory() as folder:
        requirements = pathlib.Path(folder, "vulnerable.txt")
        requirements.write_text(f"{VULNERABLE}\n", encoding="utf-8")
        for database in DATABASES:
            if _parse(query(database, ["--requirement", str(requirements), "--no-deps", "--disable-pip"]))[1]:
                installed = ["--path", sysconfig.get_path("purelib"), "--skip-editable"]
                packages, vulnerabilities = _parse(query(database, installed))
                return Audit(database, packages, tuple(vulnerabilities))
    return Audit("")


def _pip_audit(database: str, arguments: list[str]) -> str:
    command = [str(TOOLS / "pip-audit"), "--format", "json", "--progress-spinner", "off", "--timeout", "15"]
    command += ["--vulnerability-service", database, *arguments]
    return subprocess.run(command, check=False, capture_output=True, text=True).stdout


def _parse(answer: str) -> tuple[int, list[str]]:
    """Return the number of audited packages and their vulnerabilities; zero and none for an invalid answer."""
    try:
        packages = json.loads(answer)["dependencies"]
    except (json.JSONDecodeError, KeyError, TypeError):
        return 0, []
    audited = [package for package in packages if "vulns" in package]
    return len(audited), [
        f"{package['name']} {package['version']}: {', '.join([each['id'], *each.get('aliases', [])])}"
        for package in audited
        for each in package["vulns"]
    ]


def main(arguments: list[str] | None = None) -> int:
    """Run ``python -m evidence.faults.dependencies``; 1 if a package is not pinned or has a known vulnerability."""
    parser = command_parser("faults.dependencies", __doc__)
    parser.add_argument("--sbom", type=pathlib.Path, default="dist/sbom.json", help="(default %(default)s)")
    parser.add_argument("--sbom-alone", action="store_true", help="query no database")
    options = parser.parse_args(arguments)
    components = write_sbom(options.sbom)
    print(f"written: {options.sbom}, {components} components")
    failures = [f"not pinned by constraints.txt: {each}" for each in unpinned()]
    figures = {"dependencies": components, "dependencies_unpinned": len(failures)}
    found = Audit("")
    if not options.sbom_alone:
        found = audit()
        figures["dependencies_audited"] = found.packages
        if found.database:
            figures["vulnerabilities"] = len(found.vulnerabilities)
            failures += [f"vulnerable: {each}" for each in found.vulnerabilities]
        else:
            print(f"NOT CHECKED: none of {', '.join(DATABASES)} answered; check {options.sbom} with another scanner")
    return finish(options, figures, failures, database=found.database or None)


if __name__ == "__main__":
    sys.exit(main())
