"""Image and mask move together, nothing of the old picture shines through, every image can be remade."""

import dataclasses
import json
import math
import pathlib
import subprocess
import sys

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from deltasafe.errors import DataError, SettingsError
from deltasafe.perception.data.augmentation import (
    METHOD_NAMES,
    Arm,
    AugmentationSettings,
    Backgrounds,
    augment,
    chosen_methods,
    cut_out,
    image_seed,
)
from deltasafe.perception.data.augmentation.noise import erase
from deltasafe.perception.data.augmentation.skin import N_TONES, recolor, tone_lab

SMALL = AugmentationSettings(width=64, height=48)
GEOMETRIC = ("flip", "rotation", "grid_distortion", "cropping")


def only(*methods: str) -> AugmentationSettings:
    left_out = tuple(name for name in METHOD_NAMES if name not in methods)
    return dataclasses.replace(SMALL, probability=1.0, left_out=left_out)


def hand_shape(height: int = 96, width: int = 128) -> np.ndarray:
    """A palm with two fingers and an arm that leaves at the bottom."""
    mask = np.zeros((height, width), np.uint8)
    cv2.ellipse(mask, (width // 2, height // 2), (18, 15), 0, 0, 360, 1, -1)
    cv2.line(mask, (width // 2 - 8, height // 2), (width // 2 - 22, 14), 1, 7)
    cv2.line(mask, (width // 2 + 8, height // 2), (width // 2 + 16, 12), 1, 7)
    cv2.rectangle(mask, (width // 2 - 9, height // 2), (width // 2 + 9, height - 1), 1, -1)
    return mask


def painted(mask: np.ndarray, hand: tuple[int, int, int], around: tuple[int, int, int]) -> np.ndarray:
    return np.where(mask[..., None] > 0, np.uint8(hand), np.uint8(around)).astype(np.uint8)


@pytest.mark.parametrize("method", [*GEOMETRIC, GEOMETRIC], ids=lambda m: m if isinstance(m, str) else "all")
def test_image_and_mask_stay_together_under_every_geometric_method(method) -> None:
    mask = hand_shape()
    chosen = only(*((method,) if isinstance(method, str) else method))
    hand = cut_out(painted(mask, (255, 0, 0), (0, 0, 255)), mask, chosen)
    moved = 0
    for variant in range(12):
        made = augment("red", hand, variant, Backgrounds(), chosen)
        red, blue = made.image[..., 0].astype(int), made.image[..., 2].astype(int)
        clear = np.abs(red - blue) > 2  # beyond rounding at pixels half covered
        np.testing.assert_array_equal(made.mask[clear] == 1, red[clear] > blue[clear])
        assert clear.mean() > 0.98
        assert 0.02 < made.mask.mean() < 0.9
        moved += not np.array_equal(made.mask, cv2.resize(mask, (64, 48), interpolation=cv2.INTER_NEAREST))
    assert moved > 6


@given(variant=st.integers(0, 10**6))
@settings(max_examples=25, deadline=None)
def test_nothing_of_the_old_surroundings_survives(variant: int) -> None:
    """Two originals that differ in their surroundings alone give the same new image, bit by bit.

    The edges are soft, as a camera makes them: the surroundings color the hand's outermost pixels.
    """
    mask = hand_shape()
    made = []
    for around in ((0, 255, 0), (255, 0, 255)):
        soft = cv2.blur(painted(mask, (200, 150, 120), around), (3, 3))
        made.append(augment("x", cut_out(soft, mask, SMALL), variant, Backgrounds(), SMALL))
    np.testing.assert_array_equal(made[0].image, made[1].image)
    np.testing.assert_array_equal(made[0].mask, made[1].mask)


def test_a_hand_inside_the_picture_appears_once_and_whole() -> None:
    """No reflected border makes a second hand: area changes by the drawn scale alone, in one piece."""
    mask = np.zeros((96, 128), np.uint8)
    cv2.circle(mask, (64, 48), 14, 1, -1)
    chosen = only("background", "flip", "rotation", "color", "noise", "random_erase")
    hand = cut_out(painted(mask, (200, 150, 120), (90, 90, 90)), mask, chosen)
    assert hand.arm is None
    for variant in range(30):
        made = augment("disc", hand, variant, Backgrounds(), chosen)
        assert cv2.connectedComponents(made.mask)[0] == 2
        assert made.mask.sum() == pytest.approx(mask.sum() / 4, rel=0.03)


@given(angle_rad=st.floats(-0.5, 0.5), scale=st.floats(0.5, 1.0))
@settings(max_examples=30, deadline=None)
def test_an_arm_goes_on_in_its_own_direction(angle_rad: float, scale: float) -> None:
    """A straight bar leaving the image is continued as the same bar: its axis and, nearly, its width."""
    mask = np.zeros((96, 128), np.uint8)
    axis = np.array([math.sin(angle_rad), math.cos(angle_rad)])
    start = np.array([64.0, 30.0])
    end = start + 200 * axis
    cv2.line(mask, tuple(np.rint(start).astype(int).tolist()), tuple(np.rint(end).astype(int).tolist()), 1, 16)
    cv2.circle(mask, (64, 30), 20, 1, -1)
    arm = Arm.of(mask)
    assert arm is not None
    assert arm.direction @ axis > math.cos(0.2)
    beyond = arm.crossing + np.float32(60 * scale) * arm.direction
    on_axis = arm.continued(beyond[None].astype(np.float32), 128, 96)[0]
    assert np.hypot(*(on_axis - arm.crossing)) < 3.0
    aside = beyond + np.float32(1.5 * arm.width) * np.array([arm.direction[1], -arm.direction[0]])
    assert (arm.continued(aside[None].astype(np.float32), 128, 96)[0] < 0).any()


def test_an_arm_reaches_the_border_of_every_new_image_or_ends_in_a_sleeve() -> None:
    mask = hand_shape()
    hand = cut_out(painted(mask, (200, 150, 120), (90, 90, 90)), mask, SMALL)
    chosen = only("background", "flip", "rotation", "cropping")
    sleeves = 0
    for variant in range(40):
        made = augment("arm", hand, variant, Backgrounds(), chosen)
        border = np.concatenate([made.mask[0], made.mask[-1], made.mask[:, 0], made.mask[:, -1]])
        sleeved = "sleeve" in made.recipe["operations"][0]
        assert border.any() or sleeved
        sleeves += sleeved
    assert 5 < sleeves < 35


def test_a_finger_severed_by_the_border_is_not_left_floating() -> None:
    mask = hand_shape()
    cv2.rectangle(mask, (2, 80), (10, 95), 1, -1)
    hand = cut_out(painted(mask, (200, 150, 120), (90, 90, 90)), mask, SMALL)
    assert hand.alpha[85, 6] == 0
    assert hand.alpha[48, 64] == 1


def test_each_method_comes_half_of_the_time_and_independently() -> None:
    """1000 images: every count and every joint count within five standard deviations of the binomial."""
    chosen = [chosen_methods(image_seed(f"train_{i // 20:03d}", i % 20, 0), SMALL) for i in range(1000)]
    assert all(names[0] == "background" for names in chosen)
    assert all(tuple(name for name in METHOD_NAMES if name in names) == names for names in chosen)
    table = np.array([[name in names for name in METHOD_NAMES[1:]] for names in chosen])
    assert np.all(np.abs(table.sum(0) - 500) < 5 * math.sqrt(1000 * 0.25))
    joint = table.T.astype(int) @ table
    pairs = joint[~np.eye(7, dtype=bool)]
    assert np.all(np.abs(pairs - 250) < 5 * math.sqrt(1000 * 0.25 * 0.75))
    assert len(set(chosen)) > 120  # of 128 combinations


def test_the_recipe_names_what_was_chosen_and_is_json() -> None:
    mask = hand_shape()
    hand = cut_out(painted(mask, (200, 150, 120), (90, 90, 90)), mask, SMALL)
    for variant in range(20):
        recipe = augment("id", hand, variant, Backgrounds(), SMALL).recipe
        names = tuple(step["method"] for step in recipe["operations"])
        assert names == chosen_methods(recipe["seed"], SMALL)
        assert json.loads(json.dumps(recipe)) == recipe
        assert recipe["seed"] == image_seed("id", variant, SMALL.seed)


@pytest.mark.parametrize("method", METHOD_NAMES[1:])
def test_leaving_one_method_out_leaves_the_draws_of_the_others(method: str) -> None:
    mask = hand_shape()
    hand = cut_out(painted(mask, (200, 150, 120), (90, 90, 90)), mask, SMALL)
    always = dataclasses.replace(SMALL, probability=1.0)
    without = dataclasses.replace(always, left_out=(method,))
    full = augment("id", hand, 3, Backgrounds(), always).recipe["operations"]
    less = augment("id", hand, 3, Backgrounds(), without).recipe["operations"]
    unaffected = [step for step in full if step["method"] not in (method, "background", "random_erase")]
    assert [step for step in less if step["method"] not in ("background", "random_erase")] == unaffected


def test_variants_differ_and_repeat_exactly() -> None:
    mask = hand_shape()
    hand = cut_out(painted(mask, (200, 150, 120), (90, 90, 90)), mask, SMALL)
    again = cut_out(painted(mask, (200, 150, 120), (90, 90, 90)), mask, SMALL)
    digests = [augment("id", hand, v, Backgrounds(), SMALL).recipe["digest"] for v in range(12)]
    assert len(set(digests)) == 12
    assert [augment("id", again, v, Backgrounds(), SMALL).recipe["digest"] for v in range(12)] == digests
    other = dataclasses.replace(SMALL, seed=1)
    assert augment("id", hand, 0, Backgrounds(), other).recipe["digest"] != digests[0]


@given(height=st.integers(40, 700), width=st.integers(40, 700))
@settings(max_examples=15, deadline=None)
def test_originals_of_any_size_give_images_of_the_stored_size(height: int, width: int) -> None:
    mask = np.zeros((height, width), np.uint8)
    mask[height // 4 :, width // 4 : width // 2] = 1
    made = augment("any", cut_out(painted(mask, (200, 150, 120), (9, 9, 9)), mask, SMALL), 0, Backgrounds(), SMALL)
    assert made.image.shape == (48, 64, 3)
    assert made.mask.shape == (48, 64)
    assert made.image.dtype == made.mask.dtype == np.uint8
    assert set(np.unique(made.mask)) <= {0, 1}


@given(seed=st.integers(0, 2**32), x=st.integers(5, 80), y=st.integers(5, 60))
@settings(max_examples=50, deadline=None)
def test_erased_boxes_are_a_tenth_to_three_tenths_of_each_side_and_aim_at_the_hand(seed: int, x: int, y: int) -> None:
    mask = np.zeros((100, 120), np.uint8)
    mask[y : y + 20, x : x + 30] = 1
    picture = np.zeros((100, 120, 3), np.uint8)
    erased, drawn = erase(np.random.default_rng(seed), picture, mask)
    left, top, width, height = drawn["box_px"]
    assert 12 <= width <= 36
    assert 10 <= height <= 30
    outside = np.ones(mask.shape, bool)
    outside[top : top + height, left : left + width] = False
    assert not erased[outside].any()
    assert erased[~outside].std() > 50
    assert not picture.any()
    # the box was centered in the hand's bounding box before it was pushed inside the picture
    assert left <= x + 30
    assert left + width >= x
    assert top <= y + 20
    assert top + height >= y


@given(tone=st.integers(0, N_TONES - 1))
@settings(deadline=None)
def test_recolored_skin_has_the_mean_of_its_tone_and_keeps_its_relief(tone: int) -> None:
    rng = np.random.default_rng(tone)
    relief = cv2.GaussianBlur(rng.standard_normal((40, 40)).astype(np.float32), (0, 0), 3)
    skin = np.clip(np.float32([0.78, 0.6, 0.5]) * (1 + 0.3 * relief[..., None]), 0, 1)
    alpha = np.ones((40, 40), np.float32)
    changed = recolor(skin, alpha, tone_lab(tone), 1.0, 1.0)
    lab = cv2.cvtColor(changed, cv2.COLOR_RGB2LAB)
    assert np.abs(lab.mean((0, 1)) - tone_lab(tone)).max() < 2.5
    assert np.corrcoef(lab[..., 0].ravel(), relief.ravel())[0, 1] > 0.97


def test_tones_go_from_dark_to_light_within_human_skin() -> None:
    tones = np.array([tone_lab(tone) for tone in range(N_TONES)])
    assert np.all(np.diff(tones[:, 0]) > 0)
    assert tones[0, 0] < 22
    assert tones[-1, 0] > 80
    assert np.all(tones[:, 1:] > 0)  # skin is red and yellow, never green or blue


def test_backgrounds_are_read_once_and_named(tmp_path) -> None:
    with pytest.raises(DataError, match="is not a folder"):
        Backgrounds.load(tmp_path / "none")
    with pytest.raises(DataError, match="holds no picture"):
        Backgrounds.load(tmp_path)
    assert cv2.imwrite(str(tmp_path / "b.png"), np.full((30, 20, 3), 9, np.uint8))
    assert cv2.imwrite(str(tmp_path / "a.jpg"), np.full((50, 400, 3), 9, np.uint8))
    backgrounds = Backgrounds.load(tmp_path)
    assert backgrounds.names == ("a.jpg", "b.png")
    mask = hand_shape()
    hand = cut_out(painted(mask, (200, 150, 120), (90, 90, 90)), mask, SMALL)
    sources = {augment("x", hand, v, backgrounds, SMALL).recipe["operations"][0]["source"] for v in range(40)}
    assert {"a.jpg", "b.png"} < sources


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"n_variants": 0}, "n_variants is 0"),
        ({"width": 8}, "width is 8"),
        ({"height": 8}, "height is 8"),
        ({"probability": 1.5}, "probability is 1.5"),
        ({"supersampling": 0}, "supersampling is 0"),
        ({"seed": -1}, "seed is -1"),
        ({"left_out": ("nose",)}, "nose"),
    ],
)
def test_settings_outside_their_domain_are_refused(changes: dict, says: str) -> None:
    with pytest.raises(SettingsError, match=says):
        AugmentationSettings(**changes)


def test_every_public_name_exists_and_settings_need_no_opencv() -> None:
    import deltasafe.perception.data.augmentation as package

    assert all(getattr(package, name).__name__ == name for name in package.__all__ if name != "METHOD_NAMES")
    with pytest.raises(AttributeError, match="nothing"):
        _ = package.nothing
    asked_for = "from deltasafe.perception.data.augmentation import AugmentationSettings"
    program = f"import sys; {asked_for}; assert 'cv2' not in sys.modules"
    subprocess.run([sys.executable, "-c", program], check=True, cwd=pathlib.Path(__file__).parents[4])
