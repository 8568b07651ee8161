"""The evaluation: every figure against one computed directly from all pixels at once."""

import dataclasses

import numpy as np
import pytest

from deltasafe.errors import SettingsError
from deltasafe.perception.calibration.conformal_margin import ConformalMargins, hausdorff_at_delta
from deltasafe.perception.calibration.conformal_risk import conformal_threshold, missed_fractions
from deltasafe.perception.calibration.delta_support import held_out_support
from deltasafe.perception.calibration.evaluation import evaluate
from deltasafe.perception.calibration.labeled_predictions import LabeledPredictions
from deltasafe.perception.calibration.metrics import score_image
from deltasafe.perception.calibration.reliability import DELTA_GRID, safety_counts, stack_counts
from deltasafe.perception.calibration.report import CalibrationSettings
from deltasafe.perception.calibration.temperature import (
    apply_temperature,
    fit_temperature,
    logit_counts,
    stack_logit_counts,
)
from deltasafe.perception.inference.predictions import MemberPredictions
from tests.unit.perception.calibration.calibration_cases import synthetic_ensemble

FAST = CalibrationSettings(n_bootstrap=300)
IMAGES = synthetic_ensemble()
NAMES, LABELS, PREDICTIONS = IMAGES.image_ids, IMAGES.labels, IMAGES.predictions


def means_of(images, n_members=None):
    return [stack[:n_members].astype(float).mean(axis=0) for stack in images.predictions]


MEANS = means_of(IMAGES)
OCCUPIED = np.concatenate([label.ravel() > 0 for label in LABELS])


def flat(arrays):
    return np.concatenate([array.ravel() for array in arrays])


@pytest.fixture(scope="module")
def report():
    return evaluate(IMAGES, FAST)


@pytest.mark.parametrize("n_members", [1, 2, 3])
def test_ensembles_are_means_of_the_first_members(report, n_members):
    means = means_of(IMAGES, n_members)
    p, y = flat(means), OCCUPIED
    scores = report.ensembles[n_members - 1].scores
    assert scores.brier == pytest.approx(np.mean((p - y) ** 2), abs=1e-9)
    q = np.clip(np.where(y, p, 1 - p), 1e-7, 1 - 1e-7)
    assert scores.nll == pytest.approx(-np.log(q).mean(), abs=1e-9)
    accuracies = [((mean >= 0.5) == (label > 0)).mean() for mean, label in zip(means, LABELS, strict=True)]
    assert scores.pixel_accuracy == pytest.approx(np.mean(accuracies), abs=1e-9)


def test_members_are_scored_alone_and_sd_is_over_members(report):
    brier = []
    for m in range(3):
        p = flat([stack[m] for stack in PREDICTIONS]).astype(float)
        brier.append(np.mean((p - OCCUPIED) ** 2))
        assert report.members[m].scores.brier == pytest.approx(brier[m], abs=1e-9)
    assert report.member_mean.n == 3
    assert report.member_mean.sd.brier == pytest.approx(np.std(brier, ddof=1))
    assert report.members[0] == report.ensembles[0]


def test_reliability_and_support_count_all_pixels(report):
    p, y = flat(MEANS), OCCUPIED
    uncalibrated = report.uncalibrated
    for result in (uncalibrated, report.calibrated):
        classes = np.add(result.hand.count, result.background.count)
        assert classes.tolist() == list(result.predictor.reliability.count)
        assert sum(classes) == sum(result.safety.count) == report.n_pixels == p.size
    assert report.hand_fraction == pytest.approx(y.mean())
    assert uncalibrated.predictor == report.ensembles[-1]
    for row in uncalibrated.support:
        free = p <= row.delta
        assert row.free_fraction == pytest.approx(free.mean())
        assert (row.occupied_fraction or 0.0) == pytest.approx(y[free].mean() if free.any() else 0.0)


def test_missed_at_delta_is_counted_per_image(report):
    for mean, label, fractions in zip(MEANS, LABELS, report.uncalibrated.missed_at_delta, strict=True):
        hand = [p for p, y in zip(mean.ravel().tolist(), label.ravel(), strict=True) if y]
        for delta, fraction in zip(DELTA_GRID, fractions, strict=True):
            assert fraction == pytest.approx(sum(p <= delta for p in hand) / len(hand), abs=1e-9)


