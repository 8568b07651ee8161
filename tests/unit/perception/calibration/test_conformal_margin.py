"""Conformal margins: closed forms, invariances, and the coverage of simulated exchangeable scores."""

import dataclasses
import itertools
import json
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats
from scipy.spatial.distance import cdist

from deltasafe.errors import SettingsError
from deltasafe.io.records import from_json
from deltasafe.perception.calibration.conformal_margin import (
    ConformalMargins,
    distance_to_unsafe_px,
    hausdorff_at_delta,
    margin_sentence,
)
from deltasafe.perception.calibration.reliability import DELTA_GRID

SHAPE = (60, 80)
Y, X = np.mgrid[: SHAPE[0], : SHAPE[1]]
SEEDS = st.integers(0, 2**31)


def disk(center_y, center_x, radius):
    return np.hypot(Y - center_y, X - center_x) <= radius


def random_image(seed, width=None):
    rng = np.random.default_rng(seed)
    shape = (int(rng.integers(2, 13)), width or int(rng.integers(2, 13)))
    return rng.random(shape) ** rng.uniform(1, 8), rng.random(shape) < rng.uniform(0.05, 0.6)


def margins_of(scores):
    """Margins of scores (n,), the same for every delta."""
    return ConformalMargins.of_images(np.repeat(np.asarray(scores, dtype=float)[:, None], len(DELTA_GRID), axis=1))


@settings(max_examples=60, deadline=None)
@given(SEEDS)
def test_score_agrees_with_all_pairs_of_pixels(seed):
    p_occupied, hand = random_image(seed)
    for delta, score in zip(DELTA_GRID, hausdorff_at_delta(p_occupied, hand), strict=True):
        pixels, unsafe = np.argwhere(hand), np.argwhere(p_occupied > delta)
        if len(pixels) == 0:
            expected = 0.0
        elif len(unsafe) == 0:
            expected = math.inf
        else:
            expected = cdist(pixels, unsafe).min(axis=1).max() / hand.shape[1]
        assert score == pytest.approx(expected, abs=1e-12)


def test_disks_missed_by_a_known_distance_have_that_margin():
    detected = disk(30, 30, 10)
    scores = []
    for missed_px in range(1, 20):
        p_occupied = np.where(detected, 0.9, 0.001)
        hand = detected | (disk(30, 40 + missed_px, 0) & (X > 40))  # one pixel, missed_px beyond the edge
        scores.append(hausdorff_at_delta(p_occupied, hand))
    margins = ConformalMargins.of_images(np.array(scores))
    for rank in range(1, 20):
        margin = margins.margin(0.05, 1 - rank / 20)
        assert (margin.rank, margin.fraction_of_width) == (rank, rank / 80)
        assert margin.px == pytest.approx(384 * rank / 80)
    assert margins.margin(5e-4, 0.05).fraction_of_width == 0.0  # everything is unsafe at this delta


def test_a_larger_disk_than_the_detected_one_has_the_difference_of_the_radii():
    p_occupied = np.where(disk(30, 40, 8), 0.9, 0.001)
    score = hausdorff_at_delta(p_occupied, disk(30, 40, 20))[DELTA_GRID.index(0.05)]
    assert score * 80 == pytest.approx(12, abs=1)


def test_the_dilated_set_contains_the_hand_exactly_from_its_score_on():
    p_occupied, hand = random_image(4)
    for delta, score in zip(DELTA_GRID, hausdorff_at_delta(p_occupied, hand), strict=True):
        distance = distance_to_unsafe_px(p_occupied > delta) / hand.shape[1]
        assert (distance[hand] <= score).all()
        assert score == 0.0 or not (distance[hand] <= score - 1e-9).all()


