"""Confidence intervals: closed forms, coverage by simulation, and order."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from deltasafe.errors import SettingsError
from deltasafe.studies.intervals import clopper_pearson, mean_upper_bound, upper_bound


@pytest.mark.parametrize("n", [1, 30, 299, 400])
def test_bounds_without_violations_have_a_closed_form(n):
    assert upper_bound(0, n) == pytest.approx(1 - 0.05 ** (1 / n), rel=1e-12)
    low, high = clopper_pearson(0, n)
    assert low == 0
    assert high == pytest.approx(1 - 0.025 ** (1 / n), rel=1e-12)
    assert mean_upper_bound(np.zeros(n)) == pytest.approx(upper_bound(0, n), rel=1e-6)


def test_one_percent_requires_299_motions_without_violation():
    assert upper_bound(0, 299) < 0.01 < upper_bound(0, 298)


@given(st.integers(1, 400), st.data())
def test_interval_ends_have_the_binomial_tail_probabilities(n, data):
    count = data.draw(st.integers(0, n))
    low, high = clopper_pearson(count, n)
    assert 0 <= low <= count / n <= high <= 1
    if count > 0:
        assert stats.binom.sf(count - 1, n, low) == pytest.approx(0.025, rel=1e-6)
    if count < n:
        assert stats.binom.cdf(count, n, high) == pytest.approx(0.025, rel=1e-6)
        assert stats.binom.cdf(count, n, upper_bound(count, n)) == pytest.approx(0.05, rel=1e-6)
    assert upper_bound(count, n) <= high


@given(st.integers(1, 300), st.data())
def test_bound_of_a_mean_is_at_least_the_exact_binomial_bound(n, data):
    count = data.draw(st.integers(0, n))
    bound = mean_upper_bound(np.arange(n) < count)
    assert bound >= upper_bound(count, n) - 1e-9
    assert bound <= 1


def test_bound_of_a_mean_covers_it():
    rng = np.random.default_rng(0)
    truth, covered = 0.02, 0
    for _ in range(300):
        violates = rng.random(200) < 0.1
        values = np.where(violates, rng.beta(1, 4, 200), 0.0)  # mean 0.1 * 0.2
        covered += mean_upper_bound(values) >= truth
    assert covered >= 0.95 * 300 - 3 * math.sqrt(300 * 0.05 * 0.95)
    # and it is tighter than the bound of the fraction of motions with any violation
    assert mean_upper_bound(values) < upper_bound(int((values > 0).sum()), 200)


def test_clopper_pearson_covers_at_its_level():
    counts = np.random.default_rng(1).binomial(150, 0.03, 2000)
    inside = sum(low <= 0.03 <= high for low, high in (clopper_pearson(int(k), 150) for k in counts))
    assert inside / 2000 >= 0.95


def test_impossible_counts_are_refused():
    for count, n in ((-1, 3), (4, 3)):
        with pytest.raises(SettingsError, match="count"):
            clopper_pearson(count, n)
    with pytest.raises(SettingsError, match="level"):
        upper_bound(0, 3, level=1.0)
    with pytest.raises(SettingsError, match="values"):
        mean_upper_bound(np.array([0.5, 1.5]))
    assert mean_upper_bound(np.zeros(0)) == 1.0
    assert mean_upper_bound(np.ones(4)) == 1.0
    assert clopper_pearson(0, 0) == (0.0, 1.0)
