"""`dataset.json` names the obstacle of a set; everything that is made from the set carries it on."""

import dataclasses
import json
import re

import numpy as np
import pytest

from deltasafe.errors import DataError, SettingsError
from deltasafe.perception.artifact.model_card import model_card
from deltasafe.perception.calibration.evaluation import evaluate
from deltasafe.perception.calibration.labeled_predictions import LabeledPredictions
from deltasafe.perception.calibration.report import CalibrationReport, CalibrationSettings, gate
from deltasafe.perception.calibration.write_report import write_calibration_report
from deltasafe.perception.data.augmentation.settings import AugmentationSettings
from deltasafe.perception.data.augmented_set import AugmentedSet, augment_images
from deltasafe.perception.data.dataset_info import HANDS, DatasetInfo
from deltasafe.perception.data.labeled_images import LabeledImageSet, check_disjoint
from deltasafe.perception.settings import GateThresholds, InferenceSettings, NetworkSettings
from tests.ensembles import write_hands

CUPS = DatasetInfo("coffee_cup", gate=GateThresholds(missed_hand_rate=0.1))
HAND = re.compile(r"\bhands?\b|forearm", re.IGNORECASE)


@pytest.fixture
def cups(tmp_path):
    folder = write_hands(tmp_path / "cups")
    (folder / "dataset.json").write_text('{"obstacle": "coffee_cup", "gate": {"missed_hand_rate": 0.1}}')
    return LabeledImageSet.load(folder)


def test_display_names_follow_from_the_identifier():
    assert (CUPS.singular, CUPS.plural, CUPS.marked) == ("coffee cup", "coffee cups", "coffee cup")
    assert (CUPS.with_article, CUPS.capitalized) == ("a coffee cup", "Coffee cup")
    assert DatasetInfo("orange").with_article == "an orange"
    assert DatasetInfo("knife", plural="knives").plural == "knives"
    assert (HANDS.singular, HANDS.plural, HANDS.marked_with_article) == ("hand", "hands", "a hand or forearm")
    assert not CUPS.hand_recipe
    assert HANDS.hand_recipe
    assert DatasetInfo("foot", hand_recipe=True).hand_recipe


@pytest.mark.parametrize(
    "values",
    [
        {"obstacle": "Coffee cup"},
        {"obstacle": "../x"},
        {"obstacle": "cup", "singular": "a\nb"},
        {"images": "photo"},
        {"coverage": (0.5, 0.2)},
        {"coverage": (0.1,)},
    ],
)
def test_invalid_values_are_refused(values):
    with pytest.raises(SettingsError):
        DatasetInfo(**values)


@pytest.mark.parametrize("text", ["[]", '{"class": "cup"}', '{"obstacle": 3}', '{"gate": {"miou": 2}}', "{"])
def test_a_malformed_file_is_one_of_the_defects_of_the_set(tmp_path, text):
    folder = write_hands(tmp_path / "set")
    (folder / "dataset.json").write_text(text)
    (folder / "masks" / "0.png").unlink()
    with pytest.raises(DataError, match="has 2 defects") as caught:
        LabeledImageSet.load(folder)
    assert "dataset.json: " in str(caught.value)


def test_a_set_without_the_file_shows_hands_and_keeps_its_digest(tmp_path, cups):
    folder = write_hands(tmp_path / "hands")
    plain = LabeledImageSet.load(folder)
    assert plain.info == HANDS
    (folder / "dataset.json").write_text('{"images": "rendered"}')
    assert LabeledImageSet.load(folder).digest == plain.digest != cups.digest
    with pytest.raises(DataError, match=r"shows the obstacle 'hand', the training set 'coffee_cup'"):
        check_disjoint(cups, plain)