def test_images_without_a_hand_score_0_and_hands_without_an_unsafe_pixel_infinity():
    nothing, everything = np.zeros(SHAPE, bool), np.ones(SHAPE, bool)
    assert (hausdorff_at_delta(np.full(SHAPE, 0.2), nothing) == 0.0).all()
    expected = np.where(np.array(DELTA_GRID) < 0.2, 0.0, np.inf)
    np.testing.assert_array_equal(hausdorff_at_delta(np.full(SHAPE, 0.2), everything), expected)
    with pytest.raises(SettingsError, match="label's resolution"):
        hausdorff_at_delta(np.zeros((3, 4)), nothing)


@settings(max_examples=60, deadline=None)
@given(SEEDS)
def test_score_does_not_decrease_with_delta(seed):
    scores = hausdorff_at_delta(*random_image(seed))
    assert (scores[1:] >= scores[:-1]).all()


@settings(max_examples=60, deadline=None)
@given(SEEDS)
def test_an_image_of_twice_the_size_has_the_same_score_up_to_a_pixel(seed):
    p_occupied, hand = random_image(seed)
    score = hausdorff_at_delta(p_occupied, hand)
    large = hausdorff_at_delta(*(np.repeat(np.repeat(a, 2, axis=0), 2, axis=1) for a in (p_occupied, hand)))
    np.testing.assert_array_equal(np.isinf(large), np.isinf(score))
    finite = np.isfinite(score)
    np.testing.assert_allclose(large[finite], score[finite], rtol=0, atol=1 / hand.shape[1])


@settings(max_examples=60, deadline=None)
@given(SEEDS, st.integers(1, 60))
def test_larger_alpha_never_gives_a_larger_margin(seed, n_images):
    rng = np.random.default_rng(seed)
    scores = np.where(rng.random(n_images) < 0.1, np.inf, rng.random(n_images).round(1))
    margins = margins_of(scores)
    alphas = np.sort(rng.uniform(margins.smallest_alpha, 1, 30))
    found = [margins.margin(0.05, alpha).fraction_of_width for alpha in alphas]
    assert all(a >= b for a, b in itertools.pairwise(found))


@settings(max_examples=40, deadline=None)
@given(SEEDS)
def test_order_of_images_changes_nothing(seed):
    rng = np.random.default_rng(seed)
    scores = np.sort(rng.random((7, len(DELTA_GRID))), axis=1)
    assert ConformalMargins.of_images(rng.permutation(scores)) == ConformalMargins.of_images(scores)


@pytest.mark.parametrize(("n_images", "alpha"), [(19, 0.05), (50, 0.05), (99, 0.1)])
def test_coverage_of_exchangeable_scores_is_beta_distributed(n_images, alpha):
    # the scores are uniform, so that the coverage of a margin is the margin itself
    rng = np.random.default_rng(3)
    margins = [margins_of(rng.random(n_images)).margin(0.05, alpha) for _ in range(1000)]
    coverage = [margin.fraction_of_width for margin in margins]
    rank = math.ceil((n_images + 1) * (1 - alpha) - 1e-9)
    assert margins[0].rank == rank
    assert stats.kstest(coverage, stats.beta(rank, n_images + 1 - rank).cdf).pvalue > 0.01
    assert margins[0].expected_coverage == pytest.approx(np.mean(coverage), abs=0.006)
    assert margins[0].expected_coverage >= 1 - alpha
    low, high = margins[0].coverage_interval()
    within = [low <= value <= high for value in coverage]
    assert np.mean(within) == pytest.approx(0.95, abs=0.025)


def test_a_new_exchangeable_image_is_covered_with_the_promised_probability():
    rng = np.random.default_rng(5)
    scores = rng.gamma(0.5, size=(4000, 20)).round(1)  # many equal scores
    covered = [new <= margins_of(known).margin(0.05, 0.1).fraction_of_width for new, *known in scores]
    assert np.mean(covered) >= 0.9 - 3 * math.sqrt(0.1 * 0.9 / 4000)


