"""Labels of other tools as the input of a run: converted once, and refused before the run if they are ambiguous."""

import pathlib
import shutil

import dagster as dg
import pytest

from assets.interfaces import Store
from assets.perception import HandsConfig, raw_hands
from deltasafe.errors import SettingsError
from deltasafe.perception.data.labeled_images import LabeledImageSet
from pipelines.automation.launch_check import defective_inputs, wrong_settings
from pipelines.home import DATASETS

GOLDEN = pathlib.Path(__file__).parents[1] / "golden" / "labels"
LABELS = {"format": "labelme", "classes": ["hand"]}


@pytest.fixture
def source(tmp_path):
    shutil.copytree(GOLDEN / "labelme", tmp_path / "export" / "labelme")
    shutil.copytree(GOLDEN / "images", tmp_path / "export" / "images")
    return tmp_path / "export"


def test_source_is_converted_once_and_again_when_it_changes(source, tmp_path):
    store = Store(tmp_path / "home", DATASETS)
    config = HandsConfig(source=str(source), labels=LABELS)
    folder, registry = config.input(store, "raw_hands", "hands/train")
    assert registry is None
    assert len(LabeledImageSet.load(folder)) == 4
    made = (folder / "import.json").stat().st_mtime_ns
    assert config.input(store, "raw_hands", "hands/train")[0] == folder
    assert (folder / "import.json").stat().st_mtime_ns == made
    (source / "labelme" / "nothing.json").unlink()
    (source / "images" / "nothing.jpg").unlink()
    again, _ = config.input(store, "raw_hands", "hands/train")
    assert again != folder
    assert len(LabeledImageSet.load(again)) == 3
    with pytest.raises(SettingsError, match="either folder or source"):
        HandsConfig(folder="a", source="b").input(store, "raw_hands", "hands/train")


@pytest.mark.filterwarnings("ignore:Parameter `data_version`")
def test_asset_shows_the_table_of_the_conversion(source, tmp_path):
    store = Store(tmp_path / "home", DATASETS)
    output = raw_hands(HandsConfig(source=str(source), labels=LABELS), store)
    assert output.value.parent == tmp_path / "home" / "store" / "raw_hands"
    assert isinstance(output.metadata["conversion"], dg.MarkdownMetadataValue)
    assert "| ../images/nothing.jpg | nothing |" in output.metadata["conversion"].value


def test_ambiguous_source_is_a_defect_of_the_run(source, tmp_path):
    store = Store(tmp_path / "home", DATASETS)
    config = {"ops": {"raw_hands": {"config": {"source": str(source)}}}}
    message = defective_inputs(config, ["raw_hands"], store)
    assert "raw_hands: " in message
    assert "several classes: cup (3 images), hand (2 images)" in message
    wrong = {"ops": {"raw_hands": {"config": {"source": str(source), "labels": {"format": "yolo"}}}}}
    assert "format must be one of auto, coco" in wrong_settings(wrong)
