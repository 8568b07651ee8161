"""A new ensemble is promoted only where the data say that it is not worse."""

import dataclasses
import pathlib
import shutil

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from deltasafe.errors import ArtifactError, SettingsError
from deltasafe.perception.artifact.promotion import compare_ensembles, decide_promotion, scores_on
from deltasafe.perception.calibration.metrics import ImageScores, score_image
from deltasafe.perception.data.labeled_images import LabeledImageSet
from deltasafe.perception.settings import PromotionSettings
from tests.ensembles import freeze_constant, write_hands

USUAL = PromotionSettings()


def scored(nll, brier, miou):
    return tuple(
        ImageScores(1000, 200, 0.98, float(m), float(b), float(n), 0.0, 0.0)
        for n, b, m in zip(nll, brier, miou, strict=True)
    )


def drawn(rng, n=50, nll=0.05, miou=0.95, spread=0.3):
    values = nll * np.exp(spread * rng.standard_normal(n))
    return scored(values, values / 4, np.clip(miou + 0.02 * rng.standard_normal(n), 0, 1))


def test_the_same_predictions_lose_nothing():
    images = drawn(np.random.default_rng(0))
    for loss in compare_ensembles(images, images, USUAL):
        assert loss.loss == loss.bound == 0.0
        assert loss.tolerable


@given(st.integers(0, 10**6), st.floats(0.3, 0.95))
@settings(max_examples=20, deadline=None)
def test_what_is_better_on_every_image_is_never_refused(seed, factor):
    old = drawn(np.random.default_rng(seed))
    new = tuple(dataclasses.replace(i, nll=i.nll * factor, brier=i.brier * factor) for i in old)
    for loss in compare_ensembles(old, new, USUAL):
        assert loss.bound <= 0.0
        assert loss.tolerable


def test_a_loss_of_one_measure_alone_refuses():
    old = drawn(np.random.default_rng(1))
    new = tuple(dataclasses.replace(i, miou=i.miou - 0.03) for i in old)
    verdict = {loss.measure: loss.tolerable for loss in compare_ensembles(old, new, USUAL)}
    assert verdict == {"NLL": True, "BS": True, "mIoU": False}


def test_the_bound_is_that_of_the_normal_approximation():
    """An independent way to the same number: a mean of differences over images, plus 1.645 standard errors."""
    rng = np.random.default_rng(2)
    old, new = drawn(rng), drawn(rng)
    differences = np.array([a.miou - b.miou for a, b in zip(old, new, strict=True)])
    error = differences.std(ddof=1) / np.sqrt(len(differences))
    bound = compare_ensembles(old, new, PromotionSettings(n_bootstrap=20000))[2].bound
    assert bound == pytest.approx(differences.mean() + 1.645 * error, abs=0.1 * error)


def test_one_that_loses_just_the_margin_is_mostly_refused():
    """The size of the test: true loss at the margin, promoted for about 5 % of test sets."""
    rng = np.random.default_rng(3)
    promoted = 0
    for _ in range(200):
        old, noise = drawn(rng), 0.01 * rng.standard_normal(50)
        new = tuple(dataclasses.replace(i, miou=i.miou - 0.01 + e) for i, e in zip(old, noise, strict=True))
        promoted += compare_ensembles(old, new, PromotionSettings(n_bootstrap=300))[2].tolerable
    assert 1 <= promoted <= 24


def test_pairing_tells_apart_what_unpaired_scores_cannot():
    """Images differ a lot from one another, the two ensembles by the same little on each."""
    old = drawn(np.random.default_rng(4), spread=1.0)
    new = tuple(dataclasses.replace(i, nll=i.nll * 1.05) for i in old)
    loss = compare_ensembles(old, new, USUAL)[0]
    assert loss.bound == pytest.approx(0.05, abs=1e-9)


def test_scores_of_other_images_are_refused():
    images = drawn(np.random.default_rng(5))
    with pytest.raises(SettingsError, match="same images"):
        compare_ensembles(images, images[:-1], USUAL)


@pytest.mark.parametrize("change", [{"nll_margin": -0.1}, {"level": 0.4}, {"n_bootstrap": 10}, {"miou_margin": np.nan}])
def test_settings_outside_their_domain_are_refused(change):
    with pytest.raises(SettingsError):
        PromotionSettings(**change)


# with real ensembles ---------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    root = tmp_path_factory.mktemp("promotion")
    good, bad = freeze_constant(root, -3.0), freeze_constant(root, 1.0)
    return LabeledImageSet.load(write_hands(root / "test")), good, bad, root / "scores"


def test_the_first_is_promoted_and_the_same_again(made):
    test, good, _, kept = made
    assert decide_promotion(good, None, test, kept, USUAL).promoted
    assert decide_promotion(good, good, test, kept, USUAL).reason == "the very ensemble that is in use"


def test_a_worse_one_is_refused_and_a_better_one_promoted(made):
    test, good, bad, kept = made
    refused = decide_promotion(bad, good, test, kept, USUAL)
    assert (refused.champion, refused.promoted) == (good.name, False)
    assert "NLL" in refused.reason
    assert "beyond the margin" in refused.reason
    accepted = decide_promotion(good, bad, test, kept, USUAL)
    assert (accepted.champion, accepted.promoted) == (good.name, True)


def test_what_a_person_took_out_of_use_is_not_promoted_by_its_figures(made):
    test, good, bad, kept = made
    verdict = decide_promotion(good, bad, test, kept, USUAL, demotion_reason="saw gloves as background")
    assert (verdict.promoted, verdict.champion) == (False, bad.name)
    assert verdict.reason.endswith("saw gloves as background")


def test_an_ensemble_is_asked_once_for_each_test_set(made, monkeypatch):
    test, good, _, kept = made
    first = scores_on(good, test, kept)
    expected = [score_image(np.full((48, 64), 1 / (1 + np.exp(3.0)), np.float32), test.read(k)[1]) for k in range(4)]
    assert [image.nll for image in first] == pytest.approx([image.nll for image in expected], rel=1e-4)
    monkeypatch.setattr(
        "deltasafe.perception.artifact.promotion.load_ensemble", lambda folder: pytest.fail("asked again")
    )
    assert scores_on(good, test, kept) == first


def test_a_damaged_champion_is_named(made, tmp_path):
    test, good, bad, _ = made
    damaged = pathlib.Path(shutil.copytree(good, tmp_path / good.name))
    next(damaged.glob("member-*.safetensors")).write_bytes(b"?")
    with pytest.raises(ArtifactError, match="was altered"):
        decide_promotion(bad, damaged, test, tmp_path / "scores", USUAL)
