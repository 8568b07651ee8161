"""Conformal risk control: golden values, an exhaustive search, and the guarantee by simulation."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from deltasafe.errors import SettingsError
from deltasafe.perception.calibration.conformal_risk import (
    THRESHOLD_GRID,
    conformal_threshold,
    control_risk,
    leave_one_out_loss,
    missed_fractions,
)
from deltasafe.perception.calibration.temperature import apply_temperature


def losses_of_images(images):
    return np.array([missed_fractions(p, y) for p, y in images])


def image_at(levels):
    """An image of one hand pixel per level."""
    p_occupied = np.array([levels], dtype=np.float64)
    return p_occupied, np.ones(p_occupied.shape, bool)


def at(value):
    """Index of the smallest threshold at which a pixel of this p_occupied is missed."""
    return next(k for k, threshold in enumerate(THRESHOLD_GRID) if value <= threshold)


def random_images(seed, n_images):
    rng = np.random.default_rng(seed)
    for _ in range(n_images):
        shape = tuple(rng.integers(2, 7, size=2))
        label = rng.random(shape) < 0.6
        label.flat[0] = True
        yield rng.beta(0.4, 0.2 + rng.random(), size=shape).astype(np.float32), label


@given(seed=st.integers(0, 10_000))
def test_missed_fractions_agree_with_a_loop_over_pixels(seed):
    for p_occupied, label in random_images(seed, 2):
        result = missed_fractions(p_occupied, label)
        hand = [float(p) for p, y in zip(p_occupied.ravel(), label.ravel(), strict=True) if y]
        for k in (0, 5, 700, 1599, 1600, 1601, 2500, 3200):
            assert result[k] == pytest.approx(sum(p <= THRESHOLD_GRID[k] for p in hand) / len(hand), abs=1e-9)
        assert (np.diff(result) >= 0).all()


@given(seed=st.integers(0, 10_000), n_images=st.integers(1, 40), alpha=st.floats(0.01, 0.9))
def test_threshold_agrees_with_an_exhaustive_search(seed, n_images, alpha):
    losses = losses_of_images(random_images(seed, n_images))
    rows = losses.tolist()

    def risk(k):
        mean = sum(row[k] for row in rows) / n_images
        return n_images / (n_images + 1) * mean + 1 / (n_images + 1)

    threshold = conformal_threshold(losses, alpha)
    if threshold is None:
        assert risk(0) > alpha - 1e-12
    else:
        k = THRESHOLD_GRID.tolist().index(threshold)
        assert risk(k) <= alpha + 1e-12
        assert k == len(THRESHOLD_GRID) - 1 or risk(k + 1) > alpha - 1e-12


def test_a_pixel_at_the_threshold_counts_as_free():
    for k in (0, 1234, 3200):
        result = missed_fractions(*image_at([THRESHOLD_GRID[k]]))
        assert result[k] == 1.0
        assert (result[:k] == 0.0).all()


def test_thresholds_of_ten_images_are_the_golden_values():
    # ten images of ten hand pixels; image i has i pixels at 0.1, the others at 0.9
    losses = losses_of_images(image_at([0.1] * i + [0.9] * (10 - i)) for i in range(10))
    # from 0.1 on the mean loss is 0.45: (10 * 0.45 + 1) / 11 = 0.5
    assert conformal_threshold(losses, 0.4999) == THRESHOLD_GRID[at(0.1) - 1]
    assert conformal_threshold(losses, 0.5) == THRESHOLD_GRID[at(0.9) - 1]
    # below 0.1 nothing is missed, but an eleventh image may be missed completely: 1 / 11
    assert conformal_threshold(losses, 1 / 11 + 1e-12) == THRESHOLD_GRID[at(0.1) - 1]
    assert conformal_threshold(losses, 1 / 11 - 1e-12) is None
    # at the end of the grid everything is missed: (10 + 1) / 11
    assert conformal_threshold(losses, 0.9999) == THRESHOLD_GRID[at(0.9) - 1]


def test_fifty_perfect_images_certify_two_percent_but_not_1_96():
    losses = losses_of_images([image_at([0.999])] * 50)
    assert conformal_threshold(losses, 0.0196) is None
    assert conformal_threshold(losses, 0.02) == THRESHOLD_GRID[at(0.999) - 1]
    missed = np.zeros((50, len(THRESHOLD_GRID)))
    missed[:, :] = 0.031  # alpha = 0.05 needs a mean loss of at most 3.1 %
    assert conformal_threshold(missed, 0.05) == THRESHOLD_GRID[-1]
    assert conformal_threshold(missed + 0.0001, 0.05) is None


@pytest.mark.parametrize("alpha", [0.1, 0.2, 0.4])
def test_expected_loss_of_a_further_image_is_at_most_alpha(alpha):
    """Fit on 15 images of heavy-tailed difficulty and evaluate on the 16th, 3000 times."""
    rng = np.random.default_rng(11)
    n, repetitions = 15, 3000
    grid_logit = np.log(THRESHOLD_GRID) - np.log1p(-THRESHOLD_GRID)
    coarse = np.arange(0, len(THRESHOLD_GRID), 40)

    def losses_of(n_images):
        difficulty = rng.exponential(1.5, size=(n_images, 1, 1))
        logit = rng.normal(3.0 - difficulty, 1.0, size=(n_images, 12, 1))
        return (logit <= grid_logit[coarse]).mean(axis=1)

    held_out = []
    for _ in range(repetitions):
        losses = losses_of(n + 1)
        allowed = [k for k in range(len(coarse)) if (losses[:n, k].sum() + 1) / (n + 1) <= alpha]
        full = np.repeat(losses[:n], 40, axis=1)[:, : len(THRESHOLD_GRID)]
        threshold = conformal_threshold(full, alpha)
        k = allowed[-1]
        assert threshold == THRESHOLD_GRID[min(40 * k + 39, len(THRESHOLD_GRID) - 1)]
        held_out.append(losses[n, k])
    mean, error = np.mean(held_out), np.std(held_out) / np.sqrt(repetitions)
    assert mean <= alpha + 3 * error
    assert mean >= alpha - 2 / (n + 1) - 3 * error  # the lower bound of the theorem


def test_uncorrected_empirical_threshold_violates_the_guarantee():
    """Without the term 1 / (n + 1), the expected loss exceeds alpha."""
    rng = np.random.default_rng(5)
    n, alpha = 6, 0.17
    excess = []
    for _ in range(3000):
        level = rng.random(n + 1) ** 0.5  # each image is one pixel
        losses = level[:, None] <= np.linspace(0, 1, 401)
        plain = np.nonzero(losses[:n].mean(axis=0) <= alpha)[0][-1]
        excess.append(losses[n, plain])
    assert np.mean(excess) > alpha


@given(seed=st.integers(0, 2000), n_images=st.integers(2, 30), alpha=st.floats(0.05, 0.6))
def test_leave_one_out_uses_the_threshold_of_the_other_images(seed, n_images, alpha):
    losses = losses_of_images(random_images(seed, n_images))
    result = leave_one_out_loss(losses, alpha)
    for i in range(n_images):
        threshold = conformal_threshold(np.delete(losses, i, axis=0), alpha)
        expected = 0.0 if threshold is None else losses[i, list(THRESHOLD_GRID).index(threshold)]
        assert result[i] == pytest.approx(expected, abs=1e-12)


def test_temperature_maps_the_threshold_and_keeps_the_pixels_below_it():
    images = list(random_images(3, 20))
    for temperature in (0.5, 1.7):
        plain = conformal_threshold(losses_of_images(images), 0.3)
        scaled = [(apply_temperature(p, temperature), y) for p, y in images]
        mapped = apply_temperature(np.array([plain]), temperature).item()
        for (p, _), (q, _) in zip(images, scaled, strict=True):
            np.testing.assert_array_equal(p <= plain, q <= mapped)


def test_risk_control_reports_the_loss_on_held_out_images():
    losses, further = losses_of_images(random_images(1, 25)), losses_of_images(random_images(2, 12))
    row = control_risk(losses, 0.2, further)
    column = list(THRESHOLD_GRID).index(row.threshold)
    assert (row.alpha, row.n_images) == (0.2, 25)
    assert row.held_out_mean == pytest.approx(further[:, column].mean())
    assert row.held_out_worst == further[:, column].max()
    left_out = control_risk(losses, 0.2)
    assert left_out.threshold == row.threshold
    assert left_out.held_out_mean == pytest.approx(leave_one_out_loss(losses, 0.2).mean())
    assert left_out.held_out_mean <= 0.2
    too_few = control_risk(losses[:4], 0.05)
    assert (too_few.threshold, too_few.held_out_mean, too_few.held_out_worst) == (None, None, None)
    nothing = control_risk(np.zeros((0, len(THRESHOLD_GRID))), 0.05)
    assert (nothing.n_images, nothing.threshold) == (0, None)


def test_images_without_a_hand_have_no_loss_and_alpha_outside_0_1_is_refused():
    assert missed_fractions(np.full((2, 2), 0.1), np.zeros((2, 2), bool)) is None
    for alpha in (0.0, 1.0, float("nan")):
        with pytest.raises(SettingsError, match="alpha"):
            conformal_threshold(np.zeros((3, len(THRESHOLD_GRID))), alpha)
