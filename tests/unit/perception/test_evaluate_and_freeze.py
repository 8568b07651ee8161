"""Evaluating members on folders of images, and freezing them with the fitted temperature and threshold."""

import dataclasses
import shutil
import tracemalloc

import cv2
import numpy as np
import pytest
from PIL import Image

from deltasafe.errors import DataError, SettingsError
from deltasafe.io.storage import read_json
from deltasafe.perception import evaluate_and_freeze
from deltasafe.perception.artifact.frozen_ensemble import load_ensemble
from deltasafe.perception.calibration.evaluation import evaluate as evaluate_predictions
from deltasafe.perception.calibration.labeled_predictions import LabeledPredictions
from deltasafe.perception.calibration.report import CalibrationReport, CalibrationSettings
from deltasafe.perception.data.labeled_images import LabeledImageSet
from deltasafe.perception.evaluate_and_freeze import (
    EvaluationSettings,
    evaluate_ensemble,
    freeze_ensemble,
    predict_images,
    read_labels,
)
from deltasafe.perception.inference.ensemble import Ensemble
from deltasafe.perception.settings import InferenceSettings, NetworkSettings
from deltasafe.perception.training.member import Member
from deltasafe.perception.training.network import build_network

NETWORK = NetworkSettings(pretrained=False, pyramid_channels=16)
INFERENCE = InferenceSettings(64, 48)
SETTINGS = CalibrationSettings(n_bootstrap=100, missed_hand_alpha=0.4)


def hands(folder, n_images, seed):
    rng = np.random.default_rng(seed)
    for part in ("images", "masks"):
        (folder / part).mkdir(parents=True)
    for index in range(n_images):
        mask = np.zeros((48, 64), np.uint8)
        mask[12:40, rng.integers(4, 20) : rng.integers(30, 60)] = 255
        image = rng.integers(0, 90, (48, 64, 3), dtype=np.uint8) + mask[..., None] // 2
        cv2.imwrite(str(folder / "images" / f"x_{index}.png"), image)
        cv2.imwrite(str(folder / "masks" / f"x_{index}.png"), mask)
    return LabeledImageSet.load(folder)


@pytest.fixture(scope="module")
def members(tmp_path_factory):
    record = {"settings": {"network": dataclasses.asdict(NETWORK)}, "data_digest": "d" * 64, "ensemble_identity": "e"}
    return [
        Member.write(tmp_path_factory.mktemp("member"), build_network(NETWORK, seed), {**record, "seed": seed})
        for seed in range(2)
    ]


@pytest.fixture(scope="module")
def sets(tmp_path_factory):
    root = tmp_path_factory.mktemp("hands")
    return hands(root / "test", 4, seed=1), hands(root / "calibration", 5, seed=2)


def evaluate(members, sets, folder, **options):
    return evaluate_ensemble(members, sets[0], folder, EvaluationSettings(INFERENCE, SETTINGS), device="cpu", **options)


def test_frozen_ensemble_uses_the_temperature_of_the_calibration_images(members, sets, tmp_path):
    folder = tmp_path / "report"
    report = evaluate(members, sets, folder, calibration_images=sets[1])
    assert CalibrationReport.load(folder) == report
    assert (len(report.image_ids), report.n_calibration_images) == (4, 5)
    assert read_json(folder / "judged.json")["calibration_digest"] == sets[1].digest
    rgb = sets[0].read(0)[0]
    frozen = freeze_ensemble(members, folder, rgb, tmp_path)
    ensemble = load_ensemble(frozen)
    temperature = report.calibrated.temperature
    assert ensemble.calibration.temperature == ensemble.temperature == temperature != 1.0
    mean = ensemble.member_p_occupied(rgb).mean(axis=0)
    odds = (mean / (1 - mean)) ** (1 / temperature)
    np.testing.assert_allclose(ensemble.p_occupied(rgb), odds / (1 + odds), atol=1e-5)
    assert ensemble.manifest["provenance"]["calibration_images"] == sets[1].digest
    card = (frozen / "model_card.md").read_text()
    assert f"temperature of **{temperature:.3f}**" in card
    threshold = report.risk_control.threshold
    assert threshold is not None
    assert f"`p_occupied <= {threshold:.3g}` (conformal risk control on 5 images" in card


