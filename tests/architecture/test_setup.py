"""How `make` chooses an interpreter (interpreters, uv and compilers are fakes), hooks, citation, versions."""

import pathlib
import re
import shutil
import subprocess
import sys
import tomllib

import pytest
import yaml

import deltasafe

ROOT = pathlib.Path(__file__).parents[2]
TOOLS = ("make", "sh", "awk", "touch", "env")

FAKE_PYTHON = '''#!/usr/bin/env {python}
"""Python {version} as far as the set-up can tell: runs -c, logs everything else, and copies itself for -m venv."""
import pathlib, platform, sys, sysconfig
arguments = sys.argv[1:]
if arguments == ["-V"]:
    print("Python {version}")
elif arguments[0] == "-c":
    sys.version_info = (*map(int, "{version}".split(".")), "final", 0)
    sys.platform = "linux"
    platform.python_version, platform.machine = lambda: "{version}", lambda: "{machine}"
    platform.system = lambda: "Linux"
    sysconfig.get_path = lambda name: "{headers}"
    sys.modules.update(dict.fromkeys({missing!r}))
    exec(arguments[1])
else:
    with open("{log}", "a") as log:
        print("{version}", *arguments, file=log)
    if arguments[:2] == ["-m", "venv"]:
        python = pathlib.Path(arguments[-1], "bin", "python")
        python.parent.mkdir(parents=True, exist_ok=True)
        python.write_text(pathlib.Path(__file__).read_text())
        python.chmod(0o755)
'''
FAKE_UV = """#!/bin/sh
echo uv "$@" >>{log}
if [ "$1" = venv ]; then python3.11-of-uv -m venv .venv; fi
"""


class Machine:
    """A checkout with nothing but its set-up files, and a PATH with nothing but what a test puts there."""

    def __init__(self, folder):
        self.checkout, self.path, self.headers = folder / "checkout", folder / "bin", folder / "headers"
        self.log = folder / "log"
        self.checkout.mkdir()
        self.path.mkdir()
        for name in ("Makefile", "create_venv.sh", "pyproject.toml", "constraints.txt"):
            shutil.copy(ROOT / name, self.checkout)
        for name in TOOLS:
            self.path.joinpath(name).symlink_to(shutil.which(name))
        self.add("uname", "#!/bin/sh\necho Linux x86_64\n")

    def add(self, name, text="#!/bin/sh\n"):
        path = self.path / name
        path.write_text(text.replace("{log}", str(self.log)), encoding="utf-8")
        path.chmod(0o755)

    def add_python(self, name, version, machine="x86_64", missing=()):
        values = {"python": sys.executable, "version": version, "machine": machine, "missing": missing}
        self.add(name, FAKE_PYTHON.format(**values, headers=self.headers, log=self.log))

    def add_compiler(self):
        self.add("cc")
        self.add("c++")
        self.headers.mkdir()
        self.headers.joinpath("Python.h").touch()

    def make(self, *arguments):
        return subprocess.run(
            ["make", *arguments],
            cwd=self.checkout,
            env={"PATH": str(self.path), "HOME": str(self.checkout)},
            capture_output=True,
            text=True,
            check=False,
        )

    def calls(self):
        return self.log.read_text(encoding="utf-8").splitlines() if self.log.exists() else []

    def demo_ran_with(self, version):
        python, _, module = self.calls()[-1].partition(" -m ")
        return python == version and module.startswith("pipelines.") and module.endswith(".demo")


@pytest.fixture
def machine(tmp_path):
    if not shutil.which("make"):
        pytest.skip("needs make")
    return Machine(tmp_path)


def assert_stopped_with_remedy(run, *expected):
    assert run.returncode != 0
    for text in expected:
        assert text in run.stderr


@pytest.mark.parametrize("newer", ["3.12.3", "3.13.5"])
def test_python_311_is_preferred_to_a_newer_python3(machine, newer):
    machine.add_python("python3", newer)
    machine.add_python("python3.11", "3.11.2")
    assert machine.make("demo").returncode == 0
    assert machine.calls()[0] == "3.11.2 -m venv --clear .venv"
    assert machine.demo_ran_with("3.11.2")