def test_the_augmentation_leaves_out_what_suits_hands_alone(cups, tmp_path):
    settings = AugmentationSettings(n_variants=12, width=64, height=48, probability=1.0)
    made = augment_images(cups, tmp_path / "augmented", settings, workers=1)
    assert AugmentedSet.load(made.folder).info == CUPS
    assert set(made.settings.left_out) == {"skin_tones", "clothing"}
    operations = {name for recipe in made.recipes for step in recipe["operations"] for name in step}
    assert "lightness" in operations
    assert not operations & {"tone", "strap", "sleeve", "rings"}
    assert not HAND.search(json.dumps(made.recipes))


def test_the_augmentation_of_hands_does_not_depend_on_the_new_parts(tmp_path):
    hands = LabeledImageSet.load(write_hands(tmp_path / "hands"))
    settings = AugmentationSettings(n_variants=12, width=64, height=48, probability=1.0)
    made = augment_images(hands, tmp_path / "augmented", settings, workers=1)
    operations = {name for recipe in made.recipes for step in recipe["operations"] for name in step}
    assert {"tone", "sleeve", "strap"} <= operations
    assert not (made.folder / "dataset.json").exists()


def test_recolored_objects_keep_about_their_color():
    from deltasafe.perception.data.augmentation.color import recolor_object
    from deltasafe.perception.data.augmentation.skin import mean_lab

    rng = np.random.default_rng(0)
    rgb = np.float32([0.1, 0.3, 0.7]) + rng.normal(0, 0.02, (20, 20, 3)).astype(np.float32)
    alpha = np.ones((20, 20), np.float32)
    shifts = [mean_lab(recolor_object(rng, rgb.copy(), alpha)[0], alpha) - mean_lab(rgb, alpha) for _ in range(200)]
    assert np.abs(np.mean(shifts, axis=0)).max() < 5.0
    assert np.abs(shifts)[:, 1:].max() < 30.0
    assert mean_lab(rgb, np.zeros_like(alpha)).tolist() == [0, 0, 0]


def test_no_page_about_coffee_cups_says_hand(tmp_path):
    rng = np.random.default_rng(0)
    labels = [np.zeros((48, 64), bool) for _ in range(5)]
    for k, label in enumerate(labels[:4]):
        label[10:30, 10 + k : 40] = True
    predictions = [
        np.clip(np.where(label, 0.9, 0.03)[None] + rng.normal(0, 0.1, (2, 48, 64)), 0, 1).astype(np.float32)
        for label in labels
    ]
    images = LabeledPredictions([str(k) for k in range(5)], labels, predictions)
    report = evaluate(images, CalibrationSettings(n_bootstrap=100), info=CUPS)
    path = write_calibration_report(tmp_path / "report", report, images, lambda _: np.zeros((48, 64, 3), np.uint8))
    assert CalibrationReport.load(path.parent) == report
    manifest = {"format_version": 3, "n_members": 2, "seeds": [0, 1], "network": dataclasses.asdict(NetworkSettings())}
    manifest["inference"] = dataclasses.asdict(InferenceSettings())
    card = model_card(manifest, report.calibration, report.info)
    for text in (path.read_text(), card):
        assert not HAND.search(text), HAND.search(text)
        assert "coffee cup" in text
    assert not HAND.search(" ".join(gate(report, GateThresholds(1.0, 1.0, 0.0))))
    assert "# Coffee cup occupancy ensemble" in card
    assert "| no coffee cup |" in path.read_text()


def test_the_model_card_says_that_images_were_rendered():
    from tests.ensembles import CALIBRATION

    manifest = {"format_version": 3, "n_members": 1, "seeds": [0], "network": dataclasses.asdict(NetworkSettings())}
    manifest["inference"] = dataclasses.asdict(InferenceSettings())
    rendered = model_card(manifest, CALIBRATION, DatasetInfo(images="rendered"))
    assert "measured on rendered images, not on photographs" in rendered
    assert "deltasafe evaluate ENSEMBLE FOLDER" in rendered
    assert "measured on rendered" not in model_card(manifest, CALIBRATION, DatasetInfo(images="photographs"))
