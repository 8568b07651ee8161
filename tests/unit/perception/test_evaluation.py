"""The report against figures computed directly from all pixels at once."""

import dataclasses

import numpy as np
import pytest
from calibration_cases import synthetic_ensemble

from deltasafe.errors import SettingsError
from deltasafe.perception.calibration_report import CalibrationSettings
from deltasafe.perception.evaluation import calibrate
from deltasafe.perception.predictions import MemberPredictions
from deltasafe.perception.recalibration import apply_temperature

FAST = CalibrationSettings(n_bootstrap=300)
NAMES, LABELS, PREDICTIONS = synthetic_ensemble()


@pytest.fixture(scope="module")
def report():
    return calibrate(NAMES, LABELS, PREDICTIONS, FAST)


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
    n_pixels = sum(label.size for label in LABELS)
    assert (
        sum(report.ensembles[-1].reliability.count) == sum(report.safety.count) == report.n_pixels == n_pixels == p.size
    )
    assert report.hand_share == pytest.approx(y.mean())
    for row in report.support:
        clear = p <= row.delta
        assert row.clear_share == pytest.approx(clear.mean())
        assert (row.occupied_share or 0.0) == pytest.approx(y[clear].mean() if clear.any() else 0.0)


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
    result = report.recalibration
    assert result.lowest <= result.temperature <= result.highest
    assert result.lowest < result.highest
    p, y = pooled(3)
    costs = [
        -np.log(np.where(y, q, 1 - q)).mean()
        for q in (apply_temperature(p, t).clip(1e-7, 1 - 1e-7) for t in (result.temperature, 0.97, 1.03))
    ]
    assert costs[0] <= min(costs[1:])
    assert result.scores.nll == pytest.approx(costs[0], rel=0.1)
    assert result.scores.nll >= costs[0]  # judged on unseen images


def test_the_calibration_to_store_is_that_of_the_whole_ensemble_as_it_is(report):
    calibration = report.calibration
    assert (calibration.n_images, calibration.n_members, calibration.temperature) == (6, 3, 1.0)
    assert calibration.brier == report.ensembles[-1].scores.brier
    assert calibration.smallest_supported_delta == report.smallest_supported_delta


def test_order_of_images_changes_no_score():
    order = [3, 0, 5, 1, 4, 2]
    shuffled = calibrate(*([list_[i] for i in order] for list_ in (NAMES, LABELS, PREDICTIONS)), FAST)
    straight = calibrate(NAMES, LABELS, PREDICTIONS, FAST)
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
    assert calibrate(NAMES, LABELS, stored, FAST, lambda *args: told.append(args[:2])) == report
    assert told[-1] == (12, 12)
    assert [done for done, _ in told] == list(range(1, 13))


def test_one_image_and_one_member_are_enough_except_for_a_temperature():
    report = calibrate(NAMES[:1], LABELS[:1], [PREDICTIONS[0][:1]], FAST)
    assert report.recalibration is None
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
        calibrate(names, labels, predictions, FAST)


def test_more_folds_than_images_are_refused():
    with pytest.raises(SettingsError, match="n_folds"):
        calibrate(NAMES[:3], LABELS[:3], PREDICTIONS[:3], CalibrationSettings(n_folds=4))
