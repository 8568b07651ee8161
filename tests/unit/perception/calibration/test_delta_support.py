"""The smallest delta that labeled images support."""

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
    """An image an entry: a fifth is hand, of which ``misses`` pixels have the background's p_occupied."""
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


def test_without_a_miss_the_bound_is_the_rule_of_three_on_images():
    for n_images in (20, 50, 200):
        row = delta_support(images_with_misses([0] * n_images))[0]
        assert row.occupied_share == 0.0
        # of n + 1 images three are wholly missed (Poisson, 95 %) and count as free as a whole, others by 0.8
        hidden = 3 * 0.2 / ((n_images - 2) * 0.8 + 3)
        assert row.upper_bound == pytest.approx(hidden, rel=1e-9)


def test_fifty_perfect_images_do_not_support_a_delta_of_one_percent_but_a_thousand_do():
    assert supported(images_with_misses([0] * 50)) == 0.015
    assert supported(images_with_misses([0] * 1000)) == 0.001
    assert supported(images_with_misses([0] * 3)) >= 0.1


@given(
    misses=st.lists(st.integers(0, 200), min_size=4, max_size=12),
    more=st.integers(1, 100),
    where=st.integers(0, 3),
)
def test_a_miss_more_never_supports_a_smaller_delta(misses, more, where):
    worse = list(misses)
    worse[where] += more
    before, after = (delta_support(images_with_misses(m), n_bootstrap=200) for m in (misses, worse))
    for a, b in zip(before, after, strict=True):
        assert b.upper_bound >= a.upper_bound
        assert a.supported or not b.supported


