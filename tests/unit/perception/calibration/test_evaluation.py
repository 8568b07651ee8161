"""The report against figures computed directly from all pixels at once."""

import dataclasses

import numpy as np
import pytest

from deltasafe.errors import SettingsError
from deltasafe.perception.calibration.conformal_risk import conformal_threshold, missed_hand_shares
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
NAMES, LABELS, PREDICTIONS = synthetic_ensemble()


@pytest.fixture(scope="module")
def report():
    return evaluate(NAMES, LABELS, PREDICTIONS, FAST)


def pooled(n_members):
    p = np.concatenate([stack[:n_members].astype(float).mean(axis=0).ravel() for stack in PREDICTIONS])
    return p, np.concatenate([label.ravel() > 0 for label in LABELS])


@pytest.mark.parametrize("n_members", [1, 2, 3])
def test_ensembles_are_means_of_the_first_members(report, n_members):
    p, y = pooled(n_members)
    scores = report.ensembles[n_members - 1].scores
    assert scores.brier == pytest.approx(np.mean((p - y) ** 2), abs=1e-9)
    q = np.clip(np.where(y, p, 1 - p), 1e-7, 1 - 1e-7)
    assert scores.nll == pytest.approx(-np.log(q).mean(), abs=1e-9)
    accuracies = [
        ((stack[:n_members].astype(float).mean(axis=0) >= 0.5) == (label > 0)).mean()
        for stack, label in zip(PREDICTIONS, LABELS, strict=True)
    ]
    assert scores.pixel_accuracy == pytest.approx(np.mean(accuracies), abs=1e-9)


def test_members_are_judged_alone_and_their_deviation_is_over_members(report):
    y = np.concatenate([label.ravel() > 0 for label in LABELS])
    brier = []
    for m in range(3):
        p = np.concatenate([stack[m].ravel() for stack in PREDICTIONS]).astype(float)
        brier.append(np.mean((p - y) ** 2))
        assert report.members[m].scores.brier == pytest.approx(brier[m], abs=1e-9)
    assert report.member_mean.n == 3
    assert report.member_mean.sd.brier == pytest.approx(np.std(brier, ddof=1))
    assert report.members[0] == report.ensembles[0]


def test_reliability_and_support_count_all_pixels(report):
    p, y = pooled(3)
    raw = report.as_it_is
    n_pixels = sum(label.size for label in LABELS)
    for judgment in (raw, report.recalibrated):
        classes = np.add(judgment.hand.count, judgment.background.count)
        assert classes.tolist() == list(judgment.predictor.reliability.count)
        assert sum(classes) == sum(judgment.safety.count) == report.n_pixels == n_pixels == p.size
    assert report.hand_share == pytest.approx(y.mean())
    assert raw.predictor == report.ensembles[-1]
    for row in raw.support:
        clear = p <= row.delta
        assert row.clear_share == pytest.approx(clear.mean())
        assert (row.occupied_share or 0.0) == pytest.approx(y[clear].mean() if clear.any() else 0.0)


def test_shares_taken_for_free_are_counted_image_by_image(report):
    for stack, label, shares in zip(PREDICTIONS, LABELS, report.as_it_is.taken_for_free, strict=True):
        hand = [p for p, y in zip(stack.astype(float).mean(axis=0).ravel().tolist(), label.ravel(), strict=True) if y]
        for delta, share in zip(DELTA_GRID, shares, strict=True):
            assert share == pytest.approx(sum(p <= delta for p in hand) / len(hand), abs=1e-9)


def test_intervals_contain_the_estimate(report):
    for predictor in (*report.members, *report.ensembles):
        for name in ("pixel_accuracy", "miou", "brier", "nll"):
            low, value, high = (getattr(s, name) for s in (predictor.low, predictor.scores, predictor.high))
            assert low < value < high
        for low, value, high in zip(
            predictor.reliability.low, predictor.reliability.observed, predictor.reliability.high, strict=True
        ):
            assert low <= value <= high


def test_recalibrated_scores_are_those_of_the_stated_temperature(report):
    result = report.recalibrated
    assert result.lowest <= result.temperature <= result.highest
    assert result.lowest < result.highest
    p, y = pooled(3)
    costs = [
        -np.log(np.where(y, q, 1 - q)).mean()
        for q in (apply_temperature(p, t).clip(1e-7, 1 - 1e-7) for t in (result.temperature, 0.97, 1.03))
    ]
    assert costs[0] <= min(costs[1:])
    assert result.predictor.scores.nll == pytest.approx(costs[0], rel=0.1)
    assert result.predictor.scores.nll >= costs[0]  # judged on unseen images


