"""Temperature: a known one is recovered, a second minimizer agrees, and the judged image is never seen."""

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
    stack_logit_counts,
)


def images(temperature, n_images=10, seed=0, shape=(60, 80)):
    """p_occupied that is right after division of its logit by ``temperature``."""
    rng = np.random.default_rng(seed)
    for _ in range(n_images):
        logit = rng.normal(-0.5, 2.0, size=shape)
        label = rng.random(shape) < 1 / (1 + np.exp(-logit))
        yield 1 / (1 + np.exp(-temperature * logit)), label


def counts_of(predictions):
    return stack_logit_counts([logit_counts(p, y) for p, y in predictions])


@pytest.mark.parametrize("temperature", [0.4, 1.0, 1.7, 4.0])
def test_a_known_temperature_is_recovered(temperature):
    assert fit_temperature(counts_of(images(temperature))) == pytest.approx(temperature, rel=0.03)


def test_the_fit_agrees_with_a_minimizer_on_the_pixels_themselves():
    predictions = list(images(2.2, n_images=3))

    def nll(temperature):
        return np.mean([score_image(apply_temperature(p, temperature), y).nll for p, y in predictions])

    direct = minimize_scalar(nll, bounds=(0.1, 10), method="bounded", options={"xatol": 1e-6}).x
    assert fit_temperature(counts_of(predictions)) == pytest.approx(direct, rel=1e-4)


def test_recalibration_lowers_the_nll_of_unseen_images_of_an_overconfident_network():
    predictions = list(images(3.0))
    temperatures = cross_fitted_temperatures(counts_of(predictions))
    before = np.mean([score_image(p, y).nll for p, y in predictions])
    after = np.mean(
        [score_image(apply_temperature(p, t), y).nll for (p, y), t in zip(predictions, temperatures, strict=True)]
    )
    assert after < 0.8 * before


@pytest.mark.parametrize("n_folds", [None, 2, 3])
def test_a_temperature_has_not_seen_the_images_that_it_is_judged_on(n_folds):
    predictions = list(images(1.5, n_images=6))
    before = cross_fitted_temperatures(counts_of(predictions), n_folds)
    p, label = predictions[0]
    predictions[0] = (p, ~label)
    after = cross_fitted_temperatures(counts_of(predictions), n_folds)
    fold = np.arange(6) % (n_folds or 6)
    np.testing.assert_array_equal(before[fold == 0], after[fold == 0])
    assert (before[fold != 0] != after[fold != 0]).all()


def test_one_fold_an_image_is_a_fit_on_the_others():
    predictions = list(images(1.5, n_images=4, shape=(20, 20)))
    temperatures = cross_fitted_temperatures(counts_of(predictions))
    for index, temperature in enumerate(temperatures):
        others = predictions[:index] + predictions[index + 1 :]
        assert temperature == fit_temperature(counts_of(others))


def test_limits_for_predictions_that_are_always_right_or_always_wrong():
    label = np.array([[True, False, True]])
    right = np.where(label, 0.9, 0.1)
    assert fit_temperature(logit_counts(right, label)) == pytest.approx(0.05)
    assert fit_temperature(logit_counts(1 - right, label)) == pytest.approx(20.0)


@given(p=st.floats(0, 1), temperature=st.floats(0.1, 10))
def test_a_temperature_keeps_the_class_and_is_undone_by_its_inverse(p, temperature):
    p_occupied = np.array([[p]])
    scaled = apply_temperature(p_occupied, temperature)
    assert 0.0 <= scaled[0, 0] <= 1.0
    if abs(p - 0.5) > 1e-9:
        assert (scaled[0, 0] >= 0.5) == (p >= 0.5)
    if 1e-4 < p < 1 - 1e-4 and temperature > 0.8:
        assert apply_temperature(scaled, 1 / temperature)[0, 0] == pytest.approx(p, rel=1e-6, abs=1e-9)


def test_temperature_one_changes_nothing_at_all():
    p_occupied = np.array([[0.0, 1e-12, 0.3, 1.0]], np.float32)
    np.testing.assert_array_equal(apply_temperature(p_occupied, 1.0), p_occupied)


def test_a_pooled_probability_of_exactly_0_or_1_is_finite():
    p_occupied = np.array([[0.0, 1.0, 1.0, 0.0]])
    label = np.array([[False, True, False, True]])
    assert np.isfinite(fit_temperature(logit_counts(p_occupied, label)))


def test_bad_input_is_refused():
    counts = counts_of(images(1.0, n_images=3, shape=(4, 4)))
    for n_folds in (1, 4):
        with pytest.raises(SettingsError, match="folds"):
            cross_fitted_temperatures(counts, n_folds)
    with pytest.raises(SettingsError, match="at least one image"):
        fit_temperature(counts.without(np.arange(3)))
    with pytest.raises(SettingsError, match="positive"):
        apply_temperature(np.array([[0.5]]), 0.0)
