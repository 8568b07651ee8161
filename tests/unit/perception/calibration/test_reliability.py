"""Reliability against a pixel-by-pixel reference, and a predictor that is calibrated by construction."""

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
    curve,
    safety_counts,
    stack_counts,
)


def calibrated_images(n_images=20, seed=0):
    rng = np.random.default_rng(seed)
    for _ in range(n_images):
        p_occupied = rng.random((60, 80)) ** rng.choice([1, 3])
        yield p_occupied, rng.random((60, 80)) < p_occupied


def test_ten_equal_bins_whose_last_one_is_closed():
    edges = np.array(CONFIDENCE_EDGES)
    np.testing.assert_allclose(np.diff(edges), 0.05)
    assert (edges[0], edges[-1], len(edges)) == (0.5, 1.0, 11)
    # the lower edge of every bin belongs to it, and 1.0 belongs to the last
    counts = confidence_counts(edges[None].copy(), np.ones((1, 11), bool))
    assert counts.count[0].tolist() == [1] * 9 + [2]


def test_an_exact_half_is_predicted_occupied():
    half = np.array([[0.5, 0.5, 0.5]])
    counts = confidence_counts(half, np.array([[True, True, False]]))
    assert (counts.count[0, 0], counts.event[0, 0]) == (3, 2)


@given(seed=st.integers(0, 10_000))
def test_confidence_counts_agree_with_a_reference(seed):
    rng = np.random.default_rng(seed)
    p_occupied = rng.beta(0.5, 0.5, size=(6, 7)).astype(np.float32)
    label = rng.random((6, 7)) < 0.5
    count, right, total = [0] * 10, [0] * 10, [0.0] * 10
    for p, y in zip(p_occupied.astype(float).ravel(), label.ravel(), strict=True):
        confidence = max(p, 1 - p)
        k = max(i for i in range(10) if confidence >= CONFIDENCE_EDGES[i])
        count[k] += 1
        right[k] += (p >= 0.5) == y
        total[k] += confidence
    counts = confidence_counts(p_occupied, label)
    assert counts.count[0].tolist() == count
    assert counts.event[0].tolist() == right
    np.testing.assert_allclose(counts.p_sum[0], total, atol=1e-9)
    hand, background = class_counts(p_occupied, label)
    count, right = [[0] * 10, [0] * 10], [[0] * 10, [0] * 10]
    for p, y in zip(p_occupied.astype(float).ravel(), label.ravel(), strict=True):
        predicted = int(p >= 0.5)
        k = max(i for i in range(10) if max(p, 1 - p) >= CONFIDENCE_EDGES[i])
        count[predicted][k] += 1
        right[predicted][k] += predicted == y
    assert [background.count[0].tolist(), hand.count[0].tolist()] == count
    assert [background.event[0].tolist(), hand.event[0].tolist()] == right
    np.testing.assert_allclose(hand.p_sum + background.p_sum, counts.p_sum, atol=1e-9)


@given(seed=st.integers(0, 10_000))
def test_safety_counts_sum_up_to_the_pixels_that_count_as_free(seed):
    rng = np.random.default_rng(seed)
    p_occupied = 10.0 ** rng.uniform(-6, 0, size=(6, 7))
    p_occupied.flat[: len(DELTA_GRID)] = DELTA_GRID  # a pixel at delta counts as free
    label = rng.random((6, 7)) < 0.3
    counts = safety_counts(p_occupied, label)
    for k, delta in enumerate(DELTA_GRID):
        clear = p_occupied <= delta
        assert counts.count[0, : k + 1].sum() == clear.sum()
        assert counts.event[0, : k + 1].sum() == (clear & label).sum()
    assert counts.count.sum() == label.size


@pytest.mark.parametrize("count_bins", [confidence_counts, safety_counts])
def test_a_calibrated_predictor_lies_on_the_diagonal_within_binomial_error(count_bins):
    result = curve(stack_counts([count_bins(p, y) for p, y in calibrated_images()]))
    for count, stated, observed in zip(result.count, result.stated, result.observed, strict=True):
        if count:
            assert (
                abs(observed - stated) <= 4.5 * np.sqrt(stated * (1 - stated) / count) + 1e-3 / count**0.5 + 8 / count
            )


def test_an_overconfident_predictor_lies_below_the_diagonal():
    def sharpen(p):
        return p**3 / (p**3 + (1 - p) ** 3)

    counts = stack_counts([confidence_counts(sharpen(p), y) for p, y in calibrated_images()])
    result = curve(counts)
    assert (np.array(result.observed) < np.array(result.stated))[1:9].all()


def test_a_class_that_is_surer_than_right_is_seen_though_the_pool_is_calibrated():
    rng = np.random.default_rng(0)
    hand = rng.random((200, 200)) < 0.5
    p_occupied = np.where(hand, 0.8, 0.2)
    label = np.where(hand, rng.random(hand.shape) < 0.7, rng.random(hand.shape) < 0.1)
    pooled = curve(confidence_counts(p_occupied, label))
    seen = [curve(counts) for counts in class_counts(p_occupied, label)]
    assert pooled.observed[6] == pytest.approx(0.8, abs=0.01)
    assert [c.observed[6] for c in seen] == pytest.approx([0.7, 0.9], abs=0.01)
    assert [c.stated[6] for c in seen] == pytest.approx([0.8, 0.8])


def test_intervals_contain_the_estimate_and_shrink_with_the_number_of_images():
    def width(n_images):
        counts = stack_counts([confidence_counts(p, y) for p, y in calibrated_images(n_images)])
        result = curve(counts, bootstrap_weights(n_images, 500, seed=1))
        for low, observed, high in zip(result.low, result.observed, result.high, strict=True):
            assert low <= observed <= high
        return np.mean(np.subtract(result.high, result.low))

    assert width(40) < 0.7 * width(8)


def test_intervals_come_from_images_not_from_pixels():
    rng = np.random.default_rng(0)
    p_occupied = np.full((100, 100), 0.8)
    labels = [np.full((100, 100), rng.random() < 0.8) for _ in range(30)]  # all pixels of an image agree
    counts = stack_counts([confidence_counts(p_occupied, label) for label in labels])
    result = curve(counts, bootstrap_weights(30, 1000, seed=0))
    assert result.high[6] - result.low[6] > 0.15  # 300,000 independent pixels would give 0.003


def test_empty_bins_are_none():
    counts = confidence_counts(np.ones((3, 3)), np.ones((3, 3), bool))
    result = curve(counts, bootstrap_weights(1, 100, seed=0))
    assert result.observed == (*[None] * 9, 1.0)
    assert result.low == (*[None] * 9, 1.0)
    assert result.count == (*[0] * 9, 9)


def test_bootstrap_weights_draw_as_many_images_as_there_are_and_repeat_with_the_seed():
    weights = bootstrap_weights(7, 200, seed=5)
    assert (weights.sum(axis=1) == 7).all()
    np.testing.assert_array_equal(weights, bootstrap_weights(7, 200, seed=5))
    assert not np.array_equal(weights, bootstrap_weights(7, 200, seed=6))


def test_no_image_is_refused():
    with pytest.raises(SettingsError, match="at least one image"):
        stack_counts([])
