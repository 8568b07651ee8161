"""Virtual environments of other projects, made from the built wheel and a group of `examples/pyproject.toml`."""

import dataclasses
import pathlib
import shutil
import subprocess
import sys
import tempfile
import zipfile

from deltasafe.io.storage import digest_of, read_json, sha256_of_file, write_json
from pipelines.home import PROJECT

EXAMPLES = PROJECT / "examples"


@dataclasses.dataclass(frozen=True)
class ConsumerEnvironment:
    """A virtual environment of one dependency group.

    Attributes:
        group: name of the group in `examples/pyproject.toml`.
        lacks: packages that must not be importable.
        on_top_of: an environment whose packages are importable too, so that torch is installed once.
    """

    group: str
    lacks: tuple[str, ...]
    on_top_of: "ConsumerEnvironment | None" = None

    @property
    def folder(self) -> pathlib.Path:
        """Folder of the environment; may be deleted at any time."""
        return EXAMPLES / f".venv-{self.group}"

    @property
    def python(self) -> pathlib.Path:
        """Interpreter of the environment."""
        return self.folder / "bin" / "python"

    def make(self, wheel: pathlib.Path, torch_index: str = "") -> None:
        """Install the group, and ``deltasafe`` from ``wheel``; an existing environment is reused if nothing changed.

        Raises:
            subprocess.CalledProcessError: the installation failed; pip has printed the reason.
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
                self._link(self.on_top_of)
            packages = [f"{wheel}[vision]"] if takes_wheel else []
            group = f"{EXAMPLES / 'pyproject.toml'}:{self.group}"
            self._pip("install", *packages, "--group", group, "-c", str(PROJECT / "constraints.txt"), *index)
        elif takes_wheel and made["wheel"] != wanted_wheel:
            self._pip("install", "--no-deps", "--force-reinstall", str(wheel))
        write_json(stamp, {"requirements": wanted, "wheel": wanted_wheel})

    def run(self, *arguments: str) -> "subprocess.CompletedProcess[str]":
        """Run the interpreter in isolated mode, so that no module comes from the checkout or from `PYTHONPATH`."""
        command = [str(self.python), "-I", *arguments]
        return subprocess.run(command, capture_output=True, text=True, check=False, cwd=EXAMPLES)

    def forbidden_packages(self) -> list[str]:
        """Return importable packages that it must lack, and ``deltasafe`` if it does not come from the wheel."""
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

    def _link(self, other: "ConsumerEnvironment") -> None:
        (packages,) = other.folder.glob("lib/python*/site-packages")
        (own,) = self.folder.glob("lib/python*/site-packages")
        (own / "on_top_of.pth").write_text(f"{packages}\n", encoding="utf-8")

    def _pip(self, *arguments: str) -> None:
        subprocess.run([str(self.python), "-I", "-m", "pip", "--quiet", *arguments], check=True)


def built_wheel(folder: pathlib.Path) -> pathlib.Path:
    """Build the wheel of this checkout into ``folder`` without network access.

    Raises:
        subprocess.CalledProcessError: the build failed; its ``stderr`` has the reason.
    """
    folder.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=folder) as temporary:
        command = [sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", temporary]
        subprocess.run(command, check=True, cwd=PROJECT, capture_output=True, text=True)
        (built,) = pathlib.Path(temporary).glob("*.whl")
        return built.replace(folder / built.name)


def _requirements(wheel: pathlib.Path) -> list[str]:
    """Return the requirements of the wheel and the pinned versions of this project."""
    with zipfile.ZipFile(wheel) as archive:
        (name,) = [name for name in archive.namelist() if name.endswith(".dist-info/METADATA")]
        metadata = archive.read(name).decode().splitlines()
    needed = [line for line in metadata if line.startswith(("Requires-Dist", "Requires-Python"))]
    return [*needed, (PROJECT / "constraints.txt").read_text()]