def test_intervals_contain_the_estimate(report):
    for predictor in (*report.members, *report.ensembles):
        for name in ("pixel_accuracy", "miou", "brier", "nll"):
            low, value, high = (getattr(s, name) for s in (predictor.low, predictor.scores, predictor.high))
            assert low < value < high
        curve = predictor.reliability
        for low, value, high in zip(curve.low, curve.observed, curve.high, strict=True):
            assert low <= value <= high


def test_calibrated_scores_are_those_of_the_fitted_temperature(report):
    result = report.calibrated
    assert result.lowest_temperature <= result.temperature <= result.highest_temperature
    assert result.lowest_temperature < result.highest_temperature
    p, y = flat(MEANS), OCCUPIED
    costs = [
        -np.log(np.where(y, q, 1 - q)).mean()
        for q in (apply_temperature(p, t).clip(1e-7, 1 - 1e-7) for t in (result.temperature, 0.97, 1.03))
    ]
    assert costs[0] <= min(costs[1:])
    assert result.predictor.scores.nll == pytest.approx(costs[0], rel=0.1)
    assert result.predictor.scores.nll >= costs[0]  # evaluated on images outside the fit


def test_an_image_is_evaluated_at_a_temperature_fitted_without_it(report):
    # the temperature of image 2 does not depend on its own label
    empty = np.zeros_like(LABELS[2])
    other = evaluate(dataclasses.replace(IMAGES, labels=[*LABELS[:2], empty, *LABELS[3:]]), FAST)
    assert other.calibrated.temperature != report.calibrated.temperature
    rest = [logit_counts(MEANS[i], LABELS[i]) for i in (0, 1, 3, 4, 5)]
    own = fit_temperature(stack_logit_counts(rest))
    for result, label in ((report, LABELS[2]), (other, empty)):
        assert result.calibrated.predictor.images[2] == score_image(apply_temperature(MEANS[2], own), label)


@pytest.mark.parametrize("recalibrate", [True, False])
def test_stored_calibration_is_that_of_the_ensemble_as_it_is_used(recalibrate):
    report = evaluate(IMAGES, dataclasses.replace(FAST, recalibrate=recalibrate, missed_hand_alpha=0.3))
    losses = [missed_fractions(mean, label) for mean, label in zip(MEANS, LABELS, strict=True)]
    uncalibrated_threshold = conformal_threshold(np.array(losses), 0.3)
    mapped = apply_temperature(np.array([uncalibrated_threshold]), report.final.temperature).item()
    assert report.risk_control.threshold == pytest.approx(mapped, rel=1e-12)
    used = report.calibrated if recalibrate else report.uncalibrated
    assert report.final is used
    calibration = report.calibration
    assert (calibration.n_images, calibration.n_calibration_images, calibration.n_members) == (6, 6, 3)
    assert calibration.temperature == (report.calibrated.temperature if recalibrate else 1.0)
    assert (calibration.temperature == 1.0) != recalibrate
    assert calibration.brier == used.predictor.scores.brier == report.figures()["bs"]
    assert calibration.expected_calibration_error == used.predictor.errors.expected
    assert calibration.smallest_supported_delta == used.smallest_supported_delta
    assert calibration.missed_hand_alpha == 0.3
    assert calibration.missed_hand_threshold == report.risk_control.threshold
    missed = [
        np.mean(apply_temperature(mean, calibration.temperature)[label > 0] <= calibration.missed_hand_threshold)
        for mean, label in zip(MEANS, LABELS, strict=True)
    ]
    assert (sum(missed) + 1) / 7 <= 0.3


@pytest.mark.parametrize("recalibrate", [True, False])
def test_margins_are_fitted_at_temperatures_that_the_image_did_not_affect(recalibrate):
    report = evaluate(IMAGES, dataclasses.replace(FAST, recalibrate=recalibrate))
    counts = [logit_counts(mean, label) for mean, label in zip(MEANS, LABELS, strict=True)]
    scores = []
    for i, (mean, label) in enumerate(zip(MEANS, LABELS, strict=True)):
        others = fit_temperature(stack_logit_counts(counts[:i] + counts[i + 1 :])) if recalibrate else 1.0
        scores.append(hausdorff_at_delta(apply_temperature(mean, others), label))
    assert report.final.hausdorff_at_delta == tuple(tuple(row.tolist()) for row in scores)
    assert report.calibration.conformal_margins == ConformalMargins.of_images(np.array(scores))
    assert report.farthest_missed == np.argmax([row[DELTA_GRID.index(0.05)] for row in scores])


