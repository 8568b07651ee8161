"""A frozen ensemble is evaluated as it is on any folder of labeled images; ignored pixels do not count."""

import collections
import dataclasses
import json
import pathlib

import cv2
import numpy as np
import pytest

from deltasafe.errors import DataError
from deltasafe.perception.calibration.report import CalibrationReport
from deltasafe.perception.data.dataset_info import HANDS, DatasetInfo
from deltasafe.perception.folder_evaluation import evaluate_folder
from tests.ensembles import CALIBRATION, write_hands

TEMPERATURE = 0.7


class FakeEnsemble:
    """Two members whose probabilities are the red and the green channel of the image."""

    folder = pathlib.Path("ensemble-0123456789abcdef")
    temperature = TEMPERATURE
    calibration = dataclasses.replace(CALIBRATION, temperature=TEMPERATURE, n_images=50)
    info = HANDS

    def __init__(self):
        self.calls = collections.Counter()

    def member_p_occupied(self, rgb):
        self.calls[rgb.tobytes()] += 1
        return np.moveaxis(rgb[..., :2], 2, 0).astype(np.float32) / 255


@pytest.fixture
def folder(tmp_path):
    folder = write_hands(tmp_path / "photographs", 5)
    mask = np.zeros((48, 64), np.uint8)
    mask[:2, 5:40] = 255
    (folder / "ignore").mkdir()
    cv2.imwrite(str(folder / "ignore" / "1.png"), mask)
    return folder


@pytest.fixture
def without_plots(monkeypatch):
    """Skip the pages, which take seconds; the figures are computed."""
    pages = "deltasafe.perception.folder_evaluation.write_calibration_report"
    monkeypatch.setattr(pages, lambda folder, *_: folder.mkdir(exist_ok=True))


def expected_scores(folder, name):
    """Compute PA, NLL, BS and the missed fraction of one image directly."""
    rgb = cv2.imread(str(folder / "images" / f"{name}.png"), cv2.IMREAD_COLOR_RGB)
    label = cv2.imread(str(folder / "masks" / f"{name}.png"), cv2.IMREAD_GRAYSCALE) > 0
    ignored = cv2.imread(str(folder / "ignore" / f"{name}.png"), cv2.IMREAD_GRAYSCALE)
    valid = np.ones_like(label) if ignored is None else ignored == 0
    mean = np.clip(rgb[..., :2].astype(np.float64).mean(axis=2) / 255, 1e-7, 1 - 1e-7)
    p = 1 / (1 + ((1 - mean) / mean) ** (1 / TEMPERATURE))
    p, label = p[valid], label[valid]
    nll = -np.log(np.where(label, p, 1 - p)).mean()
    return ((p >= 0.5) == label).mean(), nll, ((p - label) ** 2).mean(), (p[label] < 0.5).mean(), label.size


@pytest.mark.usefixtures("without_plots")
def test_scores_are_those_of_the_frozen_temperature_on_the_valid_pixels(folder, tmp_path):
    report = evaluate_folder(FakeEnsemble(), folder, tmp_path / "out")
    assert report.calibrated.temperature == report.calibrated.lowest_temperature == TEMPERATURE
    stored = json.loads((tmp_path / "out" / "metrics.json").read_text())
    expected = {name: expected_scores(folder, name) for name in stored["images"]}
    assert list(expected) == ["0", "1", "2", "3", "4"]
    for name, scores in stored["images"].items():
        found = (scores["pixel_accuracy"], scores["nll"], scores["brier"], scores["missed_hand_rate"])
        assert found == pytest.approx(expected[name][:4], abs=1e-6)
        assert scores["n_pixels"] == expected[name][4]
    weights = [scores[4] for scores in expected.values()]
    assert stored["figures"]["pa"] == pytest.approx(np.mean([scores[0] for scores in expected.values()]))
    assert stored["figures"]["nll"] == pytest.approx(np.average([s[1] for s in expected.values()], weights=weights))
    assert stored["interval"]["low"]["miou"] <= stored["figures"]["miou"] <= stored["interval"]["high"]["miou"]


