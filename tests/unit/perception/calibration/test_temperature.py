"""Temperature: a known one is recovered, SciPy's minimizer agrees, and cross-fitting leaves the own fold out."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import minimize_scalar

from deltasafe.errors import SettingsError
from deltasafe.perception.calibration.metrics import score_image
from deltasafe.perception.calibration.temperature import (
    apply_temperature,
    cross_fitted_temperatures,
    fit_temperature,
    logit_counts,
    pooled_probability,
    stack_logit_counts,
)


def images(temperature, n_images=10, seed=0, shape=(60, 80)):
    """Predictions that are calibrated after dividing their logits by ``temperature``."""
    rng = np.random.default_rng(seed)
    for _ in range(n_images):
        logit = rng.normal(-0.5, 2.0, size=shape)
        label = rng.random(shape) < 1 / (1 + np.exp(-logit))
        yield 1 / (1 + np.exp(-temperature * logit)), label


def counts_of(predictions):
    return stack_logit_counts([logit_counts(p, y) for p, y in predictions])


@pytest.mark.parametrize("temperature", [0.4, 1.0, 1.7, 4.0])
def test_known_temperature_is_recovered(temperature):
    assert fit_temperature(counts_of(images(temperature))) == pytest.approx(temperature, rel=0.03)


def test_fit_agrees_with_scipy_on_the_pixels():
    predictions = list(images(2.2, n_images=3))

    def nll(temperature):
        return np.mean([score_image(apply_temperature(p, temperature), y).nll for p, y in predictions])

    direct = minimize_scalar(nll, bounds=(0.1, 10), method="bounded", options={"xatol": 1e-6}).x
    assert fit_temperature(counts_of(predictions)) == pytest.approx(direct, rel=1e-4)


def test_cross_fitted_temperature_lowers_the_nll_of_an_overconfident_network():
    predictions = list(images(3.0))
    temperatures = cross_fitted_temperatures(counts_of(predictions))
    before = np.mean([score_image(p, y).nll for p, y in predictions])
    after = np.mean(
        [score_image(apply_temperature(p, t), y).nll for (p, y), t in zip(predictions, temperatures, strict=True)]
    )
    assert after < 0.8 * before


@pytest.mark.parametrize("n_folds", [0, 2, 3])
def test_cross_fitted_temperature_does_not_depend_on_the_own_fold(n_folds):
    predictions = list(images(1.5, n_images=6))
    before = cross_fitted_temperatures(counts_of(predictions), n_folds)
    p, label = predictions[0]
    predictions[0] = (p, ~label)
    after = cross_fitted_temperatures(counts_of(predictions), n_folds)
    fold = np.arange(6) % (n_folds or 6)
    np.testing.assert_array_equal(before[fold == 0], after[fold == 0])
    assert (before[fold != 0] != after[fold != 0]).all()


def test_leave_one_out_temperature_is_the_fit_on_the_others():
    predictions = list(images(1.5, n_images=4, shape=(20, 20)))
    temperatures = cross_fitted_temperatures(counts_of(predictions))
    for index, temperature in enumerate(temperatures):
        others = predictions[:index] + predictions[index + 1 :]
        assert temperature == fit_temperature(counts_of(others))


def test_temperature_reaches_its_limits_for_all_correct_and_all_wrong_predictions():
    label = np.array([[True, False, True]])
    correct = np.where(label, 0.9, 0.1)
    assert fit_temperature(logit_counts(correct, label)) == pytest.approx(0.05)
    assert fit_temperature(logit_counts(1 - correct, label)) == pytest.approx(20.0)


@given(p=st.floats(0, 1), temperature=st.floats(0.1, 10))
def test_temperature_keeps_the_class_and_is_inverted_by_its_reciprocal(p, temperature):
    p_occupied = np.array([[p]])
    scaled = apply_temperature(p_occupied, temperature)
    assert 0.0 <= scaled[0, 0] <= 1.0
    if abs(p - 0.5) > 1e-9:
        assert (scaled[0, 0] >= 0.5) == (p >= 0.5)
    if 1e-4 < p < 1 - 1e-4 and temperature > 0.8:
        assert apply_temperature(scaled, 1 / temperature)[0, 0] == pytest.approx(p, rel=1e-6, abs=1e-9)


def test_temperature_one_returns_the_input():
    p_occupied = np.array([[0.0, 1e-12, 0.3, 1.0]], np.float32)
    np.testing.assert_array_equal(apply_temperature(p_occupied, 1.0), p_occupied)


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_pooled_probability_scales_the_logit_of_the_mean_in_the_precision_of_the_members(dtype):
    members = np.random.default_rng(0).random((7, 5, 6)).astype(dtype)
    mean = members[0].copy()
    for member in members[1:]:
        mean += member
    mean /= dtype(7)
    np.testing.assert_array_equal(pooled_probability(members), mean)
    expected = 1 / (1 + np.exp(-(np.log(mean.astype(float)) - np.log1p(-mean.astype(float))) / 1.7))
    np.testing.assert_allclose(pooled_probability(members, 1.7), expected, rtol=1e-12)


def test_fit_is_finite_for_probabilities_of_exactly_0_and_1():
    p_occupied = np.array([[0.0, 1.0, 1.0, 0.0]])
    label = np.array([[False, True, False, True]])
    assert np.isfinite(fit_temperature(logit_counts(p_occupied, label)))


def test_invalid_folds_images_and_temperatures_are_refused():
    counts = counts_of(images(1.0, n_images=3, shape=(4, 4)))
    for n_folds in (1, 4):
        with pytest.raises(SettingsError, match="folds"):
            cross_fitted_temperatures(counts, n_folds)
    with pytest.raises(SettingsError, match="at least one image"):
        fit_temperature(counts.without(np.arange(3)))
    with pytest.raises(SettingsError, match="positive"):
        apply_temperature(np.array([[0.5]]), 0.0)