def test_python3_is_used_if_it_is_311(machine):
    machine.add_python("python3", "3.11.2")
    assert machine.make("demo").returncode == 0
    assert machine.demo_ran_with("3.11.2")


def test_a_command_that_fails_is_not_taken_for_python_311(machine):
    machine.add("python3.11", "#!/bin/sh\nexit 127\n")
    machine.add_python("python3", "3.11.2")
    assert machine.make("demo").returncode == 0
    machine.add_python("python3", "3.13.5")
    shutil.rmtree(machine.checkout / ".venv")
    assert_stopped_with_remedy(machine.make("demo"), "python3.11 is a command that fails", "Python 3.13.5")


@pytest.mark.parametrize("goal", ["demo", "test"])
@pytest.mark.parametrize("version", ["3.10.12", "3.12.3", "3.13.5"])
def test_other_versions_stop_before_anything_is_installed(machine, version, goal):
    machine.add_python("python3", version)
    run = machine.make(goal)
    remedies = [f'install uv && PATH="$HOME/.local/bin:$PATH" make {goal}', f"make COMPILE_PYBULLET=1 {goal}"]
    assert_stopped_with_remedy(run, f"Python {version} on Linux x86_64", *remedies)
    assert machine.calls() == []
    assert not (machine.checkout / ".venv").exists()


def test_no_interpreter_at_all_stops_with_the_remedy(machine):
    assert_stopped_with_remedy(machine.make("demo"), "python3.11 or python3 was not found", "python3.11-venv")


def test_a_machine_without_a_wheel_stops_with_the_remedy(machine):
    machine.add_python("python3.11", "3.11.2", machine="aarch64")
    assert_stopped_with_remedy(machine.make("demo"), "Python 3.11.2 on Linux aarch64", "COMPILE_PYBULLET=1")


def test_python_names_the_interpreter(machine):
    machine.add_python("python3.11", "3.11.2")
    machine.add_python("mine", "3.11.9")
    machine.add_python("newer", "3.12.3")
    assert machine.make("demo", "PYTHON=mine").returncode == 0
    assert machine.demo_ran_with("3.11.9")
    (machine.checkout / ".venv" / ".installed").unlink()
    assert_stopped_with_remedy(machine.make("demo", "PYTHON=newer"), "newer is Python 3.12.3")
    assert_stopped_with_remedy(machine.make("demo", "PYTHON=absent"), "absent was not found")


def test_uv_provides_python_311_if_no_interpreter_fits(machine):
    machine.add_python("python3", "3.13.5")
    machine.add_python("python3.11-of-uv", "3.11.14")
    machine.add("uv", FAKE_UV)
    assert machine.make("demo").returncode == 0
    assert machine.calls()[0] == "uv venv --seed --clear --python 3.11 .venv"
    assert machine.demo_ran_with("3.11.14")


def test_a_failure_of_uv_stops_with_the_remedy(machine):
    machine.add_python("python3", "3.13.5")
    machine.add("uv", "#!/bin/sh\necho no network >&2\nexit 2\n")
    assert_stopped_with_remedy(machine.make("demo"), "no network", "uv could not create", "COMPILE_PYBULLET=1 demo")


def test_a_missing_venv_module_is_named_with_its_package(machine):
    machine.add_python("python3.11", "3.11.2", missing=("ensurepip",))
    assert_stopped_with_remedy(machine.make("demo"), "apt install python3.11-venv")


def test_pybullet_is_compiled_only_on_request(machine):
    machine.add_python("python3", "3.13.5")
    machine.add_compiler()
    assert machine.make("demo", "COMPILE_PYBULLET=1").returncode == 0
    assert not any("--only-binary" in call for call in machine.calls())
    assert machine.demo_ran_with("3.13.5")
    shutil.rmtree(machine.checkout / ".venv")
    machine.add_python("python3.11", "3.11.2")
    assert machine.make("demo").returncode == 0
    assert any("-m pip install" in call and "--only-binary pybullet" in call for call in machine.calls())