@pytest.mark.parametrize("n_images", [1, 9, 49, 50, 99, 300])
def test_alpha_below_the_smallest_is_refused_with_the_number(n_images):
    margins = margins_of(np.arange(1, n_images + 1))
    smallest = margins.smallest_alpha
    assert smallest == pytest.approx(1 / (n_images + 1))
    assert margins.margin(0.05, smallest).fraction_of_width == n_images
    with pytest.raises(SettingsError, match=rf"1 / \({n_images} \+ 1\) = {smallest:.4g}; .*at least \d+ images"):
        margins.margin(0.05, 0.99 * smallest)


@pytest.mark.parametrize(("alpha", "n_images"), [(0.2, 4), (0.1, 9), (0.05, 19), (0.02, 49), (0.01, 99), (0.003, 333)])
def test_refusal_names_the_smallest_number_of_images_that_alpha_needs(alpha, n_images):
    assert margins_of(np.arange(n_images)).margin(0.05, alpha).rank == n_images
    with pytest.raises(SettingsError, match=rf"at least {n_images} images"):
        margins_of(np.arange(n_images - 1)).margin(0.05, alpha)


@pytest.mark.parametrize(("n_images", "alphas"), [(3, (0.25,)), (4, (0.2,)), (50, (0.02, 0.05, 0.1, 0.2))])
def test_shown_alphas_are_those_that_the_images_certify(n_images, alphas):
    assert margins_of(np.arange(n_images)).shown_alphas == alphas


def test_delta_between_two_of_the_grid_has_the_margin_of_the_larger():
    scores = np.tile(np.arange(len(DELTA_GRID)) / 100, (9, 1))
    margins = ConformalMargins.of_images(scores)
    assert margins.margin(0.04, 0.1) == margins.margin(0.05, 0.1)
    assert margins.margin(0.05, 0.1).delta == 0.05
    assert margins.margin(0.05, 0.1) != margins.margin(0.050001, 0.1)
    for delta in (0.0, -0.1, 0.51, math.nan):
        with pytest.raises(SettingsError, match=r"\(0, 0\.5\]"):
            margins.margin(delta, 0.1)
    for alpha in (0.0, 1.0, math.nan):
        with pytest.raises(SettingsError, match=r"\(0, 1\)"):
            margins.margin(0.05, alpha)


def test_margins_survive_json_with_infinite_scores():
    margins = margins_of([0.1, np.inf, 0.0])
    text = json.dumps(dataclasses.asdict(margins), allow_nan=False)
    loaded = from_json(ConformalMargins, json.loads(text))
    assert loaded == margins
    assert loaded.margin(0.05, 0.25).fraction_of_width == math.inf
    assert loaded.margin(0.05, 0.5).fraction_of_width == 0.1


@pytest.mark.parametrize(
    ("deltas", "scores", "match"),
    [
        ((), (), "ascend"),
        ((0.1, 0.05), ((0.0,), (0.0,)), "ascend within"),
        ((0.1, 1.0), ((0.0,), (0.0,)), "ascend within"),
        ((0.1,), (), "n >= 1"),
        ((0.1,), ((),), "n >= 1"),
        ((0.1, 0.2), ((0.0,), (0.0, 1.0)), "n >= 1"),
        ((0.1,), ((-0.1, 0.0),), "at least 0"),
        ((0.1,), ((0.2, 0.1),), "ascend for each"),
        ((0.1,), ((None, 0.1),), "ascend for each"),
    ],
)
def test_invalid_stored_margins_are_refused(deltas, scores, match):
    with pytest.raises(SettingsError, match=match):
        ConformalMargins(deltas, scores)


def test_sentence_states_margin_probability_and_images():
    text = margin_sentence(margins_of(np.arange(1, 51) / 1000))
    assert "**4.90%** of the image's width" in text
    assert "probability of at least **0.95** (split conformal prediction on 50 images)" in text
    assert "The planner keeps this margin if `motion_alpha` is set." in text
    assert "at least **0.75**" in margin_sentence(margins_of([0.1, 0.2, 0.3]))
    assert "No finite margin" in margin_sentence(margins_of([0.1, np.inf]))
    assert margin_sentence(None) == ""