def refitted(**changed):
    """The report with image 2 replaced by one with other predictions, or another label."""
    lists = {"labels": list(LABELS), "predictions": list(PREDICTIONS)}
    for name, value in changed.items():
        lists[name][2] = value
    return evaluate(NAMES, lists["labels"], lists["predictions"], FAST)


def test_an_image_is_judged_by_nothing_that_was_fitted_on_it(report):
    # the label of image 2 decides nothing about its own probabilities: they are those of the others' temperature
    other = refitted(labels=np.zeros_like(LABELS[2]))
    assert other.recalibrated.temperature != report.recalibrated.temperature
    p_mean = PREDICTIONS[2].astype(float).mean(axis=0)
    own = fit_temperature(
        stack_logit_counts(
            [
                logit_counts(stack.astype(float).mean(axis=0), label)
                for i, (stack, label) in enumerate(zip(PREDICTIONS, LABELS, strict=True))
                if i != 2
            ]
        )
    )
    for result, label in ((report, LABELS[2]), (other, np.zeros_like(LABELS[2]))):
        assert result.recalibrated.predictor.images[2] == score_image(apply_temperature(p_mean, own), label)


@pytest.mark.parametrize("recalibrate", [True, False])
def test_the_calibration_to_store_is_that_of_the_ensemble_as_it_is_used(recalibrate):
    settings = dataclasses.replace(FAST, recalibrate=recalibrate, missed_hand_alpha=0.3)
    report = evaluate(NAMES, LABELS, PREDICTIONS, settings)
    shares = [
        missed_hand_shares(stack.astype(float).mean(axis=0), label)
        for stack, label in zip(PREDICTIONS, LABELS, strict=True)
    ]
    plain = conformal_threshold(np.array(shares), 0.3)
    carried = apply_temperature(np.array([plain]), report.final.temperature).item()
    assert report.risk_control.threshold == pytest.approx(carried, rel=1e-12)
    used = report.recalibrated if recalibrate else report.as_it_is
    assert report.final is used
    calibration = report.calibration
    assert (calibration.n_images, calibration.n_calibration_images, calibration.n_members) == (6, 6, 3)
    assert calibration.temperature == (report.recalibrated.temperature if recalibrate else 1.0)
    assert (calibration.temperature == 1.0) != recalibrate
    assert calibration.brier == used.predictor.scores.brier == report.figures()["bs"]
    assert calibration.expected_calibration_error == used.predictor.errors.expected
    assert calibration.smallest_supported_delta == used.smallest_supported_delta
    assert calibration.missed_hand_alpha == 0.3
    assert calibration.missed_hand_threshold == report.risk_control.threshold
    shares = [
        np.mean((apply_temperature(stack.astype(float).mean(axis=0), calibration.temperature))[label > 0]
                <= calibration.missed_hand_threshold)
        for stack, label in zip(PREDICTIONS, LABELS, strict=True)
    ]  # fmt: skip
    assert (sum(shares) + 1) / 7 <= 0.3


def test_figures_of_the_whole_ensemble_keep_their_names(report):
    figures = report.figures()
    assert {"pa", "miou", "nll", "bs", "ece", "n_members", "smallest_supported_delta", "temperature"} <= set(figures)
    assert figures["nll"] == report.recalibrated.predictor.scores.nll
    assert figures["calibration_error_signed"] == report.final.predictor.errors.signed