@given(misses=st.lists(st.integers(0, 300), min_size=2, max_size=30), seed=st.integers(0, 50))
def test_the_bound_lies_above_the_estimate_and_rows_are_consistent(misses, seed):
    rows = delta_support(images_with_misses(misses), n_bootstrap=300, seed=seed)
    assert [row.delta for row in rows] == list(DELTA_GRID)
    for row, following in itertools.pairwise(rows):
        assert row.upper_bound >= row.occupied_share
        assert following.supported or not row.supported
        assert row.missed_hand_rate_worst == max(misses) / (SIDE * SIDE // 5)
        assert row.missed_hand_rate_mean == pytest.approx(np.mean(misses) / (SIDE * SIDE // 5))


def test_misses_in_one_image_weigh_more_than_the_same_misses_spread_over_all():
    spread = delta_support(images_with_misses([6] * 50))[0]
    single = delta_support(images_with_misses([300] + [0] * 49))[0]
    assert spread.occupied_share == single.occupied_share
    assert single.upper_bound > spread.upper_bound


def test_the_bound_covers_the_truth_in_most_repetitions():
    rng = np.random.default_rng(7)
    true_rate = 0.15 * 60 / (0.8 * SIDE * SIDE + 0.15 * 60)  # 15 % of images lose 60 hand pixels
    covered = [
        delta_support(images_with_misses(60 * (rng.random(40) < 0.15)), n_bootstrap=300)[0].upper_bound >= true_rate
        for _ in range(60)
    ]
    assert np.mean(covered) >= 0.9


def test_images_without_a_hand_have_no_missed_hand_rate():
    counts = safety_counts(np.full((4, 4), 0.01), np.zeros((4, 4), bool))
    row = delta_support(stack_counts([counts, counts]))[-1]
    assert (row.missed_hand_rate_mean, row.missed_hand_rate_worst) == (None, None)


def test_nothing_is_supported_by_a_network_that_misses_everything():
    rows = delta_support(images_with_misses([SIDE * SIDE // 5] * 30, p_background=1e-5))
    assert [row.supported for row in rows] == [row.delta >= 0.2 for row in rows]
    all_hand = safety_counts(np.full((4, 4), 0.01), np.ones((4, 4), bool))
    assert supported(stack_counts([all_hand] * 30)) is None


def test_same_seed_same_bound():
    counts = images_with_misses(range(0, 60, 3))
    assert delta_support(counts, seed=4) == delta_support(counts, seed=4)
    assert delta_support(counts, seed=4) != delta_support(counts, seed=5)


CALIBRATION = Calibration(50, 5, 0.98, 0.95, 0.01, 0.05, 0.003, smallest_supported_delta=0.02)


def test_a_supported_delta_passes():
    require_supported_delta(0.02, CALIBRATION)
    require_supported_delta(0.05, CALIBRATION)


def test_a_smaller_delta_is_refused_with_the_number():
    with pytest.raises(SettingsError, match=r"delta = 0\.019 .*50 test images.*is 0\.02;.*delta >= 0\.02"):
        require_supported_delta(0.019, CALIBRATION)
    nothing = dataclasses.replace(CALIBRATION, smallest_supported_delta=None)
    with pytest.raises(SettingsError, match="support no delta"):
        require_supported_delta(0.4, nothing)
    for delta in (0.0, 1.0, float("nan")):
        with pytest.raises(SettingsError, match=r"\(0, 1\)"):
            require_supported_delta(delta, CALIBRATION)


def test_a_calibration_survives_json_and_refuses_nonsense():
    assert Calibration(**json.loads(json.dumps(dataclasses.asdict(CALIBRATION)))) == CALIBRATION
    with pytest.raises(SettingsError, match="smallest_supported_delta"):
        dataclasses.replace(CALIBRATION, smallest_supported_delta=0.0)
    with pytest.raises(SettingsError, match="temperature"):
        dataclasses.replace(CALIBRATION, temperature=0.0)


def test_a_delta_below_an_unsupported_one_is_not_supported_either():
    label = np.zeros((SIDE, SIDE), bool)
    label[: SIDE // 5] = True
    p_occupied = np.where(label, 0.999, 1e-5)
    p_occupied[: SIDE // 10] = 0.04  # half of the hand counts as free from 0.05 on: a ninth of the free pixels
    rows = delta_support(stack_counts([safety_counts(p_occupied, label)] * 50))
    holds = {row.delta: row.upper_bound <= row.delta for row in rows}
    assert [holds[delta] for delta in (0.02, 0.05, 0.15)] == [True, False, True]
    assert smallest_supported_delta(rows) == 0.15


def test_a_delta_is_judged_on_images_that_its_fit_has_not_seen():
    counts = images_with_misses([0, 3, 0, 8, 1, 0, 90, 2])
    parts = [np.array([0, 4]), np.array([1, 2, 3]), np.array([5, 6, 7])]
    fits = [counts.take(np.setdiff1d(np.arange(8), part)) for part in parts]
    result = held_out_support(counts, fits, parts, n_bootstrap=200, seed=2)
    deltas = [smallest_supported_delta(delta_support(fit, n_bootstrap=200, seed=2)) for fit in fits]
    clear = missed = 0
    for delta, part in zip(deltas, parts, strict=True):
        for image in part.tolist():
            for k, bound in enumerate(DELTA_GRID):
                if bound <= delta:
                    clear += int(counts.count[image, k])
                    missed += int(counts.event[image, k])
    assert (result.n_fits, result.n_without_delta) == (3, 0)
    assert (result.lowest, result.highest) == (min(deltas), max(deltas))
    assert result.occupied_share == pytest.approx(missed / clear, abs=1e-12)
    assert result.clear_share == pytest.approx(clear / (8 * SIDE * SIDE), abs=1e-12)


def test_a_fit_that_supports_no_delta_takes_nothing_for_free():
    all_hand = stack_counts([safety_counts(np.full((4, 4), 0.01), np.ones((4, 4), bool))] * 4)
    result = held_out_support(all_hand, [all_hand], [np.arange(4)], n_bootstrap=100)
    assert (result.n_without_delta, result.lowest, result.highest) == (1, None, None)
    assert (result.clear_share, result.occupied_share) == (0.0, None)
