"""Environments as another project has them: made anew from the wheel and a group of `examples/pyproject.toml`."""

import dataclasses
import pathlib
import shutil
import subprocess
import sys
import tempfile
import zipfile

from deltasafe.storage import digest_of, read_json, sha256_of_file, write_json
from pipelines.home import PROJECT

__all__ = ["EXAMPLES", "ConsumerEnvironment", "built_wheel"]

EXAMPLES = PROJECT / "examples"


@dataclasses.dataclass(frozen=True)
class ConsumerEnvironment:
    """An environment of one dependency group.

    Attributes:
        group: of `examples/pyproject.toml`.
        lacks: packages that must not be importable in it.
        on_top_of: the environment whose packages it sees too, so that torch is installed once.
    """

    group: str
    lacks: tuple[str, ...]
    on_top_of: "ConsumerEnvironment | None" = None

    @property
    def folder(self) -> pathlib.Path:
        """Where it lies; may be deleted at any time."""
        return EXAMPLES / f".venv-{self.group}"

    @property
    def python(self) -> pathlib.Path:
        """Its interpreter."""
        return self.folder / "bin" / "python"

    def make(self, wheel: pathlib.Path, torch_index: str = "") -> None:
        """Install what the group names, ``deltasafe`` from ``wheel``; one that fits is found again.

        Raises:
            subprocess.CalledProcessError: it could not be installed; pip has said why.
        """
        if self.on_top_of is not None:
            self.on_top_of.make(wheel, torch_index)
        wanted = digest_of([(EXAMPLES / "pyproject.toml").read_text(), _requirements(wheel), sys.version])
        wanted_wheel, stamp = sha256_of_file(wheel), self.folder / "made.json"
        takes_wheel = self.on_top_of is None and "deltasafe" not in self.lacks
        made = read_json(stamp) if stamp.is_file() else {}
        if made.get("requirements") != wanted:
            print(f"making {self.folder.relative_to(PROJECT)} ...", flush=True)
            shutil.rmtree(self.folder, ignore_errors=True)
            subprocess.run([sys.executable, "-m", "venv", str(self.folder)], check=True)
            self._pip("install", "--upgrade", "pip>=25.1")
            index = ["--extra-index-url", torch_index] if torch_index else []
            if self.on_top_of is not None:
                self._see(self.on_top_of)
            packages = [f"{wheel}[vision]"] if takes_wheel else []
            group = f"{EXAMPLES / 'pyproject.toml'}:{self.group}"
            self._pip("install", *packages, "--group", group, "-c", str(PROJECT / "constraints.txt"), *index)
        elif takes_wheel and made["wheel"] != wanted_wheel:
            self._pip("install", "--no-deps", "--force-reinstall", str(wheel))
        write_json(stamp, {"requirements": wanted, "wheel": wanted_wheel})

    def run(self, *arguments: str) -> "subprocess.CompletedProcess[str]":
        """Its interpreter in isolated mode, so that no module comes from the checkout or from `PYTHONPATH`."""
        command = [str(self.python), "-I", *arguments]
        return subprocess.run(command, capture_output=True, text=True, check=False, cwd=EXAMPLES)

    def intruders(self) -> list[str]:
        """Packages that it should lack and does not; ``deltasafe`` from somewhere else than the wheel is one, too."""
        program = (
            "import importlib.util, sys\n"
            "for name in sys.argv[1:]:\n"
            "    spec = importlib.util.find_spec(name)\n"
            "    print(name, spec.origin if spec else '')\n"
        )
        found = self.run("-c", program, *self.lacks, "deltasafe").stdout.splitlines()
        origin = {line.split()[0]: line.partition(" ")[2].strip() for line in found}
        wrong = [name for name in self.lacks if origin[name]]
        home = (self.on_top_of or self).folder.resolve()
        if "deltasafe" not in self.lacks and not pathlib.Path(origin["deltasafe"]).resolve().is_relative_to(home):
            wrong.append(f"deltasafe from {origin['deltasafe'] or 'nowhere'}")
        return wrong

    def _see(self, other: "ConsumerEnvironment") -> None:
        (packages,) = other.folder.glob("lib/python*/site-packages")
        (own,) = self.folder.glob("lib/python*/site-packages")
        (own / "on_top_of.pth").write_text(f"{packages}\n", encoding="utf-8")

    def _pip(self, *arguments: str) -> None:
        subprocess.run([str(self.python), "-I", "-m", "pip", "--quiet", *arguments], check=True)


def built_wheel(folder: pathlib.Path) -> pathlib.Path:
    """The wheel of this checkout, built by itself into ``folder``; nothing is fetched.

    Raises:
        subprocess.CalledProcessError: it cannot be built; its ``stderr`` says why.
    """
    folder.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=folder) as temporary:
        command = [sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", temporary]
        subprocess.run(command, check=True, cwd=PROJECT, capture_output=True, text=True)
        (built,) = pathlib.Path(temporary).glob("*.whl")
        return built.replace(folder / built.name)


def _requirements(wheel: pathlib.Path) -> list[str]:
    """What the wheel says it needs, and the versions that this project takes."""
    with zipfile.ZipFile(wheel) as archive:
        (name,) = [name for name in archive.namelist() if name.endswith(".dist-info/METADATA")]
        metadata = archive.read(name).decode().splitlines()
    needed = [line for line in metadata if line.startswith(("Requires-Dist", "Requires-Python"))]
    return [*needed, (PROJECT / "constraints.txt").read_text()]
