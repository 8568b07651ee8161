"""Augmentation: image and mask stay aligned, the old background is gone, and every image is reproducible."""

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

from deltasafe.errors import SettingsError
from deltasafe.perception.data.augmentation import METHOD_NAMES, AugmentationSettings
from deltasafe.perception.data.augmentation.arm import Arm
from deltasafe.perception.data.augmentation.augment import augment, chosen_methods, cut_out_hand, image_seed
from deltasafe.perception.data.augmentation.background import Backgrounds
from deltasafe.perception.data.augmentation.hand_cutout import HandCutout
from deltasafe.perception.data.augmentation.noise import random_erase
from deltasafe.perception.data.augmentation.skin import N_TONES, recolor, tone_lab

SMALL = AugmentationSettings(width=64, height=48)
GEOMETRIC = ("flip", "rotation", "grid_distortion", "cropping")


def always_and_only(*methods: str) -> AugmentationSettings:
    left_out = tuple(name for name in METHOD_NAMES if name not in methods)
    return dataclasses.replace(SMALL, probability=1.0, left_out=left_out)


def hand_mask(height: int = 96, width: int = 128) -> np.ndarray:
    """A palm with two fingers, and an arm that crosses the lower border."""
    mask = np.zeros((height, width), np.uint8)
    cv2.ellipse(mask, (width // 2, height // 2), (18, 15), 0, 0, 360, 1, -1)
    cv2.line(mask, (width // 2 - 8, height // 2), (width // 2 - 22, 14), 1, 7)
    cv2.line(mask, (width // 2 + 8, height // 2), (width // 2 + 16, 12), 1, 7)
    cv2.rectangle(mask, (width // 2 - 9, height // 2), (width // 2 + 9, height - 1), 1, -1)
    return mask


def two_colors(mask: np.ndarray, hand: tuple[int, int, int], background: tuple[int, int, int]) -> np.ndarray:
    return np.where(mask[..., None] > 0, np.uint8(hand), np.uint8(background)).astype(np.uint8)


def skin_on_gray(mask: np.ndarray, chosen: AugmentationSettings = SMALL) -> HandCutout:
    return cut_out_hand(two_colors(mask, (200, 150, 120), (90, 90, 90)), mask, chosen)


@pytest.mark.parametrize("method", [*GEOMETRIC, GEOMETRIC], ids=lambda m: m if isinstance(m, str) else "all")
def test_geometric_methods_move_image_and_mask_alike(method) -> None:
    mask = hand_mask()
    chosen = always_and_only(*((method,) if isinstance(method, str) else method))
    hand = cut_out_hand(two_colors(mask, (255, 0, 0), (0, 0, 255)), mask, chosen)
    moved = 0
    for variant in range(12):
        made = augment("red", hand, variant, Backgrounds(), chosen)
        red, blue = made.image[..., 0].astype(int), made.image[..., 2].astype(int)
        clear = np.abs(red - blue) > 2  # without pixels that are half covered, where rounding decides
        np.testing.assert_array_equal(made.mask[clear] == 1, red[clear] > blue[clear])
        assert clear.mean() > 0.98
        assert 0.02 < made.mask.mean() < 0.9
        moved += not np.array_equal(made.mask, cv2.resize(mask, (64, 48), interpolation=cv2.INTER_NEAREST))
    assert moved > 6


@given(variant=st.integers(0, 10**6))
@settings(max_examples=25, deadline=None)
def test_old_background_does_not_affect_the_new_image(variant: int) -> None:
    """Soft edges mix the old background into the outermost pixels of the hand, as in a camera image."""
    mask = hand_mask()
    made = []
    for background in ((0, 255, 0), (255, 0, 255)):
        soft = cv2.blur(two_colors(mask, (200, 150, 120), background), (3, 3))
        made.append(augment("x", cut_out_hand(soft, mask, SMALL), variant, Backgrounds(), SMALL))
    np.testing.assert_array_equal(made[0].image, made[1].image)
    np.testing.assert_array_equal(made[0].mask, made[1].mask)


def test_hand_inside_the_image_appears_once_and_whole() -> None:
    """Reflection at the border would make a second hand."""
    mask = np.zeros((96, 128), np.uint8)
    cv2.circle(mask, (64, 48), 14, 1, -1)
    chosen = always_and_only("background", "flip", "rotation", "color", "noise", "random_erase")
    hand = skin_on_gray(mask, chosen)
    assert hand.arm is None
    for variant in range(30):
        made = augment("disc", hand, variant, Backgrounds(), chosen)
        assert cv2.connectedComponents(made.mask)[0] == 2
        assert made.mask.sum() == pytest.approx(mask.sum() / 4, rel=0.03)


@given(angle_rad=st.floats(-0.5, 0.5), scale=st.floats(0.5, 1.0))
@settings(max_examples=30, deadline=None)
def test_arm_continues_in_its_direction(angle_rad: float, scale: float) -> None:
    mask = np.zeros((96, 128), np.uint8)
    axis = np.array([math.sin(angle_rad), math.cos(angle_rad)])
    start = np.array([64.0, 30.0])
    end = start + 200 * axis
    cv2.line(mask, tuple(np.rint(start).astype(int).tolist()), tuple(np.rint(end).astype(int).tolist()), 1, 16)
    cv2.circle(mask, (64, 30), 20, 1, -1)
    arm = Arm.from_mask(mask)
    assert arm is not None
    assert arm.direction @ axis > math.cos(0.2)
    beyond = arm.crossing + np.float32(60 * scale) * arm.direction
    on_axis = arm.extend(beyond[None].astype(np.float32), 128, 96)[0]
    assert np.hypot(*(on_axis - arm.crossing)) < 3.0
    aside = beyond + np.float32(1.5 * arm.width_px) * np.array([arm.direction[1], -arm.direction[0]])
    assert (arm.extend(aside[None].astype(np.float32), 128, 96)[0] < 0).any()


def test_magnified_hand_shows_its_fingers() -> None:
    mask = hand_mask()
    rgb = two_colors(mask, (255, 0, 0), (0, 0, 255))
    rgb[:34][mask[:34] > 0] = (0, 255, 0)  # the fingers
    chosen = always_and_only("cropping")
    hand, largest = cut_out_hand(rgb, mask, chosen), 0.0
    for variant in range(60):
        made = augment("green", hand, variant, Backgrounds(), chosen)
        fingers = (made.image[..., 1].astype(int) > made.image[..., 0]) & (made.mask > 0)
        assert fingers.any()
        (cropping,) = made.recipe["operations"]
        largest = max(largest, cropping["scale"])
    assert largest > 2.0


def test_some_backgrounds_have_the_color_of_the_hand(monkeypatch: pytest.MonkeyPatch) -> None:
    def differences(share: float) -> np.ndarray:
        """Of a* and b* between the hand and the background, in each of 20 images."""
        monkeypatch.setattr("deltasafe.perception.data.augmentation.layers.P_SAME_COLOR", share)
        chosen, found = dataclasses.replace(always_and_only("background"), left_out=("clothing", *METHOD_NAMES[1:])), []
        hand = skin_on_gray(hand_mask(), chosen)
        for variant in range(20):
            made = augment("x", hand, variant, Backgrounds(), chosen)
            lab = cv2.cvtColor(made.image.astype(np.float32) / 255, cv2.COLOR_RGB2LAB)
            found.append(lab[made.mask > 0].mean(0)[1:] - lab[made.mask == 0].mean(0)[1:])
        return np.linalg.norm(found, axis=1)

    assert differences(1.0).max() < 20 < np.median(differences(0.0))


def test_arm_reaches_the_border_or_ends_in_a_sleeve() -> None:
    hand = skin_on_gray(hand_mask())
    chosen = always_and_only("background", "flip", "rotation", "cropping")
    sleeves = 0
    for variant in range(40):
        made = augment("arm", hand, variant, Backgrounds(), chosen)
        border = np.concatenate([made.mask[0], made.mask[-1], made.mask[:, 0], made.mask[:, -1]])
        sleeved = "sleeve" in made.recipe["operations"][0]
        assert border.any() or sleeved
        sleeves += sleeved
    assert 0 < sleeves < 40


def test_finger_cut_off_by_the_border_is_removed() -> None:
    mask = hand_mask()
    cv2.rectangle(mask, (2, 80), (10, 95), 1, -1)
    hand = skin_on_gray(mask)
    assert hand.alpha[85, 6] == 0
    assert hand.alpha[48, 64] == 1
    assert hand.background[80:, :12].max() < 0.6, "the finger is not left in the background either"


def test_second_hand_stays_in_image_and_mask() -> None:
    mask = np.zeros((96, 128), np.uint8)
    mask[30:, 10:50], mask[60:, 100:120] = 1, 1
    hand = skin_on_gray(mask)
    assert hand.alpha[75, 30] == 1
    assert hand.alpha[75, 110] == 1
    assert hand.background.max() < 0.6


def test_methods_are_chosen_with_probability_one_half_and_independently() -> None:
    """1000 images: every count and every joint count is within five standard deviations of the binomial."""
    chosen = [chosen_methods(image_seed(f"train_{i // 20:03d}", i % 20, 0), SMALL) for i in range(1000)]
    assert all(names[0] == "background" for names in chosen)
    assert all(tuple(name for name in METHOD_NAMES if name in names) == names for names in chosen)
    table = np.array([[name in names for name in METHOD_NAMES[1:]] for names in chosen])
    assert np.all(np.abs(table.sum(0) - 500) < 5 * math.sqrt(1000 * 0.25))
    joint = table.T.astype(int) @ table
    pairs = joint[~np.eye(7, dtype=bool)]
    assert np.all(np.abs(pairs - 250) < 5 * math.sqrt(1000 * 0.25 * 0.75))
    assert len(set(chosen)) > 120  # of 128 combinations


def test_recipe_names_the_chosen_methods_and_is_json() -> None:
    hand = skin_on_gray(hand_mask())
    for variant in range(20):
        recipe = augment("id", hand, variant, Backgrounds(), SMALL).recipe
        names = tuple(step["method"] for step in recipe["operations"])
        assert names == chosen_methods(recipe["seed"], SMALL)
        assert json.loads(json.dumps(recipe)) == recipe
        assert recipe["seed"] == image_seed("id", variant, SMALL.seed)


@pytest.mark.parametrize("method", METHOD_NAMES[1:])
def test_leaving_one_method_out_keeps_the_draws_of_the_others(method: str) -> None:
    hand = skin_on_gray(hand_mask())
    always = dataclasses.replace(SMALL, probability=1.0)
    without = dataclasses.replace(always, left_out=(method,))
    full = augment("id", hand, 3, Backgrounds(), always).recipe["operations"]
    less = augment("id", hand, 3, Backgrounds(), without).recipe["operations"]
    unaffected = [step for step in full if step["method"] not in (method, "background", "random_erase")]
    assert [step for step in less if step["method"] not in ("background", "random_erase")] == unaffected


def test_variants_differ_and_are_reproducible() -> None:
    hand = skin_on_gray(hand_mask())
    again = skin_on_gray(hand_mask())
    digests = [augment("id", hand, v, Backgrounds(), SMALL).recipe["digest"] for v in range(12)]
    assert len(set(digests)) == 12
    assert [augment("id", again, v, Backgrounds(), SMALL).recipe["digest"] for v in range(12)] == digests
    other = dataclasses.replace(SMALL, seed=1)
    assert augment("id", hand, 0, Backgrounds(), other).recipe["digest"] != digests[0]


@given(height=st.integers(40, 700), width=st.integers(40, 700))
@settings(max_examples=15, deadline=None)
def test_originals_of_any_size_give_the_stored_size(height: int, width: int) -> None:
    mask = np.zeros((height, width), np.uint8)
    mask[height // 4 :, width // 4 : width // 2] = 1
    made = augment("any", skin_on_gray(mask), 0, Backgrounds(), SMALL)
    assert made.image.shape == (48, 64, 3)
    assert made.mask.shape == (48, 64)
    assert made.image.dtype == made.mask.dtype == np.uint8
    assert set(np.unique(made.mask)) <= {0, 1}


@given(seed=st.integers(0, 2**32), x=st.integers(5, 80), y=st.integers(5, 60))
@settings(max_examples=50, deadline=None)
def test_erased_box_has_10_to_30_percent_of_each_side_and_is_at_the_hand(seed: int, x: int, y: int) -> None:
    mask = np.zeros((100, 120), np.uint8)
    mask[y : y + 20, x : x + 30] = 1
    image = np.zeros((100, 120, 3), np.uint8)
    erased, drawn = random_erase(np.random.default_rng(seed), image, mask)
    left, top, width, height = drawn["box_px"]
    assert 12 <= width <= 36
    assert 10 <= height <= 30
    outside = np.ones(mask.shape, bool)
    outside[top : top + height, left : left + width] = False
    assert not erased[outside].any()
    assert erased[~outside].std() > 50
    assert not image.any()
    # the center is drawn in the hand's bounding box, then the box is moved inside the image
    assert left <= x + 30
    assert left + width >= x
    assert top <= y + 20
    assert top + height >= y


@given(tone=st.integers(0, N_TONES - 1))
@settings(deadline=None)
def test_recolored_skin_has_the_mean_of_its_tone_and_keeps_its_shading(tone: int) -> None:
    rng = np.random.default_rng(tone)
    shading = cv2.GaussianBlur(rng.standard_normal((40, 40)).astype(np.float32), (0, 0), 3)
    skin = np.clip(np.float32([0.78, 0.6, 0.5]) * (1 + 0.3 * shading[..., None]), 0, 1)
    alpha = np.ones((40, 40), np.float32)
    changed = recolor(skin, alpha, tone_lab(tone), 1.0, 1.0)
    lab = cv2.cvtColor(changed, cv2.COLOR_RGB2LAB)
    assert np.abs(lab.mean((0, 1)) - tone_lab(tone)).max() < 2.5
    assert np.corrcoef(lab[..., 0].ravel(), shading.ravel())[0, 1] > 0.97


def test_tones_go_from_dark_to_light_and_are_red_and_yellow() -> None:
    tones = np.array([tone_lab(tone) for tone in range(N_TONES)])
    assert np.all(np.diff(tones[:, 0]) > 0)
    assert tones[0, 0] < 22
    assert tones[-1, 0] > 80
    assert np.all(tones[:, 1:] > 0)


def photographed(width: int, height: int, hand: tuple[int, int, int, int]) -> tuple[np.ndarray, np.ndarray]:
    """An image of noise with a hand of one color; its box is left, top, right, bottom."""
    rgb = np.random.default_rng(1).integers(0, 90, (height, width, 3), dtype=np.uint8)
    mask = np.zeros((height, width), np.uint8)
    mask[hand[1] : hand[3], hand[0] : hand[2]] = 1
    rgb[mask > 0] = (220, 160, 130)
    return rgb, mask


@pytest.mark.parametrize(
    ("width", "height", "hand"),
    [
        (270, 480, (90, 380, 180, 470)),  # a phone held upright, the hand low
        (270, 480, (90, 10, 180, 100)),
        (270, 480, (100, 150, 170, 480)),  # a forearm longer than the canvas is high
        (960, 200, (20, 50, 120, 150)),  # a panorama
        (960, 200, (860, 40, 960, 140)),
    ],
)
def test_hand_stays_in_the_image_whatever_the_aspect_ratio(width: int, height: int, hand: tuple) -> None:
    cutout = cut_out_hand(*photographed(width, height, hand), SMALL)
    made = [augment("phone", cutout, variant, Backgrounds(), SMALL) for variant in range(40)]
    assert np.mean([image.mask.any() for image in made]) >= 0.95
    plain = dataclasses.replace(SMALL, probability=0.0)
    assert 0.02 < augment("phone", cutout, 0, Backgrounds(), plain).mask.mean() < 0.6


def test_long_forearm_leaves_the_hand_in_the_crop() -> None:
    """The crop shows the end of the bounding box that is opposite to the arm."""
    rgb, mask = photographed(120, 600, (40, 200, 80, 600))
    cutout = cut_out_hand(rgb, mask, SMALL)
    scale = cutout.alpha.shape[1] / 120
    crop_px = np.array([cutout.alpha.shape[1], 90.0 * scale])
    np.testing.assert_allclose(cutout.focus(crop_px)[1] - crop_px[1] / 2, 200 * scale, atol=2)


def test_image_without_a_hand_keeps_its_background() -> None:
    rgb, mask = photographed(64, 48, (0, 0, 0, 0))
    plain = dataclasses.replace(SMALL, probability=0.0)
    cutout = cut_out_hand(rgb, mask, SMALL)
    made = augment("table", cutout, 0, Backgrounds(), plain)
    assert not made.mask.any()
    assert made.recipe["operations"] == []
    canvas = cv2.resize(rgb, (SMALL.width, SMALL.height), interpolation=cv2.INTER_AREA)
    assert np.abs(made.image.astype(int) - canvas).mean() < 12
    for variant in range(30):
        made = augment("table", cutout, variant, Backgrounds(), SMALL)
        assert not made.mask.any()
        assert "background" not in [step["method"] for step in made.recipe["operations"]]


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"n_variants": 0}, r"^n_variants must be .*, got 0$"),
        ({"width": 8}, r"^width must be .*, got 8$"),
        ({"height": 8}, r"^height must be .*, got 8$"),
        ({"probability": 1.5}, r"^probability must be .*, got 1.5$"),
        ({"supersampling": 0}, r"^supersampling must be .*, got 0$"),
        ({"seed": -1}, r"^seed must be .*, got -1$"),
        ({"left_out": ("nose",)}, "nose"),
    ],
)
def test_settings_outside_their_range_are_refused(changes: dict, message: str) -> None:
    with pytest.raises(SettingsError, match=message):
        AugmentationSettings(**changes)


@pytest.mark.parametrize("package", ["augmentation", "schemes"])
def test_settings_do_not_import_opencv(package: str) -> None:
    program = f"import sys; import deltasafe.perception.data.{package}; assert 'cv2' not in sys.modules"
    subprocess.run([sys.executable, "-c", program], check=True, cwd=pathlib.Path(__file__).parents[4])
