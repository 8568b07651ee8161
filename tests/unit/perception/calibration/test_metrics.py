"""Scores: against closed forms, a loop over pixels, and invariants."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from deltasafe.errors import SettingsError
from deltasafe.perception.calibration.metrics import (
    Scores,
    bootstrap_scores,
    mean_and_sd,
    pool_scores,
    score_image,
)


def reference(images):
    """PA, mIoU, BS, NLL by their definitions, in a loop over pixels."""
    accuracies, ious, squared, nll = [], [], [], []
    for p_occupied, label in images:
        right, inter, union = 0, [0, 0], [0, 0]
        for p, y in zip(p_occupied.astype(float).ravel().tolist(), label.ravel().tolist(), strict=True):
            predicted = p >= 0.5
            right += predicted == y
            for k in (False, True):
                inter[k] += predicted == k and y == k
                union[k] += k in (predicted, y)
            squared.append((p - y) ** 2)
            nll.append(-math.log(min(max(p if y else 1 - p, 1e-7), 1 - 1e-7)))
        accuracies.append(right / label.size)
        ious.append(sum(i / u if u else 1.0 for i, u in zip(inter, union, strict=True)) / 2)
    return [math.fsum(values) / len(values) for values in (accuracies, ious, squared, nll)]


def random_images(seed, n_images=3):
    rng = np.random.default_rng(seed)
    images = []
    for _ in range(n_images):
        shape = tuple(rng.integers(1, 12, size=2))
        p_occupied = rng.beta(0.4, 0.4, size=shape).astype(np.float32)
        p_occupied[rng.random(shape) < 0.2] = rng.choice([0.0, 0.5, 1.0])
        images.append((p_occupied, rng.random(shape) < rng.choice([0.0, 0.3, 1.0])))
    return images


def scores_of(images):
    return pool_scores([score_image(p, y) for p, y in images])


def as_list(scores):
    return [scores.pixel_accuracy, scores.miou, scores.brier, scores.nll]


@given(seed=st.integers(0, 10_000))
def test_scores_agree_with_a_loop_over_pixels(seed):
    images = random_images(seed)
    np.testing.assert_allclose(as_list(scores_of(images)), reference(images), rtol=0, atol=1e-9)


@given(seed=st.integers(0, 10_000))
def test_scores_do_not_depend_on_the_order_of_images(seed):
    images = random_images(seed, 5)
    np.testing.assert_allclose(as_list(scores_of(images)), as_list(scores_of(images[::-1])), rtol=1e-12)


@given(seed=st.integers(0, 10_000))
def test_perfect_and_inverted_predictions_have_extreme_scores(seed):
    label = np.random.default_rng(seed).random((5, 6)) < 0.5
    assert as_list(scores_of([(label.astype(np.float32), label)])) == pytest.approx([1, 1, 0, 1e-7])
    wrong = scores_of([((~label).astype(np.float32), label)])
    assert as_list(wrong) == pytest.approx([0, 0, 1, -math.log(1e-7)])


def test_scores_of_one_image_in_closed_form():
    p_occupied = np.array([[0.9, 0.2, 0.6, 0.1]])
    label = np.array([[True, True, False, False]])
    scores = score_image(p_occupied, label)
    assert scores.pixel_accuracy == 0.5
    assert scores.miou == pytest.approx(1 / 3)  # both classes: intersection 1, union 3
    assert scores.brier == pytest.approx((0.01 + 0.64 + 0.36 + 0.01) / 4)
    assert scores.nll == pytest.approx(-math.log(0.9 * 0.2 * 0.4 * 0.9) / 4)
    assert (scores.missed_hand_rate, scores.false_alarm_rate) == (0.5, 0.5)


def test_an_exact_half_counts_as_occupied():
    half = np.full((2, 2), 0.5, np.float32)
    assert score_image(half, np.ones((2, 2), bool)).pixel_accuracy == 1.0
    assert score_image(half, np.zeros((2, 2), bool)).pixel_accuracy == 0.0


def test_images_without_hand_or_background_have_no_rate_of_that_class():
    empty = np.zeros((4, 5), bool)
    clean = score_image(np.full((4, 5), 0.1), empty)
    assert (clean.miou, clean.missed_hand_rate, clean.false_alarm_rate) == (1.0, None, 0.0)
    alarm = np.full((4, 5), 0.1)
    alarm[0] = 0.9
    assert score_image(alarm, empty).miou == pytest.approx((0.0 + 0.75) / 2)
    assert score_image(np.full((4, 5), 0.9), ~empty).false_alarm_rate is None


def test_miou_is_a_mean_over_images_and_brier_over_pixels():
    small = score_image(np.array([[1.0]]), np.array([[False]]))
    large = score_image(np.zeros((3, 3)), np.zeros((3, 3), bool))
    scores = pool_scores([small, large])
    assert scores.miou == 0.5
    assert scores.brier == pytest.approx(0.1)
    assert bootstrap_scores([small, large], np.array([[1, 1], [0, 2]]))[:, 2] == pytest.approx([0.1, 0.0])


def test_float32_is_accumulated_in_float64():
    p_occupied = np.full((2000, 2000), 0.1, np.float32)
    exact = float(np.float32(0.1)) ** 2
    assert abs(score_image(p_occupied, np.zeros((2000, 2000), bool)).brier - exact) < 1e-12


def test_sd_is_the_sample_sd_and_none_for_one_member():
    members = [Scores(0.9, 0.8, 0.1, 0.3), Scores(0.7, 0.8, 0.2, 0.1)]
    result = mean_and_sd(members)
    assert result.n == 2
    assert as_list(result.mean) == pytest.approx([0.8, 0.8, 0.15, 0.2])
    assert as_list(result.sd) == pytest.approx([0.1 * math.sqrt(2), 0, 0.05 * math.sqrt(2), 0.1 * math.sqrt(2)])
    assert mean_and_sd(members[:1]).sd is None


def test_masks_of_0_1_and_0_255_are_equivalent():
    p_occupied = np.array([[0.8, 0.3]])
    for high in (1, 255):
        label = np.array([[high, 0]], np.uint8)
        assert score_image(p_occupied, label) == score_image(p_occupied, label > 0)


@pytest.mark.parametrize(
    ("p_occupied", "label", "match"),
    [
        (np.zeros((2, 2)), np.zeros((2, 3), bool), "label's resolution"),
        (np.full((2, 2), 1.5), np.zeros((2, 2), bool), r"\[0, 1\]"),
        (np.array([[0.1, np.nan]]), np.zeros((1, 2), bool), r"\[0, 1\]"),
        (np.zeros((2, 2), np.uint8), np.zeros((2, 2), bool), "floating"),
        (np.zeros((2, 2)), np.full((2, 2), 127, np.uint8), "threshold the mask"),
        (np.zeros((1, 2)), np.array([[1, 255]], np.uint8), "threshold the mask"),
        (np.zeros((0, 2)), np.zeros((0, 2), bool), r"\(H, W\)"),
    ],
)
def test_invalid_predictions_and_labels_are_refused(p_occupied, label, match):
    with pytest.raises(SettingsError, match=match):
        score_image(p_occupied, label)


def test_empty_sets_of_images_and_members_are_refused():
    with pytest.raises(SettingsError, match="at least one image"):
        pool_scores([])
    with pytest.raises(SettingsError, match="at least one member"):
        mean_and_sd([])
