"""The wheel that others install, and what `make examples` concludes from the scripts that it ran."""

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


def test_the_wheel_holds_the_library_and_nothing_else(wheel):
    with zipfile.ZipFile(wheel) as archive:
        names = set(archive.namelist())
    library = {
        path.relative_to(ROOT).as_posix()
        for path in (ROOT / "deltasafe").rglob("*")
        if path.is_file() and "__pycache__" not in path.parts
    }
    assert "deltasafe/planner_study/paper_curves.json" in library, "data that belongs to code travels with it"
    assert {name for name in names if ".dist-info/" not in name} == library


def test_the_wheel_asks_for_no_orchestrator(wheel):
    with zipfile.ZipFile(wheel) as archive:
        (name,) = [name for name in archive.namelist() if name.endswith("/METADATA")]
        metadata = archive.read(name).decode().partition("\n\n")[0].lower().splitlines()
        (scripts,) = [name for name in archive.namelist() if name.endswith("/entry_points.txt")]
        assert "deltasafe = deltasafe.cli:main" in archive.read(scripts).decode()
    needed = [line for line in metadata if line.startswith("requires-dist")]
    assert any("numpy" in line for line in needed)
    assert any("torch" in line and "vision" in line for line in needed)
    assert not any(word in line for line in needed for word in ("dagster", "mlflow"))


class Pretended:
    """An environment whose scripts write what a test wants."""

    def __init__(self, answers, intruders=()):
        self.folder, self.answers, self.found = pathlib.Path("pretended"), answers, list(intruders)

    def intruders(self):
        return self.found

    def run(self, script, *arguments):
        answer = self.answers[pathlib.Path(script).stem]
        if isinstance(answer, str):
            return subprocess.CompletedProcess([], 1, "", answer)
        np.save(arguments[arguments.index("-o") + 1], np.full((2, 3), answer, np.float32))
        return subprocess.CompletedProcess([], 0, "said\n", "")


@pytest.fixture
def outcomes_of(tmp_path, monkeypatch):
    (tmp_path / "image.png").touch()

    def run(answers, intruders=()):
        pretended = Pretended({**dict.fromkeys([*WAYS, PLAN], 0.5), **answers}, intruders)
        monkeypatch.setattr(consumers, "WAYS", dict.fromkeys(WAYS, pretended))
        monkeypatch.setattr(consumers, "TORCH", pretended)
        return run_all(tmp_path, "sqlite://", tmp_path, tmp_path)

    return run


def test_ways_that_agree_pass(outcomes_of):
    outcomes = outcomes_of({"with_onnxruntime": 0.50005})
    assert all(not outcome.complaint for outcome in outcomes.values())
    figures = figures_of(outcomes)
    assert (figures["consumer_ways"], figures["consumer_plan_passed"]) == (3, 1)
    assert figures["consumer_max_difference"] == pytest.approx(5e-5, rel=1e-2)
    assert {f"consumer_seconds_{name}" for name in (*WAYS, PLAN)} < set(figures)


def test_a_way_that_says_something_else_or_nothing_is_not_counted(outcomes_of):
    outcomes = outcomes_of({"with_onnxruntime": 0.51, "from_registry": "from_registry: no champion"})
    assert "differs" in outcomes["with_onnxruntime"].complaint
    assert outcomes["from_registry"].complaint == "from_registry: no champion"
    assert figures_of(outcomes)["consumer_ways"] == 1
    assert figures_of(outcomes_of({"from_folder": "broken"}))["consumer_ways"] == 0, "nothing to compare with"


def test_an_environment_that_holds_an_orchestrator_proves_nothing(outcomes_of):
    outcomes = outcomes_of({}, intruders=["dagster"])
    assert all("dagster" in outcome.complaint for outcome in outcomes.values())
    assert figures_of(outcomes)["consumer_ways"] == 0


def test_intruders_are_found():
    """This process's own environment holds everything, and deltasafe from the checkout."""

    class Here(ConsumerEnvironment):
        python = pathlib.Path(sys.executable)

    assert Here("torch", lacks=("dagster", "not_a_package")).intruders()[0] == "dagster"
    assert Here("torch", lacks=()).intruders()[0].startswith("deltasafe from")


def test_without_an_ensemble_in_use_it_says_what_to_do(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(consumers, "prepare_home", lambda: tmp_path)
    monkeypatch.setattr(consumers.EnsembleRegistry, "champion", lambda registry: None)
    assert consumers.main([]) == 1
    assert "make demo" in capsys.readouterr().err
    assert consumers.main(["--ensemble", str(tmp_path / "nowhere")]) == 1
    assert "nowhere: is not a folder" in capsys.readouterr().err
