"""The smallest delta that labeled images support, and the refusal to plan below it."""

import dataclasses
import itertools
import json

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from deltasafe.errors import SettingsError
from deltasafe.perception.calibration.delta_support import (
    Calibration,
    delta_support,
    held_out_support,
    require_supported_delta,
    smallest_supported_delta,
)
from deltasafe.perception.calibration.reliability import DELTA_GRID, safety_counts, stack_counts

SIDE = 40


def images_with_misses(misses, p_background=1e-5):
    """One image per entry: a fifth of it is hand, of which ``misses`` pixels have the p_occupied of background."""
    images = []
    for n_missed in misses:
        label = np.zeros((SIDE, SIDE), bool)
        label[: SIDE // 5] = True
        p_occupied = np.where(label, 0.999, p_background)
        p_occupied.ravel()[:n_missed] = p_background
        images.append(safety_counts(p_occupied, label))
    return stack_counts(images)


def supported(counts, **settings):
    return smallest_supported_delta(delta_support(counts, **settings))


def test_bound_without_a_miss_is_the_rule_of_three_over_images():
    for n_images in (20, 50, 200):
        row = delta_support(images_with_misses([0] * n_images))[0]
        assert row.occupied_fraction == 0.0
        # of n + 1 images, three are missed completely (Poisson, 95 %); all of their pixels are free, 0.8 of the others
        expected = 3 * 0.2 / ((n_images - 2) * 0.8 + 3)
        assert row.upper_bound == pytest.approx(expected, rel=1e-9)


def test_supported_delta_falls_with_the_number_of_perfect_images():
    assert supported(images_with_misses([0] * 50)) == 0.015
    assert supported(images_with_misses([0] * 1000)) == 0.001
    assert supported(images_with_misses([0] * 3)) >= 0.1


@given(
    misses=st.lists(st.integers(0, 200), min_size=4, max_size=12),
    more=st.integers(1, 100),
    where=st.integers(0, 3),
)
def test_further_misses_never_lower_the_bound(misses, more, where):
    worse = list(misses)
    worse[where] += more
    before, after = (delta_support(images_with_misses(m), n_bootstrap=200) for m in (misses, worse))
    for a, b in zip(before, after, strict=True):
        assert b.upper_bound >= a.upper_bound
        assert a.supported or not b.supported


@given(misses=st.lists(st.integers(0, 300), min_size=2, max_size=30), seed=st.integers(0, 50))
def test_bound_lies_above_the_estimate_and_support_is_monotone(misses, seed):
    rows = delta_support(images_with_misses(misses), n_bootstrap=300, seed=seed)
    assert [row.delta for row in rows] == list(DELTA_GRID)
    for row, following in itertools.pairwise(rows):
        assert row.upper_bound >= row.occupied_fraction
        assert following.supported or not row.supported
        assert row.miss_rate_worst == max(misses) / (SIDE * SIDE // 5)
        assert row.miss_rate_mean == pytest.approx(np.mean(misses) / (SIDE * SIDE // 5))


def test_misses_in_one_image_raise_the_bound_more_than_the_same_misses_in_all():
    spread = delta_support(images_with_misses([6] * 50))[0]
    single = delta_support(images_with_misses([300] + [0] * 49))[0]
    assert spread.occupied_fraction == single.occupied_fraction
    assert single.upper_bound > spread.upper_bound


def test_bound_covers_the_true_fraction_in_nine_of_ten_repetitions():
    rng = np.random.default_rng(7)
    true_rate = 0.15 * 60 / (0.8 * SIDE * SIDE + 0.15 * 60)  # 15 % of images lose 60 hand pixels
    covered = [
        delta_support(images_with_misses(60 * (rng.random(40) < 0.15)), n_bootstrap=300)[0].upper_bound >= true_rate
        for _ in range(60)
    ]
    assert np.mean(covered) >= 0.9


def test_images_without_a_hand_have_no_miss_rate():
    counts = safety_counts(np.full((4, 4), 0.01), np.zeros((4, 4), bool))
    row = delta_support(stack_counts([counts, counts]))[-1]
    assert (row.miss_rate_mean, row.miss_rate_worst) == (None, None)


def test_a_network_that_misses_every_hand_supports_no_useful_delta():
    rows = delta_support(images_with_misses([SIDE * SIDE // 5] * 30, p_background=1e-5))
    assert [row.supported for row in rows] == [row.delta >= 0.2 for row in rows]
    all_hand = safety_counts(np.full((4, 4), 0.01), np.ones((4, 4), bool))
    assert supported(stack_counts([all_hand] * 30)) is None


def test_bound_depends_only_on_the_seed():
    counts = images_with_misses(range(0, 60, 3))
    assert delta_support(counts, seed=4) == delta_support(counts, seed=4)
    assert delta_support(counts, seed=4) != delta_support(counts, seed=5)


CALIBRATION = Calibration(50, 5, 0.98, 0.95, 0.01, 0.05, 0.003, smallest_supported_delta=0.02)


def test_supported_delta_passes():
    require_supported_delta(0.02, CALIBRATION)
    require_supported_delta(0.05, CALIBRATION)


def test_smaller_delta_is_refused_and_the_supported_one_named():
    with pytest.raises(SettingsError, match=r"delta = 0\.019 .*50 test images.*is 0\.02;.*delta >= 0\.02"):
        require_supported_delta(0.019, CALIBRATION)
    nothing = dataclasses.replace(CALIBRATION, smallest_supported_delta=None)
    with pytest.raises(SettingsError, match="support no delta"):
        require_supported_delta(0.4, nothing)
    for delta in (0.0, 1.0, float("nan")):
        with pytest.raises(SettingsError, match=r"\(0, 1\)"):
            require_supported_delta(delta, CALIBRATION)


def test_calibration_survives_json_and_refuses_invalid_values():
    assert Calibration(**json.loads(json.dumps(dataclasses.asdict(CALIBRATION)))) == CALIBRATION
    with pytest.raises(SettingsError, match="smallest_supported_delta"):
        dataclasses.replace(CALIBRATION, smallest_supported_delta=0.0)
    with pytest.raises(SettingsError, match="temperature"):
        dataclasses.replace(CALIBRATION, temperature=0.0)


def test_delta_below_an_unsupported_one_is_not_supported():
    label = np.zeros((SIDE, SIDE), bool)
    label[: SIDE // 5] = True
    p_occupied = np.where(label, 0.999, 1e-5)
    p_occupied[: SIDE // 10] = 0.04  # from 0.05 on, half of the hand is free: a ninth of the free pixels
    rows = delta_support(stack_counts([safety_counts(p_occupied, label)] * 50))
    holds = {row.delta: row.upper_bound <= row.delta for row in rows}
    assert [holds[delta] for delta in (0.02, 0.05, 0.15)] == [True, False, True]
    assert smallest_supported_delta(rows) == 0.15


def test_delta_is_evaluated_on_images_outside_its_fit():
    counts = images_with_misses([0, 3, 0, 8, 1, 0, 90, 2])
    parts = [np.array([0, 4]), np.array([1, 2, 3]), np.array([5, 6, 7])]
    fits = [counts.take(np.setdiff1d(np.arange(8), part)) for part in parts]
    result = held_out_support(counts, fits, parts, n_bootstrap=200, seed=2)
    deltas = [smallest_supported_delta(delta_support(fit, n_bootstrap=200, seed=2)) for fit in fits]
    free = missed = 0
    for delta, part in zip(deltas, parts, strict=True):
        for image in part.tolist():
            for k, bound in enumerate(DELTA_GRID):
                if bound <= delta:
                    free += int(counts.count[image, k])
                    missed += int(counts.event[image, k])
    assert (result.n_fits, result.n_without_delta) == (3, 0)
    assert (result.lowest, result.highest) == (min(deltas), max(deltas))
    assert result.occupied_fraction == pytest.approx(missed / free, abs=1e-12)
    assert result.free_fraction == pytest.approx(free / (8 * SIDE * SIDE), abs=1e-12)


def test_fit_without_a_supported_delta_has_no_free_pixels():
    all_hand = stack_counts([safety_counts(np.full((4, 4), 0.01), np.ones((4, 4), bool))] * 4)
    result = held_out_support(all_hand, [all_hand], [np.arange(4)], n_bootstrap=100)
    assert (result.n_without_delta, result.lowest, result.highest) == (1, None, None)
    assert (result.free_fraction, result.occupied_fraction) == (0.0, None)
