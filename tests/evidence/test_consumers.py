"""The built wheel, and the outcomes that `make examples` derives from its scripts."""

import pathlib
import subprocess
import sys
import zipfile

import numpy as np
import pytest

from evidence import consumers
from evidence.consumer_environments import ConsumerEnvironment, built_wheel
from evidence.consumers import PLAN, WAYS, figures_of, run_all

ROOT = pathlib.Path(__file__).parents[2]


@pytest.fixture(scope="module")
def wheel(tmp_path_factory):
    return built_wheel(tmp_path_factory.mktemp("dist"))


def test_wheel_contains_exactly_the_library(wheel):
    with zipfile.ZipFile(wheel) as archive:
        names = set(archive.namelist())
    library = {
        path.relative_to(ROOT).as_posix()
        for path in (ROOT / "deltasafe").rglob("*")
        if path.is_file() and "__pycache__" not in path.parts
    }
    assert "deltasafe/studies/planner/paper_curves.json" in library, "package data is included"
    assert {name for name in names if ".dist-info/" not in name} == library


def test_wheel_requires_no_orchestrator(wheel):
    with zipfile.ZipFile(wheel) as archive:
        (name,) = [name for name in archive.namelist() if name.endswith("/METADATA")]
        metadata = archive.read(name).decode().partition("\n\n")[0].lower().splitlines()
        (scripts,) = [name for name in archive.namelist() if name.endswith("/entry_points.txt")]
        assert "deltasafe = deltasafe.cli:main" in archive.read(scripts).decode()
    needed = [line for line in metadata if line.startswith("requires-dist")]
    assert any("numpy" in line for line in needed)
    assert any("torch" in line and "vision" in line for line in needed)
    assert not any(word in line for line in needed for word in ("dagster", "mlflow"))


class FakeEnvironment:
    """An environment whose scripts write given probabilities, or fail with a given error."""

    def __init__(self, results, forbidden=()):
        self.folder, self.results, self.forbidden = pathlib.Path("fake"), results, list(forbidden)

    def forbidden_packages(self):
        return self.forbidden

    def run(self, script, *arguments):
        result = self.results[pathlib.Path(script).stem]
        if isinstance(result, str):
            return subprocess.CompletedProcess([], 1, "", result)
        np.save(arguments[arguments.index("-o") + 1], np.full((2, 3), result, np.float32))
        return subprocess.CompletedProcess([], 0, "output\n", "")


@pytest.fixture
def outcomes_of(tmp_path, monkeypatch):
    (tmp_path / "image.png").touch()

    def run(results, forbidden=()):
        fake = FakeEnvironment({**dict.fromkeys([*WAYS, PLAN], 0.5), **results}, forbidden)
        monkeypatch.setattr(consumers, "WAYS", dict.fromkeys(WAYS, fake))
        monkeypatch.setattr(consumers, "TORCH", fake)
        return run_all(tmp_path, "sqlite://", tmp_path, tmp_path)

    return run


def test_equal_ways_pass(outcomes_of):
    outcomes = outcomes_of({"with_onnxruntime": 0.50005})
    assert all(not outcome.failure for outcome in outcomes.values())
    figures = figures_of(outcomes)
    assert (figures["consumer_ways"], figures["consumer_plan_passed"]) == (3, 1)
    assert figures["consumer_max_difference"] == pytest.approx(5e-5, rel=1e-2)
    assert {f"consumer_seconds_{name}" for name in (*WAYS, PLAN)} < set(figures)


def test_different_or_failed_way_does_not_count(outcomes_of):
    outcomes = outcomes_of({"with_onnxruntime": 0.51, "from_registry": "from_registry: no champion"})
    assert "differs" in outcomes["with_onnxruntime"].failure
    assert outcomes["from_registry"].failure == "from_registry: no champion"
    assert figures_of(outcomes)["consumer_ways"] == 1
    assert figures_of(outcomes_of({"from_folder": "broken"}))["consumer_ways"] == 0, "no reference to compare with"


def test_environment_with_forbidden_package_fails(outcomes_of):
    outcomes = outcomes_of({}, forbidden=["dagster"])
    assert all("dagster" in outcome.failure for outcome in outcomes.values())
    assert figures_of(outcomes)["consumer_ways"] == 0


def test_forbidden_packages_are_found():
    """The environment of this process has all packages, and deltasafe from the checkout."""

    class Here(ConsumerEnvironment):
        python = pathlib.Path(sys.executable)

    assert Here("torch", lacks=("dagster", "not_a_package")).forbidden_packages()[0] == "dagster"
    assert Here("torch", lacks=()).forbidden_packages()[0].startswith("deltasafe from")


def test_error_without_ensemble_has_a_remedy(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(consumers, "prepare_home", lambda: tmp_path)
    monkeypatch.setattr(consumers.EnsembleRegistry, "champion", lambda registry: None)
    assert consumers.main([]) == 1
    assert "make demo" in capsys.readouterr().err
    assert consumers.main(["--ensemble", str(tmp_path / "nowhere")]) == 1
    assert "nowhere: is not a folder" in capsys.readouterr().err