@pytest.mark.usefixtures("without_plots")
def test_what_lies_below_ignored_pixels_changes_no_figure(folder, tmp_path):
    evaluate_folder(FakeEnsemble(), folder, tmp_path / "before")
    mask = cv2.imread(str(folder / "masks" / "1.png"), cv2.IMREAD_GRAYSCALE)
    ignored = cv2.imread(str(folder / "ignore" / "1.png"), cv2.IMREAD_GRAYSCALE) > 0
    cv2.imwrite(str(folder / "masks" / "1.png"), np.where(ignored, 255 - mask, mask))
    evaluate_folder(FakeEnsemble(), folder, tmp_path / "after")
    before, after = ((tmp_path / name / "metrics.json").read_text() for name in ("before", "after"))
    assert before == after


def test_the_report_says_what_was_fitted_and_what_was_not(folder, tmp_path):
    ensemble = FakeEnsemble()
    report = evaluate_folder(ensemble, folder, tmp_path / "out")
    assert len(ensemble.calls) == 5
    assert sum(ensemble.calls.values()) <= 5 + 3 + 3 + 1, "every image is predicted once, and shown images again"
    assert CalibrationReport.load(tmp_path / "out") == report
    text = (tmp_path / "out" / "report.md").read_text()
    assert "is `ensemble-0123456789abcdef` as it was frozen: its temperature was fitted on 50 other images" in text
    for wrong in ("temperature fitted on all other images", "stored with the ensemble were fitted", "is refused"):
        assert wrong not in text
    assert (tmp_path / "out" / "worst.jpg").is_file()


def test_all_defects_of_the_ignored_masks_are_listed(folder, tmp_path):
    cv2.imwrite(str(folder / "ignore" / "9.png"), np.zeros((48, 64), np.uint8))
    cv2.imwrite(str(folder / "ignore" / "0.png"), np.full((48, 64), 255, np.uint8))
    cv2.imwrite(str(folder / "ignore" / "1.png"), np.zeros((24, 32), np.uint8))
    with pytest.raises(DataError, match="has 3 defects") as caught:
        evaluate_folder(FakeEnsemble(), folder, tmp_path / "out")
    for part in (
        "9.png: has no counterpart",
        "0.png: ignores the whole image",
        "1.png: is 32 x 24 but its image is 64 x 48",
    ):
        assert part in str(caught.value)
    assert not (tmp_path / "out").exists()


@pytest.mark.usefixtures("without_plots")
def test_another_obstacle_and_another_folder_are_refused(folder, tmp_path):
    cups = FakeEnsemble()
    cups.info = DatasetInfo("coffee_cup", images="rendered")
    report = evaluate_folder(cups, folder, tmp_path / "cups")
    assert report.info == DatasetInfo("coffee_cup"), "without dataset.json, the set shows what the ensemble looks for"
    (folder / "dataset.json").write_text('{"obstacle": "spoon"}')
    with pytest.raises(DataError, match=r"shows the obstacle 'spoon', the training set 'coffee_cup'"):
        evaluate_folder(cups, folder, tmp_path / "spoons")
    with pytest.raises(DataError, match="exists and is no earlier evaluation"):
        evaluate_folder(cups, folder, tmp_path)
    (folder / "dataset.json").unlink()
    evaluate_folder(cups, folder, tmp_path / "cups")


def test_a_copy_in_the_folder_is_refused(folder, tmp_path):
    for part in ("images", "masks"):
        (folder / part / "copy.png").write_bytes((folder / part / "1.png").read_bytes())
    with pytest.raises(DataError, match=r"copy.png: has the same pixels as 1.png of the same test set"):
        evaluate_folder(FakeEnsemble(), folder, tmp_path / "report")


def test_large_images_are_scaled_down_with_mask_and_ignored_pixels(folder, tmp_path, monkeypatch, without_plots):
    monkeypatch.setattr("deltasafe.perception.folder_evaluation.EVALUATION_PIXELS", 24 * 32)
    report = evaluate_folder(FakeEnsemble(), folder, tmp_path / "report")
    assert [image.n_pixels for image in report.images] == [24 * 32, 24 * 32 - 18, *[24 * 32] * 3]
    assert [image.n_hand_pixels for image in report.images] == [2 * 5, 3 * 5 - 3, 3 * 5, 4 * 5, 4 * 5]
