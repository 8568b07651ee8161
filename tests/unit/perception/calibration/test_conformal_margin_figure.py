"""The figure of conformal margins draws the margins of the report, and what covers the hand."""

import dataclasses

import numpy as np
import pytest
from matplotlib.colors import to_rgb

from deltasafe.errors import SettingsError
from deltasafe.perception.calibration.conformal_margin_figure import conformal_margin_figure
from deltasafe.perception.calibration.curve_drawing import ORANGE, RED
from deltasafe.perception.calibration.evaluation import evaluate
from deltasafe.perception.calibration.labeled_predictions import LabeledPredictions
from deltasafe.perception.calibration.overlay_figure import Overlay
from deltasafe.perception.calibration.report import CalibrationSettings

SETTINGS = CalibrationSettings(n_bootstrap=100, recalibrate=False)


def missed_columns(n_missed, shape=(20, 40)):
    """A hand of columns 10 to 29, of which the last ``n_missed`` are free."""
    label = np.zeros(shape, bool)
    label[:, 10:30] = True
    p_occupied = np.where(label, 0.9, 1e-5)
    p_occupied[:, 30 - n_missed : 30] = 1e-5
    return label, p_occupied


def report_of(n_missed):
    labels, predictions = zip(*map(missed_columns, n_missed), strict=True)
    names = [f"i{k}" for k in range(len(labels))]
    images = LabeledPredictions(names, labels, [np.stack([p] * 2) for p in predictions])
    return evaluate(images, SETTINGS)


def test_curves_are_the_margins_of_the_report():
    report = report_of([3, 1, 2, 4])
    (axes,) = conformal_margin_figure(report).axes
    curves = {line.get_label(): line.get_xydata() for line in axes.lines}
    assert set(curves) == {"delta = 0.02", "delta = 0.05", "delta = 0.2"}
    expected = [(100 * k / 5, 384 * (5 - k) / 40) for k in range(1, 5)]
    np.testing.assert_allclose(curves["delta = 0.05"], expected)


@pytest.mark.parametrize(("n_images", "n_covered"), [(20, 5), (50, 2)])  # alpha = 5 %: rank 20 of 20, rank 49 of 50
def test_pixels_of_the_hand_are_colored_by_what_covers_them(n_images, n_covered):
    report = report_of([2] * (n_images - 1) + [5])
    assert report.farthest_missed == n_images - 1
    label, p_occupied = missed_columns(5)
    image = np.full((*label.shape, 3), 200, np.uint8)
    left, _ = conformal_margin_figure(report, Overlay(report.image_ids[-1], image, label, p_occupied)).axes
    canvas = left.images[0].get_array()
    by_margin, missed = ((canvas == to_rgb(color)).all(axis=2) for color in (ORANGE, RED))
    expected = np.zeros_like(label)
    expected[:, 25 : 25 + n_covered] = True
    np.testing.assert_array_equal(by_margin, expected)
    np.testing.assert_array_equal(missed, label & (p_occupied < 0.05) & ~expected)
    assert left.get_title().endswith(f"farthest 48.0 px, margin {n_covered * 384 / 40:.1f} px")


def test_hand_without_an_unsafe_pixel_can_be_drawn(tmp_path):
    label = np.zeros((8, 9), bool)
    label[2:5] = True
    p_occupied = np.full((2, 8, 9), 1e-5, np.float32)
    images = LabeledPredictions(["a", "b"], [label] * 2, [p_occupied] * 2)
    report = evaluate(images, SETTINGS)
    worst = Overlay("a", np.zeros((8, 9, 3), np.uint8), label, p_occupied[0])
    figure = conformal_margin_figure(report, worst)
    figure.savefig(tmp_path / "picture.png", dpi=40)
    assert "infinite" in figure.axes[0].get_title()


def test_a_report_without_margins_is_refused():
    report = report_of([1, 2])
    older = dataclasses.replace(report.uncalibrated, hausdorff_at_delta=())
    with pytest.raises(SettingsError, match="calibrate again"):
        conformal_margin_figure(dataclasses.replace(report, uncalibrated=older))
