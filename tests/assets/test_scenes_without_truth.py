"""The check of occupancy fields on scenes of which some or all have no true mask."""

import dataclasses
import pathlib
import types

import dagster as dg
import numpy as np
import pytest

from assets.checks import true_hands_are_seen
from deltasafe.perception.data.masks import read_mask
from deltasafe.scene import load_scenes
from deltasafe.trials import selection

SCENES = load_scenes(pathlib.Path(__file__).parents[2] / "datasets" / "scenes")[:2]


@pytest.mark.parametrize(("n_judged", "missed", "passed"), [(0, 0.0, False), (1, 0.0, True), (1, 0.5, False)])
def test_scenes_without_a_mask_neither_pass_nor_fail(tmp_path, monkeypatch, n_judged, missed, passed):
    scenes = [
        scene if number < n_judged else dataclasses.replace(scene, mask_path=None)
        for number, scene in enumerate(SCENES)
    ]
    for scene in scenes:
        (tmp_path / scene.id).mkdir()
        hand = read_mask(SCENES[0].mask_path) > 0
        free = np.cumsum(hand).reshape(hand.shape) <= missed * hand.sum()  # the first pixels of the hand are missed
        np.save(tmp_path / scene.id / "p_occupied.npy", np.where(hand & ~free, 0.9, 0.0).astype(np.float32))
    monkeypatch.setattr(selection, "load_selection", lambda folder: scenes)
    context = types.SimpleNamespace(run=types.SimpleNamespace(run_config={}))
    result = true_hands_are_seen.node_def.compute_fn.decorated_fn(context, tmp_path, tmp_path)
    assert result.passed == passed
    assert result.severity == dg.AssetCheckSeverity.WARN
    assert f"not judged: {2 - n_judged} of 2 scenes" in result.description
    assert ("miss rate" in result.description) == (n_judged > 0)
    shown = result.metadata["largest miss rate at delta"].value
    assert shown == ("not judged" if n_judged == 0 else pytest.approx(missed, abs=1e-3))