def test_calibration_images_are_kept_apart():
    names, labels, predictions = synthetic_ensemble(n_images=9, seed=5)
    further = LabeledPredictions(names, labels, predictions)
    settings = dataclasses.replace(FAST, missed_hand_alpha=0.3)
    told = []
    report = evaluate(NAMES, LABELS, PREDICTIONS, settings, lambda *args: told.append(args[:2]), further)
    assert (told[-1], len(told)) == ((30, 30), 21)
    assert report.calibration_image_ids == tuple(names)
    assert (report.n_calibration_images, report.calibration.n_images) == (9, 6)
    means = [stack.astype(float).mean(axis=0) for stack in predictions]
    counts = stack_logit_counts([logit_counts(p, y) for p, y in zip(means, labels, strict=True)])
    temperature = fit_temperature(counts)
    result = report.recalibrated
    assert (result.temperature, result.lowest, result.highest) == (temperature, temperature, temperature)
    for stack, label, scores in zip(PREDICTIONS, LABELS, result.predictor.images, strict=True):
        assert scores == score_image(apply_temperature(stack.astype(float).mean(axis=0), temperature), label)
    # delta and threshold come from the further images alone, whatever the test images are
    opposite = [np.float32(1) - stack for stack in PREDICTIONS]
    other = evaluate(NAMES, LABELS, opposite, settings, calibration=further)
    assert other.recalibrated.support == result.support
    assert other.as_it_is.support == report.as_it_is.support
    assert [row.threshold for row in other.risk] == [row.threshold for row in report.risk]
    assert [row.n_images for row in report.risk] == [9] * 5
    # and are judged on the test images
    below = [
        (apply_temperature(stack.astype(float).mean(axis=0), temperature)[label > 0] <= report.risk_control.threshold)
        for stack, label in zip(PREDICTIONS, LABELS, strict=True)
    ]
    assert report.risk_control.held_out_mean == pytest.approx(np.mean([share.mean() for share in below]))
    assert report.risk_control.held_out_worst == pytest.approx(max(share.mean() for share in below))
    held_out = result.held_out_delta
    assert (held_out.n_fits, held_out.lowest) == (1, result.smallest_supported_delta)
    q = np.concatenate(
        [apply_temperature(stack.astype(float).mean(axis=0), temperature).ravel() for stack in PREDICTIONS]
    )
    y = np.concatenate([label.ravel() > 0 for label in LABELS])
    assert held_out.clear_share == pytest.approx((q <= held_out.lowest).mean())
    assert held_out.occupied_share == pytest.approx(y[q <= held_out.lowest].mean())
    assert other.recalibrated.held_out_delta.occupied_share > 0.5


@pytest.mark.parametrize("n_folds", [0, 2])
def test_without_them_delta_is_fitted_on_the_other_folds(n_folds):
    report = evaluate(NAMES, LABELS, PREDICTIONS, dataclasses.replace(FAST, n_folds=n_folds))
    means = [stack.astype(float).mean(axis=0) for stack in PREDICTIONS]
    counts = stack_counts([safety_counts(p, label) for p, label in zip(means, LABELS, strict=True)])
    fold = [i % (n_folds or 6) for i in range(6)]
    parts = [np.array([i for i in range(6) if fold[i] == k]) for k in sorted(set(fold))]
    others = [counts.take(np.array([i for i in range(6) if fold[i] != k])) for k in sorted(set(fold))]
    expected = held_out_support(counts, others, parts, n_bootstrap=300)
    assert report.as_it_is.held_out_delta == expected
    assert expected.highest > report.as_it_is.smallest_supported_delta  # fewer images support less


def test_members_of_calibration_images_must_be_the_same():
    further = LabeledPredictions(NAMES, LABELS, [stack[:2] for stack in PREDICTIONS])
    with pytest.raises(SettingsError, match=r"image_00: .*\(M, H, W\)"):
        evaluate(NAMES, LABELS, PREDICTIONS, FAST, calibration=further)


def test_order_of_images_changes_no_score():
    order = [3, 0, 5, 1, 4, 2]
    shuffled = evaluate(*([list_[i] for i in order] for list_ in (NAMES, LABELS, PREDICTIONS)), FAST)
    straight = evaluate(NAMES, LABELS, PREDICTIONS, FAST)
    for a, b in zip(shuffled.ensembles, straight.ensembles, strict=True):
        assert dataclasses.astuple(a.scores) == pytest.approx(dataclasses.astuple(b.scores), rel=1e-12)
        assert a.reliability.count == b.reliability.count
    names = [[r.image_ids[i] for i in r.worst_first] for r in (shuffled, straight)]
    assert names[0] == names[1]
    mious = [straight.images[i].miou for i in straight.worst_first]
    assert mious == sorted(mious)


def test_same_result_from_disk(report, tmp_path):
    by_name = dict(zip(NAMES, PREDICTIONS, strict=True))
    stored = MemberPredictions.write(tmp_path / "p", NAMES, by_name.__getitem__)
    told = []
    assert evaluate(NAMES, LABELS, stored, FAST, lambda *args: told.append(args[:2])) == report
    assert told[-1] == (12, 12)
    assert [done for done, _ in told] == list(range(1, 13))


def test_one_image_and_one_member_are_enough_except_for_a_temperature():
    report = evaluate(NAMES[:1], LABELS[:1], [PREDICTIONS[0][:1]], FAST)
    assert report.recalibrated is None
    assert report.final is report.as_it_is
    assert report.as_it_is.held_out_delta is None
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
def test_bad_input_names_the_image(names, labels, predictions, match):
    with pytest.raises(SettingsError, match=match):
        evaluate(names, labels, predictions, FAST)


def test_more_folds_than_images_are_refused():
    with pytest.raises(SettingsError, match="n_folds"):
        evaluate(NAMES[:3], LABELS[:3], PREDICTIONS[:3], CalibrationSettings(n_folds=4))