def test_without_calibration_images_the_test_images_are_cross_fitted(members, sets, tmp_path):
    report = evaluate(members, sets, tmp_path / "report")
    assert report.calibration_image_ids == ()
    assert report.calibrated.lowest_temperature < report.calibrated.highest_temperature
    assert "calibration_digest" not in read_json(tmp_path / "report" / "judged.json")
    with pytest.raises(SettingsError, match="other members"):
        freeze_ensemble(members[:1], tmp_path / "report", sets[0].read(0)[0], tmp_path)


def test_an_image_in_both_sets_is_refused_before_anything_is_written(members, sets, tmp_path):
    mixed = tmp_path / "mixed"
    shutil.copytree(sets[1].items[0].image.parents[1], mixed)
    shutil.copyfile(sets[0].items[2].image, mixed / "images" / "x_3.png")
    shutil.copyfile(sets[0].items[2].mask, mixed / "masks" / "x_3.png")
    with pytest.raises(DataError, match=r"x_2.png: has the same pixels as .*x_3.png of the cali"):
        evaluate(members, sets, tmp_path / "report", calibration_images=LabeledImageSet.load(mixed))
    assert not (tmp_path / "report").exists()


def test_an_image_twice_in_a_set_is_refused_before_anything_is_written(members, sets, tmp_path):
    for role in ("test", "calibration"):
        folder = tmp_path / role
        shutil.copytree(sets[role == "calibration"].items[0].image.parents[1], folder)
        for part in ("images", "masks"):
            shutil.copyfile(folder / part / "x_1.png", folder / part / "y.png")
        copied = LabeledImageSet.load(folder)
        given = (copied, sets[1]) if role == "test" else (sets[0], copied)
        with pytest.raises(DataError, match=rf"y.png: has the same pixels as x_1.png of the same {role} set"):
            evaluate(members, given, tmp_path / "report", calibration_images=given[1])
    assert not (tmp_path / "report").exists()


def test_large_images_are_scaled_down_with_bounded_memory_and_disk(members, tmp_path, monkeypatch):
    """12 megapixels took 8.9 GB of memory and 93 MB of disk an image."""
    monkeypatch.setattr(evaluate_and_freeze, "EVALUATION_PIXELS", 10_000)
    for part in ("images", "masks"):
        (tmp_path / "large" / part).mkdir(parents=True)
    for n, size in enumerate([(1200, 900), (900, 1200)]):
        mask = Image.new("L", size)
        mask.paste(255, (size[0] // 4, size[1] // 4, size[0] // 2, size[1] // 2))
        mask.save(tmp_path / "large" / "masks" / f"{n}.png")
        Image.merge("RGB", [mask, mask, Image.new("L", size, n)]).save(tmp_path / "large" / "images" / f"{n}.jpg")
    images = LabeledImageSet.load(tmp_path / "large")
    ensemble = Ensemble([member.network() for member in members], INFERENCE)
    tracemalloc.start()
    predictions = predict_images(ensemble, images, tmp_path / "predictions")
    labels = read_labels(images)
    report = evaluate_predictions(LabeledPredictions(predictions.image_ids, labels, predictions), SETTINGS)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert [image.n_pixels for image in report.images] == [115 * 86] * 2
    assert report.images[0].n_hand_pixels == pytest.approx(115 * 86 / 16, rel=0.06)
    assert peak < 8 * 1200 * 900  # less than the float64 of one whole image
    stored = sum(path.stat().st_size for path in (tmp_path / "predictions").iterdir())
    assert stored < 2 * 2 * 4.1 * 10_000  # 2 images of 2 members, 4 bytes a pixel