def test_figures_have_their_short_names(report):
    figures = report.figures()
    assert {"pa", "miou", "nll", "bs", "ece", "n_members", "smallest_supported_delta", "temperature"} <= set(figures)
    assert figures["nll"] == report.calibrated.predictor.scores.nll
    assert figures["calibration_error_signed"] == report.final.predictor.errors.signed


@pytest.fixture(scope="module")
def calibration_images():
    return synthetic_ensemble(n_images=9, seed=5)


SEPARATE = dataclasses.replace(FAST, missed_hand_alpha=0.3)


@pytest.fixture(scope="module")
def separate(calibration_images):
    """The report with a separate calibration set."""
    return evaluate(IMAGES, SEPARATE, calibration_images)


def test_temperature_is_fitted_on_the_calibration_images(separate, calibration_images):
    assert separate.calibration_image_ids == tuple(calibration_images.image_ids)
    assert (separate.n_calibration_images, separate.calibration.n_images) == (9, 6)
    pairs = zip(means_of(calibration_images), calibration_images.labels, strict=True)
    temperature = fit_temperature(stack_logit_counts([logit_counts(p, y) for p, y in pairs]))
    result = separate.calibrated
    assert (result.temperature, result.lowest_temperature, result.highest_temperature) == (temperature,) * 3
    for mean, label, scores in zip(MEANS, LABELS, result.predictor.images, strict=True):
        assert scores == score_image(apply_temperature(mean, temperature), label)


def test_delta_and_threshold_depend_on_the_calibration_images_alone(separate, calibration_images):
    opposite = dataclasses.replace(IMAGES, predictions=[np.float32(1) - stack for stack in PREDICTIONS])
    other = evaluate(opposite, SEPARATE, calibration_images)
    assert other.calibrated.support == separate.calibrated.support
    assert other.uncalibrated.support == separate.uncalibrated.support
    assert [row.threshold for row in other.risk] == [row.threshold for row in separate.risk]
    assert [row.n_images for row in separate.risk] == [9] * 5
    assert other.calibrated.held_out_delta.occupied_fraction > 0.5


def test_margins_depend_on_the_calibration_images_alone(separate, calibration_images):
    opposite = dataclasses.replace(IMAGES, predictions=[np.float32(1) - stack for stack in PREDICTIONS])
    other = evaluate(opposite, SEPARATE, calibration_images)
    alone = evaluate(calibration_images, SEPARATE)
    for name in ("calibrated", "uncalibrated"):
        margins = [getattr(report, name).margins for report in (other, separate, alone)]
        assert margins[0] == margins[1] == margins[2]
        assert margins[0].n_images == 9
        assert len(getattr(separate, name).hausdorff_at_delta) == 6
    assert other.final.hausdorff_at_delta != separate.final.hausdorff_at_delta
    assert alone.final.calibration_hausdorff_at_delta == ()


def test_delta_and_threshold_are_evaluated_on_the_test_images(separate):
    result, risk = separate.calibrated, separate.risk_control
    probabilities = [apply_temperature(mean, result.temperature) for mean in MEANS]
    missed = [(q[label > 0] <= risk.threshold).mean() for q, label in zip(probabilities, LABELS, strict=True)]
    assert risk.held_out_mean == pytest.approx(np.mean(missed))
    assert risk.held_out_worst == pytest.approx(max(missed))
    held_out, free = result.held_out_delta, flat(probabilities) <= result.smallest_supported_delta
    assert (held_out.n_fits, held_out.lowest) == (1, result.smallest_supported_delta)
    assert held_out.free_fraction == pytest.approx(free.mean())
    assert held_out.occupied_fraction == pytest.approx(OCCUPIED[free].mean())


