import dataclasses
import pathlib
import shutil

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from deltasafe.errors import ArtifactError, SettingsError
from deltasafe.perception.artifact.promotion import decide_promotion, non_inferiority_tests, score_ensemble
from deltasafe.perception.calibration.metrics import ImageScores, score_image
from deltasafe.perception.data.labeled_images import LabeledImageSet
from deltasafe.perception.settings import PromotionSettings
from tests.ensembles import freeze_constant, write_hands

DEFAULT = PromotionSettings()


def scores_of(nll, brier, miou):
    return tuple(
        ImageScores(1000, 200, 0.98, float(m), float(b), float(n), 0.0, 0.0)
        for n, b, m in zip(nll, brier, miou, strict=True)
    )


def random_scores(rng, n=50, nll=0.05, miou=0.95, spread=0.3):
    values = nll * np.exp(spread * rng.standard_normal(n))
    return scores_of(values, values / 4, np.clip(miou + 0.02 * rng.standard_normal(n), 0, 1))


def test_identical_scores_have_zero_loss():
    images = random_scores(np.random.default_rng(0))
    for loss in non_inferiority_tests(images, images, DEFAULT):
        assert loss.loss == loss.bound == 0.0
        assert loss.passed


@given(st.integers(0, 10**6), st.floats(0.3, 0.95))
@settings(max_examples=20, deadline=None)
def test_challenger_better_on_every_image_passes(seed, factor):
    old = random_scores(np.random.default_rng(seed))
    new = tuple(dataclasses.replace(i, nll=i.nll * factor, brier=i.brier * factor) for i in old)
    for loss in non_inferiority_tests(old, new, DEFAULT):
        assert loss.bound <= 0.0
        assert loss.passed


def test_loss_of_one_metric_fails_its_test_only():
    old = random_scores(np.random.default_rng(1))
    new = tuple(dataclasses.replace(i, miou=i.miou - 0.03) for i in old)
    passed = {loss.measure: loss.passed for loss in non_inferiority_tests(old, new, DEFAULT)}
    assert passed == {"NLL": True, "BS": True, "mIoU": False}


def test_bound_agrees_with_normal_approximation():
    """Mean of the paired differences plus 1.645 standard errors."""
    rng = np.random.default_rng(2)
    old, new = random_scores(rng), random_scores(rng)
    differences = np.array([a.miou - b.miou for a, b in zip(old, new, strict=True)])
    error = differences.std(ddof=1) / np.sqrt(len(differences))
    bound = non_inferiority_tests(old, new, PromotionSettings(n_bootstrap=20000))[2].bound
    assert bound == pytest.approx(differences.mean() + 1.645 * error, abs=0.1 * error)


def test_false_promotion_rate_at_the_margin_is_about_5_percent():
    """Size of the test: the true loss equals the margin in 200 test sets; 1 to 24 passes are expected."""
    rng = np.random.default_rng(3)
    promoted = 0
    for _ in range(200):
        old, noise = random_scores(rng), 0.01 * rng.standard_normal(50)
        new = tuple(dataclasses.replace(i, miou=i.miou - 0.01 + e) for i, e in zip(old, noise, strict=True))
        promoted += non_inferiority_tests(old, new, PromotionSettings(n_bootstrap=300))[2].passed
    assert 1 <= promoted <= 24


def test_pairing_removes_variance_between_images():
    old = random_scores(np.random.default_rng(4), spread=1.0)
    new = tuple(dataclasses.replace(i, nll=i.nll * 1.05) for i in old)
    loss = non_inferiority_tests(old, new, DEFAULT)[0]
    assert loss.bound == pytest.approx(0.05, abs=1e-9)


def test_scores_of_different_images_are_refused():
    images = random_scores(np.random.default_rng(5))
    with pytest.raises(SettingsError, match="same images"):
        non_inferiority_tests(images, images[:-1], DEFAULT)


@pytest.mark.parametrize("change", [{"nll_margin": -0.1}, {"level": 0.4}, {"n_bootstrap": 10}, {"miou_margin": np.nan}])
def test_invalid_promotion_settings_are_refused(change):
    with pytest.raises(SettingsError):
        PromotionSettings(**change)


@pytest.fixture(scope="module")
def case(tmp_path_factory):
    root = tmp_path_factory.mktemp("promotion")
    good, bad = freeze_constant(root, -3.0), freeze_constant(root, 1.0)
    return LabeledImageSet.load(write_hands(root / "test")), good, bad, root / "scores"


def test_first_ensemble_and_champion_itself_are_promoted(case):
    test, good, _, cache = case
    assert decide_promotion(good, None, test, cache, DEFAULT).promoted
    assert decide_promotion(good, good, test, cache, DEFAULT).reason == "already in use"


def test_worse_challenger_is_refused_and_better_one_promoted(case):
    test, good, bad, cache = case
    refused = decide_promotion(bad, good, test, cache, DEFAULT)
    assert (refused.champion, refused.promoted) == (good.name, False)
    assert "NLL" in refused.reason
    assert "beyond the margin" in refused.reason
    accepted = decide_promotion(good, bad, test, cache, DEFAULT)
    assert (accepted.champion, accepted.promoted) == (good.name, True)


def test_demoted_ensemble_is_not_promoted_by_its_scores(case):
    test, good, bad, cache = case
    verdict = decide_promotion(good, bad, test, cache, DEFAULT, objection="saw gloves as background")
    assert (verdict.promoted, verdict.champion) == (False, bad.name)
    assert verdict.reason.endswith("saw gloves as background")


def test_scores_are_computed_once_per_test_set(case, monkeypatch):
    test, good, _, cache = case
    first = score_ensemble(good, test, cache)
    expected = [score_image(np.full((48, 64), 1 / (1 + np.exp(3.0)), np.float32), test.read(k)[1]) for k in range(4)]
    assert [image.nll for image in first] == pytest.approx([image.nll for image in expected], rel=1e-4)
    monkeypatch.setattr(
        "deltasafe.perception.artifact.promotion.load_ensemble", lambda folder: pytest.fail("computed again")
    )
    assert score_ensemble(good, test, cache) == first


def test_damaged_champion_is_refused(case, tmp_path):
    test, good, bad, _ = case
    damaged = pathlib.Path(shutil.copytree(good, tmp_path / good.name))
    next(damaged.glob("member-*.safetensors")).write_bytes(b"?")
    with pytest.raises(ArtifactError, match="was altered"):
        decide_promotion(bad, damaged, test, tmp_path / "scores", DEFAULT)
