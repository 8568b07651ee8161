"""The safety study as an asset, and merging its figures into a record."""

import argparse
import dataclasses
import pathlib
import types

import dagster as dg
import numpy as np
import pytest
from PIL import Image

import deltasafe.studies.safety
from assets.safety_study import safety_trials
from deltasafe.compute.executor import LOCAL
from deltasafe.io.storage import read_json, write_json
from deltasafe.presets import VARIABLE
from pipelines.commands import safety_study
from pipelines.resources import StoreResource
from pipelines.storage.io_manager import FolderPointers


@pytest.mark.parametrize("given", ["", "elsewhere"])
def test_the_ensemble_in_use_is_the_default(tmp_path, monkeypatch, given):
    requested = []

    class Found:
        executed = np.array([True, False])
        effort = types.SimpleNamespace(minutes=1.0)

        def save(self, folder):
            folder.mkdir(parents=True)

    def gather(folders, ensemble, n_scenes):
        assert len(folders) == 1
        requested.append(str(ensemble))
        return "inputs"

    monkeypatch.setattr(deltasafe.studies.safety, "StudyInputs", types.SimpleNamespace(gather=gather))
    monkeypatch.setattr(deltasafe.studies.safety, "run_study", lambda *arguments: Found())
    in_use = tmp_path / "frozen" / "ensemble-in-use"
    in_use.mkdir(parents=True)

    registry = types.SimpleNamespace(champion=lambda: in_use)
    made = materialized(tmp_path, registry, given)
    assert made.success
    assert requested == [given or str(in_use)]


def materialized(root, registry, ensemble):
    resources = {
        "io_manager": FolderPointers(home=str(root)),
        "store": StoreResource(home=str(root), datasets=str(root)),
        "registry": dg.ResourceDefinition.hardcoded_resource(registry),
        "executor": LOCAL,
    }
    config = {"ops": {"safety_trials": {"config": {"ensemble": ensemble}}}}
    with dg.DagsterInstance.ephemeral() as instance:
        return dg.materialize(
            [safety_trials], resources=resources, instance=instance, run_config=config, raise_on_error=False
        )


def test_a_missing_ensemble_is_reported_with_a_remedy(tmp_path):
    made = materialized(tmp_path, types.SimpleNamespace(champion=lambda: None), "")
    assert not made.success
    (failed,) = made.get_step_failure_events()
    assert "make demo" in str(failed.step_failure_data.error)


@dataclasses.dataclass
class Options:
    record: pathlib.Path
    scenes: list[pathlib.Path] | None = None
    executions: int | None = None
    gamma: tuple[float, float] | None = None


def test_recording_keeps_the_figures_of_other_commands(tmp_path, monkeypatch):
    monkeypatch.delenv(VARIABLE, raising=False)
    folder = tmp_path / "report"
    folder.mkdir()
    (folder / "report.md").write_text("# Report")
    Image.fromarray(np.zeros((8, 8, 3), np.uint8)).save(folder / "rates.png")
    write_json(folder / "study.json", {"settings": {"seed": 5}, "ensemble": "/some/where/ensemble-1"})
    record = tmp_path / "results" / "safety.json"
    theirs = {"figures": {"tracking_coverage": 0.99}, "seeds": 1, "command": "tracking", "commit": "abc"}
    write_json(record, {"figures": theirs["figures"], "parts": {"tracking": {**theirs, "seeds": {"first": 1}}}})
    first = Options(record, executions=10, scenes=[pathlib.Path("a/scenes")], gamma=(0.0005, 0.04))
    for options, figures in ((first, {"executions": 10.0, "gone": 1.0}), (Options(record), {"executions": 20.0})):
        write_json(folder / "figures.json", figures)
        safety_study._record(argparse.Namespace(**dataclasses.asdict(options)), folder)
    stored = read_json(record)
    assert stored["figures"] == {"tracking_coverage": 0.99, "executions": 20.0}
    assert stored["command"] == "python -m pipelines.commands.safety_study; tracking"
    assert stored["seeds"] == {"tracking": {"first": 1}, "safety_study": {"situations": 5}}
    assert stored["parts"]["safety_study"]["ensemble"] == "ensemble-1"
    assert (record.parent / "safety_study" / "report.md").read_text() == "# Report"
    assert (record.parent / "safety_study" / "rates.png").is_file()