@pytest.mark.parametrize("n_folds", [0, 2])
def test_without_calibration_images_delta_is_fitted_on_the_other_folds(n_folds):
    report = evaluate(IMAGES, dataclasses.replace(FAST, n_folds=n_folds))
    counts = stack_counts([safety_counts(p, label) for p, label in zip(MEANS, LABELS, strict=True)])
    fold = [i % (n_folds or 6) for i in range(6)]
    parts = [np.array([i for i in range(6) if fold[i] == k]) for k in sorted(set(fold))]
    others = [counts.take(np.array([i for i in range(6) if fold[i] != k])) for k in sorted(set(fold))]
    expected = held_out_support(counts, others, parts, n_bootstrap=300)
    assert report.uncalibrated.held_out_delta == expected
    assert expected.highest > report.uncalibrated.smallest_supported_delta  # fewer images support less


def test_calibration_images_need_predictions_of_the_same_number_of_members():
    fewer = dataclasses.replace(IMAGES, predictions=[stack[:2] for stack in PREDICTIONS])
    with pytest.raises(SettingsError, match=r"image_00: .*\(M, H, W\)"):
        evaluate(IMAGES, FAST, fewer)


def test_order_of_images_changes_no_score(report):
    order = [3, 0, 5, 1, 4, 2]
    shuffled = LabeledPredictions(*([values[i] for i in order] for values in (NAMES, LABELS, PREDICTIONS)))
    other = evaluate(shuffled, FAST)
    for a, b in zip(other.ensembles, report.ensembles, strict=True):
        assert dataclasses.astuple(a.scores) == pytest.approx(dataclasses.astuple(b.scores), rel=1e-12)
        assert a.reliability.count == b.reliability.count
    names = [[r.image_ids[i] for i in r.worst_first] for r in (other, report)]
    assert names[0] == names[1]
    mious = [report.images[i].miou for i in report.worst_first]
    assert mious == sorted(mious)


def test_stored_predictions_give_the_same_report(report, tmp_path):
    by_name = dict(zip(NAMES, PREDICTIONS, strict=True))
    stored = MemberPredictions.write(tmp_path / "p", NAMES, by_name.__getitem__)
    assert evaluate(dataclasses.replace(IMAGES, predictions=stored), FAST) == report


def test_progress_counts_every_step_up_to_the_total(calibration_images):
    for calibration, total in ((None, 12), (calibration_images, 30)):
        steps = []
        evaluate(IMAGES, FAST, calibration, lambda *report, steps=steps: steps.append(report[:2]))
        assert steps == [(done, total) for done in range(1, total + 1)]


def test_a_single_image_and_member_have_all_figures_except_a_temperature():
    report = evaluate(LabeledPredictions(NAMES[:1], LABELS[:1], [PREDICTIONS[0][:1]]), FAST)
    assert report.calibrated is None
    assert report.final is report.uncalibrated
    assert report.uncalibrated.held_out_delta is None
    assert report.calibration.temperature == 1.0
    assert report.member_mean.sd is None
    assert report.ensembles[-1].low == report.ensembles[-1].high == report.ensembles[-1].scores


@pytest.mark.parametrize(
    ("names", "labels", "predictions", "match"),
    [
        ([], [], [], "one label and one prediction"),
        (NAMES[:2], LABELS[:1], PREDICTIONS[:2], "one label and one prediction"),
        (["a", "a"], LABELS[:2], PREDICTIONS[:2], "unique"),
        (NAMES[:2], LABELS[:2], PREDICTIONS[1::-1], "image_00: .*label's resolution"),
        (NAMES[:2], LABELS[:2], [PREDICTIONS[0], PREDICTIONS[1][:2]], r"image_01: .*\(M, H, W\)"),
        (NAMES[:1], [LABELS[0] // 2], PREDICTIONS[:1], "image_00: .*threshold the mask"),
        (NAMES[:1], LABELS[:1], [PREDICTIONS[0] * np.float32(3)], "image_00: .*not logits"),
        (NAMES[:1], LABELS[:1], [PREDICTIONS[0][0]], r"image_00: .*\(M, H, W\)"),
    ],
)
def test_invalid_input_is_refused_by_the_name_of_the_image(names, labels, predictions, match):
    with pytest.raises(SettingsError, match=match):
        evaluate(LabeledPredictions(names, labels, predictions), FAST)


def test_fewer_images_than_folds_are_left_out_one_by_one():
    few = LabeledPredictions(NAMES[:3], LABELS[:3], PREDICTIONS[:3])
    report = evaluate(few, dataclasses.replace(FAST, n_folds=4))
    assert report == evaluate(few, dataclasses.replace(FAST, n_folds=0))
    assert report.settings.n_folds == 0
