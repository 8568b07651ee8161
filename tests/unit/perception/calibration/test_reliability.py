"""Reliability: against a loop over pixels, and for a predictor that is calibrated by construction."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from deltasafe.errors import SettingsError
from deltasafe.perception.calibration.reliability import (
    CONFIDENCE_EDGES,
    DELTA_GRID,
    bootstrap_weights,
    class_counts,
    confidence_counts,
    reliability_curve,
    safety_counts,
    stack_counts,
)


def calibrated_images(n_images=20, seed=0):
    rng = np.random.default_rng(seed)
    for _ in range(n_images):
        p_occupied = rng.random((60, 80)) ** rng.choice([1, 3])
        yield p_occupied, rng.random((60, 80)) < p_occupied


def test_there_are_ten_equal_bins_and_the_last_is_closed():
    edges = np.array(CONFIDENCE_EDGES)
    np.testing.assert_allclose(np.diff(edges), 0.05)
    assert (edges[0], edges[-1], len(edges)) == (0.5, 1.0, 11)
    # each bin contains its lower edge, and the last one contains 1.0
    counts = confidence_counts(edges[None].copy(), np.ones((1, 11), bool))
    assert counts.count[0].tolist() == [1] * 9 + [2]


def test_an_exact_half_is_predicted_occupied():
    half = np.array([[0.5, 0.5, 0.5]])
    counts = confidence_counts(half, np.array([[True, True, False]]))
    assert (counts.count[0, 0], counts.event[0, 0]) == (3, 2)


@given(seed=st.integers(0, 10_000))
def test_confidence_and_class_counts_agree_with_a_loop_over_pixels(seed):
    rng = np.random.default_rng(seed)
    p_occupied = rng.beta(0.5, 0.5, size=(6, 7)).astype(np.float32)
    label = rng.random((6, 7)) < 0.5
    count, correct, total = [0] * 10, [0] * 10, [0.0] * 10
    for p, y in zip(p_occupied.astype(float).ravel(), label.ravel(), strict=True):
        confidence = max(p, 1 - p)
        k = max(i for i in range(10) if confidence >= CONFIDENCE_EDGES[i])
        count[k] += 1
        correct[k] += (p >= 0.5) == y
        total[k] += confidence
    counts = confidence_counts(p_occupied, label)
    assert counts.count[0].tolist() == count
    assert counts.event[0].tolist() == correct
    np.testing.assert_allclose(counts.p_sum[0], total, atol=1e-9)
    hand, background = class_counts(p_occupied, label)
    count, correct = [[0] * 10, [0] * 10], [[0] * 10, [0] * 10]
    for p, y in zip(p_occupied.astype(float).ravel(), label.ravel(), strict=True):
        predicted = int(p >= 0.5)
        k = max(i for i in range(10) if max(p, 1 - p) >= CONFIDENCE_EDGES[i])
        count[predicted][k] += 1
        correct[predicted][k] += predicted == y
    assert [background.count[0].tolist(), hand.count[0].tolist()] == count
    assert [background.event[0].tolist(), hand.event[0].tolist()] == correct
    np.testing.assert_allclose(hand.p_sum + background.p_sum, counts.p_sum, atol=1e-9)


@given(seed=st.integers(0, 10_000))
def test_safety_counts_sum_to_the_free_pixels_of_each_delta(seed):
    rng = np.random.default_rng(seed)
    p_occupied = 10.0 ** rng.uniform(-6, 0, size=(6, 7))
    p_occupied.flat[: len(DELTA_GRID)] = DELTA_GRID  # a pixel at delta is free
    label = rng.random((6, 7)) < 0.3
    counts = safety_counts(p_occupied, label)
    for k, delta in enumerate(DELTA_GRID):
        free = p_occupied <= delta
        assert counts.count[0, : k + 1].sum() == free.sum()
        assert counts.event[0, : k + 1].sum() == (free & label).sum()
    assert counts.count.sum() == label.size


@pytest.mark.parametrize("count_bins", [confidence_counts, safety_counts])
def test_calibrated_predictor_lies_on_the_diagonal_within_binomial_error(count_bins):
    result = reliability_curve(stack_counts([count_bins(p, y) for p, y in calibrated_images()]))
    for count, predicted, observed in zip(result.count, result.predicted, result.observed, strict=True):
        if count:
            sd = np.sqrt(predicted * (1 - predicted) / count)
            assert abs(observed - predicted) <= 4.5 * sd + 1e-3 / count**0.5 + 8 / count


def test_overconfident_predictor_lies_below_the_diagonal():
    def sharpen(p):
        return p**3 / (p**3 + (1 - p) ** 3)

    counts = stack_counts([confidence_counts(sharpen(p), y) for p, y in calibrated_images()])
    result = reliability_curve(counts)
    assert (np.array(result.observed) < np.array(result.predicted))[1:9].all()


def test_class_counts_reveal_a_miscalibration_that_the_pool_hides():
    rng = np.random.default_rng(0)
    hand = rng.random((200, 200)) < 0.5
    p_occupied = np.where(hand, 0.8, 0.2)
    label = np.where(hand, rng.random(hand.shape) < 0.7, rng.random(hand.shape) < 0.1)
    pooled = reliability_curve(confidence_counts(p_occupied, label))
    by_class = [reliability_curve(counts) for counts in class_counts(p_occupied, label)]
    assert pooled.observed[6] == pytest.approx(0.8, abs=0.01)
    assert [c.observed[6] for c in by_class] == pytest.approx([0.7, 0.9], abs=0.01)
    assert [c.predicted[6] for c in by_class] == pytest.approx([0.8, 0.8])


def test_intervals_contain_the_estimate_and_shrink_with_more_images():
    def width(n_images):
        counts = stack_counts([confidence_counts(p, y) for p, y in calibrated_images(n_images)])
        result = reliability_curve(counts, bootstrap_weights(n_images, 500, seed=1))
        for low, observed, high in zip(result.low, result.observed, result.high, strict=True):
            assert low <= observed <= high
        return np.mean(np.subtract(result.high, result.low))

    assert width(40) < 0.7 * width(8)


def test_intervals_reflect_images_not_pixels():
    rng = np.random.default_rng(0)
    p_occupied = np.full((100, 100), 0.8)
    labels = [np.full((100, 100), rng.random() < 0.8) for _ in range(30)]  # all pixels of an image agree
    counts = stack_counts([confidence_counts(p_occupied, label) for label in labels])
    result = reliability_curve(counts, bootstrap_weights(30, 1000, seed=0))
    assert result.high[6] - result.low[6] > 0.15  # 300,000 independent pixels would give 0.003


def test_empty_bins_are_none():
    counts = confidence_counts(np.ones((3, 3)), np.ones((3, 3), bool))
    result = reliability_curve(counts, bootstrap_weights(1, 100, seed=0))
    assert result.observed == (*[None] * 9, 1.0)
    assert result.low == (*[None] * 9, 1.0)
    assert result.count == (*[0] * 9, 9)


def test_bootstrap_weights_sum_to_the_number_of_images_and_repeat_with_the_seed():
    weights = bootstrap_weights(7, 200, seed=5)
    assert (weights.sum(axis=1) == 7).all()
    np.testing.assert_array_equal(weights, bootstrap_weights(7, 200, seed=5))
    assert not np.array_equal(weights, bootstrap_weights(7, 200, seed=6))


def test_stacking_no_images_is_refused():
    with pytest.raises(SettingsError, match="at least one image"):
        stack_counts([])
