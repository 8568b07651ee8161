"""The figure of reliability draws the values of the report."""

import numpy as np
import pytest

from deltasafe.perception.calibration.evaluation import evaluate
from deltasafe.perception.calibration.labeled_predictions import LabeledPredictions
from deltasafe.perception.calibration.reliability_figure import reliability_figure
from deltasafe.perception.calibration.report import CalibrationSettings


def report(n_members, seed=0, sharpness=1.0, **settings):
    rng = np.random.default_rng(seed)
    labels, predictions = [], []
    for _ in range(4):
        logit = rng.normal(-1, 3, size=(20, 30))
        labels.append(rng.random((20, 30)) < 1 / (1 + np.exp(-logit)))
        noisy = sharpness * (logit + rng.normal(size=(n_members, 20, 30)))
        predictions.append((1 / (1 + np.exp(-noisy))).astype(np.float32))
    images = LabeledPredictions(list("abcd"), labels, predictions)
    return evaluate(images, CalibrationSettings(n_bootstrap=100, **settings))


def lines(axes):
    return {line.get_label(): line.get_xydata() for line in axes.get_lines()}


def test_reliability_diagram_draws_members_ensembles_and_the_diagonal():
    result = report(5)
    figure = reliability_figure(result)
    confidence = next(axes for axes in figure.axes if axes.get_ylabel() == "Accuracy")
    drawn = lines(confidence)
    final = f"$M = 5$, $T = {result.final.temperature:.2f}$"
    assert set(drawn) >= {"Ideal", "Members", "$M = 2$", "$M = 5$, $T = 1$", final}
    for label, predictor in ((final, result.final.predictor), ("$M = 5$, $T = 1$", result.ensembles[-1])):
        curve = predictor.reliability
        np.testing.assert_allclose(drawn[label], np.transpose([curve.predicted, curve.observed]))
    assert len(confidence.get_lines()) == 1 + 5 + 3
    plain = reliability_figure(report(5, recalibrate=False))
    confidence = next(axes for axes in plain.axes if axes.get_ylabel() == "Accuracy")
    assert "$M = 5$" in lines(confidence)
    assert len(confidence.get_lines()) == 1 + 5 + 2


def test_safety_diagram_draws_the_fraction_of_occupied_pixels_and_the_bound():
    result = report(2)
    figure = reliability_figure(result)
    safety = next(axes for axes in figure.axes if axes.get_ylabel() == "Fraction of occupied pixels")
    drawn = lines(safety)
    shown = [value for value in result.final.safety.observed if value]
    in_bins = drawn["Pixels of one bin"][:, 1]
    np.testing.assert_allclose(in_bins[~np.isnan(in_bins)], shown)
    bound = next(data for label, data in drawn.items() if "bound" in label)
    np.testing.assert_allclose(bound, [(row.delta, row.upper_bound) for row in result.final.support])


@pytest.mark.parametrize(("n_members", "sharpness"), [(1, 1.0), (2, 50.0), (11, 0.01)])
def test_the_figure_can_be_drawn_for_any_ensemble(n_members, sharpness, tmp_path):
    result = report(n_members, sharpness=sharpness)
    reliability_figure(result).savefig(tmp_path / "picture.png", dpi=40)


def test_a_perfect_ensemble_can_be_drawn(tmp_path):
    label = np.zeros((8, 9), bool)
    label[2:5] = True
    p_occupied = np.stack([label, label]).astype(np.float32)
    images = LabeledPredictions(["a", "b"], [label] * 2, [p_occupied] * 2)
    result = evaluate(images, CalibrationSettings(n_bootstrap=100))
    reliability_figure(result).savefig(tmp_path / "picture.png", dpi=40)
