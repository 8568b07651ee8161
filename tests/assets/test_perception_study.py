"""The study in Dagster: one cell is trained, the tables name the missing cells, the command line reuses the cell."""

import functools
import json
import pathlib
import shutil

import dagster as dg
import pytest

from assets.interfaces import Store
from assets.perception_study import (
    CellConfig,
    augmentation_ablation,
    augmentation_tables,
    cells,
    ensemble_size,
    open_study,
    study_cell,
)
from deltasafe.compute.executor import LOCAL
from deltasafe.presets import PRESETS
from pipelines.commands.records import merge_part
from pipelines.storage.io_manager import FolderPointers

ROOT = pathlib.Path(__file__).parents[2]
STUDY = PRESETS["smoke"].study


class RecordingTracker:
    def __init__(self):
        self.figures = {}

    def report(self, identity, figures, folder, data):
        self.figures[identity] = (figures, data)
        return "http://mlflow/run"


@pytest.fixture
def few_hands(tmp_path):
    """Five originals and two test images."""
    for kind, n in (("train", 5), ("test", 2)):
        for part in ("images", "masks"):
            (tmp_path / kind / part).mkdir(parents=True)
            for source in sorted((ROOT / "datasets" / "hands" / kind / part).iterdir())[:n]:
                shutil.copy(source, tmp_path / kind / part)
    return tmp_path


def test_partitions_are_the_cells_in_the_order_of_work():
    assert cells.get_partition_keys() == [cell.name for cell in STUDY.cells()]


def test_cell_is_trained_once_and_tables_name_the_missing_cells(few_hands, monkeypatch):
    from deltasafe.perception.data.augmented_set import AugmentedSet
    from deltasafe.perception.training.train_member import train_member
    from deltasafe.studies.perception import study as module
    from pipelines.commands import perception_study as command

    trained = []

    def train_here(jobs, data, settings, *, device, workers, on_step, executor):
        for job in jobs:
            trained.append(job.name)
            report = functools.partial(on_step, job.name)
            train_member(AugmentedSet.load(data), settings, job.seed, job.folder, device, report)

    monkeypatch.setattr(module, "train_members", train_here)

    @dg.asset
    def raw_hands():
        return few_hands / "train"

    @dg.asset
    def test_hands():
        return few_hands / "test"

    home, tracker = few_hands / "home", RecordingTracker()
    store = Store(home, ROOT / "datasets")
    resources = {"io_manager": FolderPointers(home=str(home)), "store": store, "tracker": tracker, "executor": LOCAL}
    small = CellConfig(
        augmentation={"width": 64, "height": 48},
        training={"network": {"pyramid_channels": 16}, "epochs": 1},
        inference={"width": 64, "height": 48},
        calibration={"n_bootstrap": 100, "n_folds": 0},
        workers=1,
    )
    config = dg.RunConfig({"study_cell": small})
    sources = [raw_hands, test_hands]
    with dg.DagsterInstance.ephemeral() as instance:
        assert dg.materialize(sources, resources=resources, instance=instance).success
        for _ in range(2):
            made = dg.materialize(
                [*sources, study_cell],
                selection=[study_cell],
                partition_key="cutout-50",
                run_config=config,
                resources=resources,
                instance=instance,
            )
            assert made.success
        (event,) = made.asset_materializations_for_node("study_cell")
        assert event.partition == "cutout-50"
        assert event.metadata["distinct images"].value == 50
        assert event.metadata["MLflow run"].url == "http://mlflow/run"
        tables = [augmentation_tables, ensemble_size, augmentation_ablation]
        shown = dg.materialize(
            [*sources, study_cell, *tables], selection=tables, resources=resources, instance=instance
        )
    assert trained == ["cutout-50/0", "cutout-50/1"], "the second run reuses them"
    assert len(tracker.figures) == 1
    texts = {
        t.key.path[0]: shown.asset_materializations_for_node(t.key.path[0])[0].metadata["report"].value for t in tables
    }
    assert "| 50 | Cutout | 2 |" in texts["augmentation_tables"]
    assert "Not finished yet: mixup-50" in texts["augmentation_tables"]
    assert "data:image/png;base64," in texts["augmentation_tables"]
    assert "Not finished yet: ours-100." in texts["ensemble_size"]
    assert "Not finished yet: ours-100, ours-100-without-background" in texts["augmentation_ablation"]

    monkeypatch.setattr(command, "open_packaged", lambda root, workers: open_study(small, *paths, store))
    paths = few_hands / "train", few_hands / "test"
    record = few_hands / "results" / "perception.json"
    record.parent.mkdir()
    merge_part(record, "training", {"training_ratio": 1.7}, command="another", seeds={})
    merge_part(record, "study", {"gone": 1.0}, command="earlier", seeds={})
    arguments = ["study", "--cells", "cutout-50", "--home", str(home), "--record", str(record)]
    monkeypatch.setattr("sys.argv", arguments)
    assert command.main() == 1, "cells are missing"
    assert len(trained) == 2, "the command line reuses the members of the assets"
    written = json.loads(record.read_text())
    assert written["figures"]["training_ratio"] == 1.7
    assert "gone" not in written["figures"]
    assert written["figures"]["cutout_50_m"] == 2
    assert written["parts"]["study"]["missing"] == [cell.name for cell in STUDY.cells() if cell.name != "cutout-50"]
    assert written["command"] == "make study PRESET=smoke; another"
    assert {path.name for path in record.with_suffix("").iterdir()} == {"report.md", "schemes.png"}
