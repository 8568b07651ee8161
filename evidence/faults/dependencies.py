"""What is installed: is it what constraints.txt pins, what is it (an SBOM), and has any of it a known vulnerability?

The SBOM is written by cyclonedx-py (CycloneDX, JSON) for any scanner. pip-audit asks a database, first about a version
that is known to be vulnerable: a database that does not know that one says nothing about the others either.
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

from evidence.faults.reporting import conclude, parser
from pipelines.home import PROJECT

__all__ = ["Audit", "audit", "main", "unpinned", "write_sbom"]

TOOLS = pathlib.Path(sys.prefix) / "audit" / "bin"
"""An environment of their own, so that they do not stand in the SBOM."""
DATABASES = ("pypi", "osv")
KNOWN = "jinja2==2.4.1"
"""CVE-2014-1402, CVE-2016-10745, CVE-2019-10906, ...: every database of Python's vulnerabilities has it."""
BOOTSTRAP = ("pip", "setuptools", "wheel")
"""What the interpreter's own venv brings, and ourselves; not pinned by constraints.txt."""


@dataclasses.dataclass(frozen=True)
class Audit:
    """What a database said: its name (empty if none answered), of how many packages, and which vulnerabilities."""

    database: str
    packages: int = 0
    vulnerabilities: tuple[str, ...] = ()


def unpinned(constraints: pathlib.Path = PROJECT / "constraints.txt") -> list[str]:
    """What is installed here in another version than ``constraints`` says, or without being named there."""
    pinned: dict[str, set[str]] = {}
    for line in constraints.read_text(encoding="utf-8").splitlines():
        if line.strip() and not line.startswith("#"):
            requirement = Requirement(line)
            pinned.setdefault(canonicalize_name(requirement.name), set()).add(str(requirement.specifier))
    installed = {
        canonicalize_name(found.metadata["Name"]): found.version for found in importlib.metadata.distributions()
    }
    ours = ("deltasafe", *BOOTSTRAP)
    return [
        f"{name} {version}"
        for name, version in sorted(installed.items())
        if name not in ours and f"=={version.partition('+')[0]}" not in pinned.get(name, set())
    ]


def write_sbom(destination: pathlib.Path) -> int:
    """Write what is installed here as a CycloneDX document; returns the number of its components."""
    destination.parent.mkdir(parents=True, exist_ok=True)
    command = [str(TOOLS / "cyclonedx-py"), "environment", "--output-reproducible", "--of", "JSON"]
    subprocess.run([*command, "-o", str(destination), sys.executable], check=True)
    return len(json.loads(destination.read_text(encoding="utf-8"))["components"])


def audit(ask: "Callable[[str, list[str]], str] | None" = None) -> Audit:
    """Ask the first database that knows a vulnerability which is known about everything that is installed here.

    Args:
        ask: what pip-audit answers (JSON) if given a database and arguments; tests bring their own.
    """
    ask = ask or _pip_audit
    with tempfile.TemporaryDirectory() as folder:
        known = pathlib.Path(folder, "known.txt")
        known.write_text(f"{KNOWN}\n", encoding="utf-8")
        for database in DATABASES:
            if _read(ask(database, ["--requirement", str(known), "--no-deps", "--disable-pip"]))[1]:
                here = ["--path", sysconfig.get_path("purelib"), "--skip-editable"]
                packages, vulnerabilities = _read(ask(database, here))
                return Audit(database, packages, tuple(vulnerabilities))
    return Audit("")


def _pip_audit(database: str, arguments: list[str]) -> str:
    command = [str(TOOLS / "pip-audit"), "--format", "json", "--progress-spinner", "off", "--timeout", "15"]
    command += ["--vulnerability-service", database, *arguments]
    said = subprocess.run(command, check=False, capture_output=True, text=True)
    return said.stdout


def _read(answer: str) -> tuple[int, list[str]]:
    try:
        packages = json.loads(answer)["dependencies"]
    except (json.JSONDecodeError, KeyError, TypeError):
        return 0, []
    asked = [package for package in packages if "vulns" in package]
    return len(asked), [
        f"{package['name']} {package['version']}: {', '.join([each['id'], *each.get('aliases', [])])}"
        for package in asked
        for each in package["vulns"]
    ]


def main(arguments: list[str] | None = None) -> int:
    """``python -m evidence.faults.dependencies``; 1 if something is not pinned, or has a known vulnerability."""
    made = parser(__doc__)
    made.add_argument("--sbom", type=pathlib.Path, default=pathlib.Path("dist/sbom.json"), help="(default %(default)s)")
    made.add_argument("--sbom-alone", action="store_true", help="ask no database")
    options = made.parse_args(arguments)
    sbom_alone = options.sbom_alone
    del options.sbom_alone
    components = write_sbom(options.sbom)
    print(f"written: {options.sbom}, {components} components")
    failures = [f"not pinned by constraints.txt: {each}" for each in unpinned()]
    figures = {"dependencies": components, "dependencies_unpinned": len(failures)}
    if sbom_alone:
        return conclude("dependencies", figures, options, failures)
    found = audit()
    figures["dependencies_audited"] = found.packages
    if found.database:
        figures["vulnerabilities"] = len(found.vulnerabilities)
        failures += [f"vulnerable: {each}" for each in found.vulnerabilities]
    else:
        print(
            f"NOT CHECKED: no database of vulnerabilities ({', '.join(DATABASES)}) answered; give {options.sbom} to one"
        )
    return conclude("dependencies", figures, options, failures, database=found.database or None)


if __name__ == "__main__":
    sys.exit(main())