def test_compiling_without_a_compiler_stops_with_the_remedy(machine):
    machine.add_python("python3", "3.13.5")
    assert_stopped_with_remedy(machine.make("demo", "COMPILE_PYBULLET=1"), "sudo apt install g++ python3-dev")
    assert machine.calls() == []


def test_an_environment_that_fits_is_kept_and_another_version_is_replaced(machine):
    machine.add_python("python3.11", "3.11.2")
    assert machine.make("demo").returncode == 0
    (machine.checkout / ".venv" / ".installed").unlink()
    assert machine.make("demo").returncode == 0
    assert sum("-m venv" in call for call in machine.calls()) == 1
    python = machine.checkout / ".venv" / "bin" / "python"
    python.write_text(python.read_text().replace("3.11.2", "3.12.3"))
    (machine.checkout / ".venv" / ".installed").unlink()
    assert machine.make("demo").returncode == 0
    assert machine.demo_ran_with("3.11.2")


def test_help_lists_every_command(machine):
    listed = set(re.findall(r"^make ([a-z-]+) ", machine.make().stdout, re.MULTILINE))
    makefile = (ROOT / "Makefile").read_text(encoding="utf-8")
    phony = re.search(r"^\.PHONY: (.*)$", makefile, re.MULTILINE)[1].split()
    assert listed == set(phony)


def test_hooks_run_the_commands_of_ci():
    config = yaml.safe_load((ROOT / ".pre-commit-config.yaml").read_text(encoding="utf-8"))
    assert [repository["repo"] for repository in config["repos"]] == ["local"], "others are downloaded"
    hooks = {hook["entry"]: hook["stages"] for hook in config["repos"][0]["hooks"]}
    assert hooks == {"make check": ["pre-commit"], "make test docs": ["pre-push"]}
    ci = (ROOT / ".ci" / "run").read_text(encoding="utf-8")
    assert "make test\n" in ci
    assert "make docs\n" in ci


def test_citation_names_the_version_and_the_paper():
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text(encoding="utf-8"))
    assert citation["cff-version"] == "1.2.0"
    assert citation["version"] == deltasafe.__version__
    assert citation["message"]
    assert citation["title"] == "deltasafe"
    assert citation["authors"]
    paper = citation["preferred-citation"]
    assert paper["type"] == "article"
    assert paper["year"] == 2023
    assert [author["family-names"] for author in paper["authors"]] == ["Römer", "Lederer", "Tesfazgi", "Hirche"]
    assert paper["title"] in " ".join((ROOT / "README.md").read_text(encoding="utf-8").split())


def test_versions_agree():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    assert project["version"] == deltasafe.__version__
    changes = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    assert deltasafe.__version__ in changes
    assert re.findall(r"^## \[(.+?)\]", changes, re.MULTILINE)[0] == "Unreleased"


def test_pybullet_is_pinned_to_the_release_whose_wheels_are_known():
    pins = (ROOT / "constraints.txt").read_text(encoding="utf-8").splitlines()
    (pybullet,) = [pin for pin in pins if pin.startswith("pybullet==")]
    assert f"PyBullet {pybullet.removeprefix('pybullet==')} has" in (ROOT / "create_venv.sh").read_text(
        encoding="utf-8"
    )


def test_folders_of_the_demo_are_those_given_to_make_itself(machine):
    machine.add_python("python3.11", "3.11.2")
    assert machine.make("demo", "HANDS=/my hands", "SCENES=/scenes").returncode == 0
    assert machine.calls()[-1].endswith("pipelines.commands.demo --hands /my hands --scenes /scenes")
    run = subprocess.run(
        ["make", "demo"],
        cwd=machine.checkout,
        env={"PATH": str(machine.path), "HOME": str(machine.checkout), "TEST": "1"},
        capture_output=True,
        text=True,
        check=False,
    )
    assert run.returncode == 0
    assert machine.calls()[-1].endswith("pipelines.commands.demo")
