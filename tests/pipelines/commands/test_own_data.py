"""Folders of one's own in `make demo`: fields of the run, a home of their own, and a refusal before anything is run."""

import pytest

from pipelines.commands import demo
from pipelines.own_data import converted, home_of, steps_of
from tests.ensembles import write_hands


def test_each_folder_is_a_field_of_its_step(tmp_path):
    hands = str(write_hands(tmp_path / "hands"))
    export = tmp_path / "export"
    export.mkdir()
    (export / "instances.json").write_text("{}")
    given = {"hands": hands, "test": str(export), "backgrounds": "/b", "scenes": "/s"}
    assert steps_of(given) == {
        "raw_hands": {"folder": hands},
        "test_hands": {"source": str(export)},
        "augmented_hands": {"backgrounds": "/b"},
        "logged_scenes": {"folder": "/s", "n_scenes": 0},
    }
    assert steps_of({"hands": str(tmp_path / "missing")}) == {"raw_hands": {"folder": str(tmp_path / "missing")}}
    assert steps_of({}) == {}


def test_labels_of_another_tool_are_converted_once_and_keep_their_class(tmp_path, capsys):
    export = write_hands(tmp_path / "export")
    (export / "dataset.json").write_text('{"obstacle": "coffee_cup"}')
    (export / "masks").rename(export / "labels")
    folders = converted(tmp_path, {"hands": str(export), "scenes": "/s"})
    assert "4 images of the format folder" in capsys.readouterr().out
    assert home_of(tmp_path, folders) == tmp_path / "own-data" / "coffee_cup"
    assert steps_of(folders)["raw_hands"] == {"folder": folders["hands"]}
    assert converted(tmp_path, {"hands": str(export)})["hands"] == folders["hands"]
    assert capsys.readouterr().out == ""


def test_labels_that_cannot_be_converted_are_left_to_the_launch_check(tmp_path):
    (tmp_path / "export").mkdir()
    folders = converted(tmp_path, {"test": str(tmp_path / "export")})
    assert steps_of(folders) == {"test_hands": {"source": str(tmp_path / "export")}}


def test_every_obstacle_has_a_home_of_its_own(tmp_path):
    hands = write_hands(tmp_path / "hands")
    assert home_of(tmp_path, {"scenes": "/s", "backgrounds": "/b"}) == tmp_path / "own-data" / "hand"
    assert home_of(tmp_path, {"hands": str(hands)}) == tmp_path / "own-data" / "hand"
    (hands / "dataset.json").write_text('{"obstacle": "coffee_cup"}')
    assert home_of(tmp_path, {"hands": str(hands)}) == tmp_path / "own-data" / "coffee_cup"


def test_scenes_alone_use_the_ensemble_of_the_packaged_images(tmp_path):
    assert home_of(tmp_path, {"scenes": "/s"}) == tmp_path


def test_figures_of_other_folders_are_not_recorded(capsys):
    with pytest.raises(SystemExit):
        demo.main(["--hands", "/nowhere", "--record", "figures.json"])
    assert "--record is for the packaged data" in capsys.readouterr().err


def test_defects_are_listed_and_nothing_is_run(tmp_path, monkeypatch, capsys):
    for name in ("DELTASAFE_HOME", "DAGSTER_HOME"):
        monkeypatch.setenv(name, str(tmp_path / "home"))
    (write_hands(tmp_path / "hands") / "masks" / "0.png").unlink()
    assert demo.main(["--hands", str(tmp_path / "hands"), "--scenes", "/nowhere"]) == 1
    error = capsys.readouterr().err
    assert "nothing was run, since inputs are defective" in error
    assert "0.png: has no counterpart" in error
    assert "scenes: /nowhere: " in error
    assert "Traceback" not in error
    assert not (tmp_path / "home" / "own-data" / "hand" / "store").exists()
