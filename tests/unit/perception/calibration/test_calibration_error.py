"""Calibration errors: against loops over pixels, and on predictions whose errors are known."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from deltasafe.perception.calibration.calibration_error import (
    calibration_errors,
    equal_mass_bins,
    margin_counts,
)
from deltasafe.perception.calibration.reliability import bootstrap_weights, confidence_counts, stack_counts


def errors(images, n_bootstrap=200, level=0.95):
    confidence = stack_counts([confidence_counts(p, y) for p, y in images])
    margins = stack_counts([margin_counts(p, y) for p, y in images])
    return calibration_errors(confidence, margins, bootstrap_weights(len(images), n_bootstrap, 0), level)


def reference(images):
    """ECE, adaptive ECE and signed error by a loop over pixels."""
    n, equal, fine, mass, signed = 0, [0.0] * 10, [0.0] * 4096, [0] * 4096, 0.0
    width = math.log((1 - 1e-7) / 1e-7) / 4096
    for p_occupied, label in images:
        for p, y in zip(p_occupied.astype(float).ravel().tolist(), label.ravel().tolist(), strict=True):
            confidence = max(p, 1 - p)
            gap = confidence - ((p >= 0.5) == y)
            doubt = max(1 - confidence, 1e-7)
            k = min(int(math.log((1 - doubt) / doubt) / width), 4095)
            equal[max(i for i in range(10) if confidence >= (10 + i) / 20)] += gap
            fine[k] += gap
            mass[k] += 1
            signed += gap
            n += 1
    groups, below = [0.0] * 15, 0
    for gap, count in zip(fine, mass, strict=True):
        groups[min(int((below + count / 2) * 15 / n), 14)] += gap
        below += count
    return sum(map(abs, equal)) / n, sum(map(abs, groups)) / n, signed / n


@given(seed=st.integers(0, 10_000))
def test_errors_agree_with_a_loop_over_pixels(seed):
    rng = np.random.default_rng(seed)
    images = []
    for _ in range(3):
        shape = tuple(rng.integers(2, 14, size=2))
        p_occupied = rng.beta(0.15, 0.15, size=shape).astype(np.float32)
        p_occupied[rng.random(shape) < 0.1] = rng.choice([0.0, 0.5, 1.0])
        images.append((p_occupied, rng.random(shape) < rng.choice([0.1, 0.5, 0.9])))
    result = errors(images)
    np.testing.assert_allclose([result.expected, result.adaptive, result.signed], reference(images), rtol=0, atol=1e-9)
    assert abs(result.signed) <= result.adaptive + 1e-12
    assert abs(result.signed) <= result.expected + 1e-12


def scaled(temperature, n_images=20, seed=0):
    rng = np.random.default_rng(seed)
    for _ in range(n_images):
        logit = rng.normal(-1.0, 3.0, size=(60, 80))
        label = rng.random(logit.shape) < 1 / (1 + np.exp(-logit))
        yield 1 / (1 + np.exp(-temperature * logit)), label


def test_signed_error_separates_overconfident_calibrated_and_under_confident():
    over, under = (errors(list(scaled(t))) for t in (2.0, 0.5))
    right = [errors(list(scaled(1.0, seed=seed))) for seed in range(30)]
    assert over.signed_low > 0.02
    assert under.signed_high < -0.02
    assert sum(result.signed_low < 0.0 < result.signed_high for result in right) >= 24
    for result in right:
        assert max(result.expected, result.adaptive) < 0.008 < min(over.expected, over.adaptive)
    for result in (over, under, *right):
        assert result.signed_low <= result.signed <= result.signed_high


def test_equal_mass_bins_resolve_errors_that_cancel_in_the_last_equal_bin():
    # all pixels are in the last of ten bins; accuracy 0.969 at confidence 0.999, 0.99 at 0.96
    p_occupied = np.concatenate([np.full(1000, 0.001), np.full(1000, 0.04)])[None]
    label = np.zeros((1, 2000), bool)
    label[0, :31] = True
    label[0, 1000:1010] = True
    result = errors([(p_occupied, label)])
    assert result.expected == pytest.approx(abs(0.999 + 0.96 - 0.969 - 0.99) / 2)
    assert result.adaptive == pytest.approx((0.03 + 0.03) / 2)


@given(counts=st.lists(st.integers(0, 50), min_size=1, max_size=60).filter(any), n_bins=st.integers(1, 12))
def test_equal_mass_bins_keep_the_order_and_differ_by_at_most_one_fine_bin(counts, n_bins):
    group = equal_mass_bins(np.array(counts), n_bins)
    assert (np.diff(group) >= 0).all()
    assert 0 <= group.min() <= group.max() < n_bins
    mass = np.bincount(group, weights=counts, minlength=n_bins)
    assert np.abs(mass - sum(counts) / n_bins).max() <= max(counts) + 1e-9


def test_signed_interval_is_the_bootstrap_percentile_over_images():
    images = list(scaled(1.5, n_images=7, seed=2))
    result = errors(images, n_bootstrap=150, level=0.9)
    gaps = [np.sum(np.maximum(p, 1 - p) - ((p >= 0.5) == y)) / y.size for p, y in images]
    drawn = bootstrap_weights(7, 150, 0) @ gaps / 7
    assert [result.signed_low, result.signed_high] == pytest.approx(np.quantile(drawn, [0.05, 0.95]).tolist())
