"""``evidence.labels`` counts formats whose pixels are exact, and fails for one that is not."""

import json

import numpy as np

from evidence import labels


def test_all_formats_are_exact_and_a_wrong_one_is_found(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(labels, "SOURCES", {name: labels.SOURCES[name] for name in ("cvat", "voc")})
    monkeypatch.setattr(labels, "differing_pixels_of_kinds", lambda work: 0)
    assert labels.main(["--record", str(tmp_path / "inputs.json")]) == 0
    assert json.loads((tmp_path / "inputs.json").read_text())["figures"] == {"label_formats": 3, "label_sources": 3}
    read = labels.read_masks
    wrong = {"Hände 2": np.ones((24, 32), bool)}
    monkeypatch.setattr(labels, "read_masks", lambda folder: wrong if folder.name == "voc" else read(folder))
    assert labels.main([]) == 1
    assert "FAILED  voc: " in capsys.readouterr().err


def test_masks_of_all_kinds_in_plain_folders(tmp_path):
    assert labels.differing_pixels_of_kinds(tmp_path) == 0
