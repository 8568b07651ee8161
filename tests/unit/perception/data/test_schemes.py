"""The compared schemes: number of images, alignment of image and mask, and the properties of each scheme."""

import pathlib

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch.nn import functional

from deltasafe.errors import DataError, SettingsError
from deltasafe.perception.data.augmented_set import AugmentedSet, augment_images
from deltasafe.perception.data.labeled_images import LabeledImageSet
from deltasafe.perception.data.schemes import (
    SCHEMES,
    ComparedSettings,
    CutoutSettings,
    FlipRotate90Settings,
    FlipRotateCropSettings,
    MixupSettings,
    scheme_name,
)
from deltasafe.perception.data.schemes.cutout import cutout
from deltasafe.perception.data.schemes.flip_rotate90 import apply_symmetry, flip_rotate90, pad_to_square
from deltasafe.perception.data.schemes.flip_rotate_crop import crop_matrix, flip_rotate_crop
from deltasafe.perception.data.schemes.mixup import mixup
from deltasafe.perception.data.schemes.originals import Originals, crop_and_resize

DATASETS = pathlib.Path(__file__).parents[4] / "datasets"
COMPARED = [name for name in SCHEMES if name != "ours"]
WIDTH, HEIGHT = 96, 72
SEEDS = st.integers(0, 2**32 - 1)


def is_hand(x, y):
    """Mask of a coordinate image."""
    return (x + 2 * y > 70).astype(np.uint8)


def coordinate_images(n: int = 3) -> Originals:
    """Images whose red and green are the pixel's x and y, and whose blue is the number of the image."""
    x, y = np.meshgrid(np.arange(WIDTH), np.arange(HEIGHT))
    images = np.stack([np.stack([x, y, np.full_like(x, 200 + i)], axis=-1) for i in range(n)]).astype(np.uint8)
    return Originals(tuple(f"image_{i}" for i in range(n)), images, np.stack([is_hand(x, y)] * n))


ORIGINALS = coordinate_images()


@given(SEEDS, st.floats(0.05, 1.0))
@settings(max_examples=60, deadline=None)
def test_cutout_fills_the_clipped_square_and_keeps_the_mask(seed: int, side: float) -> None:
    chosen = CutoutSettings(width=WIDTH, height=HEIGHT, side=side)
    image, mask, (done,) = cutout(ORIGINALS, 1, chosen, np.random.default_rng(seed))
    np.testing.assert_array_equal(mask, ORIGINALS.masks[1])
    length = round(side * HEIGHT)
    assert done["side"] == length
    rows, columns = np.arange(HEIGHT)[:, None], np.arange(WIDTH)
    top, left = done["top"], done["left"]
    hidden = (rows >= top) & (rows < top + length) & (columns >= left) & (columns < left + length)
    assert hidden.any() or length == 0
    # no pixel of a coordinate image has the mean color in all three channels
    assert not (ORIGINALS.images == ORIGINALS.mean_color).all(axis=-1)[0].any()
    np.testing.assert_array_equal(image[hidden], np.broadcast_to(ORIGINALS.mean_color, (hidden.sum(), 3)))
    np.testing.assert_array_equal(image[~hidden], ORIGINALS.images[1][~hidden])


def test_cutout_centers_are_uniform_over_the_image() -> None:
    chosen = CutoutSettings(width=WIDTH, height=HEIGHT)
    drawn = [cutout(ORIGINALS, 0, chosen, np.random.default_rng(seed))[2][0] for seed in range(4000)]
    tops = np.array([done["top"] for done in drawn]) + HEIGHT // 4
    assert {done["side"] for done in drawn} == {HEIGHT // 2}
    assert (tops.min(), tops.max()) == (0, HEIGHT - 1)
    assert abs(tops.mean() - (HEIGHT - 1) / 2) < 4 * HEIGHT / np.sqrt(12 * 4000)
    assert round(CutoutSettings(side=0.25).side * 144) == 36


@given(SEEDS, st.floats(0.05, 4.0), st.integers(0, 2))
@settings(max_examples=60, deadline=None)
def test_mixup_blends_images_and_labels_with_the_same_weight(seed: int, alpha: float, i: int) -> None:
    chosen = MixupSettings(width=WIDTH, height=HEIGHT, alpha=alpha)
    image, mask, (done,) = mixup(ORIGINALS, i, chosen, np.random.default_rng(seed))
    j, share = ORIGINALS.ids.index(done["partner"]), done["share"]
    assert j != i
    assert 0.0 <= share <= 1.0
    pair = ORIGINALS.images[[i, j]].astype(int)
    assert (image >= pair.min(axis=0)).all()
    assert (image <= pair.max(axis=0)).all()
    np.testing.assert_allclose(image, share * pair[0] + (1 - share) * pair[1], atol=0.5 + 1e-9)
    assert mask.dtype == np.uint16
    exact = share * ORIGINALS.masks[i] + (1 - share) * ORIGINALS.masks[j]
    np.testing.assert_allclose(mask / 65535, exact, atol=0.5 / 65535 + 1e-12)


def test_mixup_partner_is_any_other_original() -> None:
    chosen = MixupSettings(width=WIDTH, height=HEIGHT)
    partners = {mixup(ORIGINALS, 1, chosen, np.random.default_rng(seed))[2][0]["partner"] for seed in range(50)}
    assert partners == {"image_0", "image_2"}


def test_cross_entropy_of_a_soft_mask_is_the_weighted_sum_of_both_losses() -> None:
    logits, share = torch.randn(5, 7, generator=torch.Generator().manual_seed(0)), 0.3
    first, second = torch.zeros(5, 7), torch.ones(5, 7)
    second[2:] = 0
    loss = functional.binary_cross_entropy_with_logits
    mixed = share * loss(logits, first) + (1 - share) * loss(logits, second)
    torch.testing.assert_close(loss(logits, share * first + (1 - share) * second), mixed)


@given(SEEDS)
@settings(max_examples=30, deadline=None)
def test_flip_and_quarter_turns_move_image_and_mask_alike(seed: int) -> None:
    chosen = FlipRotate90Settings(width=WIDTH, height=HEIGHT)
    image, mask, _ = flip_rotate90(ORIGINALS, 2, chosen, np.random.default_rng(seed))
    assert image.shape == (WIDTH, WIDTH, 3)
    np.testing.assert_array_equal(mask, is_hand(image[..., 0].astype(int), image[..., 1].astype(int)))
    found, times = np.unique(image.reshape(-1, 3), axis=0, return_counts=True)
    assert len(found) == WIDTH * HEIGHT, "no pixel of the original is lost"
    assert set(times) == {1, 13}, "the border is repeated in 12 rows on each side"


def test_symmetries_form_a_group_of_eight() -> None:
    square = pad_to_square(ORIGINALS.images[0])
    elements = [(flipped, turns) for flipped in (False, True) for turns in range(4)]
    group = {apply_symmetry(square, *element).tobytes() for element in elements}
    assert len(group) == 8
    for first in elements:
        for second in elements:
            assert apply_symmetry(apply_symmetry(square, *first), *second).tobytes() in group


def test_all_eight_symmetries_are_drawn_equally_often() -> None:
    chosen = FlipRotate90Settings(width=WIDTH, height=HEIGHT)
    drawn = [flip_rotate90(ORIGINALS, 0, chosen, np.random.default_rng(seed))[0].tobytes() for seed in range(800)]
    counts = [drawn.count(one) for one in set(drawn)]
    assert len(counts) == 8
    assert min(counts) > 60, "expected are 100 each, with a standard deviation of 9"


@given(SEEDS, st.integers(1, 2))
@settings(max_examples=40, deadline=None)
def test_flip_rotation_and_crop_move_image_and_mask_alike(seed: int, supersampling: int) -> None:
    chosen = FlipRotateCropSettings(
        width=WIDTH // supersampling, height=HEIGHT // supersampling, supersampling=supersampling
    )
    image, mask, (flip, rotation, crop) = flip_rotate_crop(ORIGINALS, 0, chosen, np.random.default_rng(seed))
    assert image.shape == (chosen.height, chosen.width, 3)
    assert abs(rotation["angle_deg"]) <= 30
    assert 0.7 <= crop["side"] <= 1
    assert crop["x"] + crop["side"] <= 1 + 1e-12
    assert crop["y"] + crop["side"] <= 1 + 1e-12
    red, green = image[..., 0].astype(float), image[..., 1].astype(float)
    distance = np.abs(red + 2 * green - 70.5)
    sure = distance > 3 * supersampling
    np.testing.assert_array_equal(mask[sure], is_hand(red, green)[sure])
    # the source of each pixel, step by step: crop, rotation about the center, mirroring
    x, y = np.meshgrid(np.arange(chosen.width), np.arange(chosen.height))
    x, y = (supersampling * (axis + 0.5) for axis in (x, y))
    x, y = x * crop["side"] + crop["x"] * WIDTH - WIDTH / 2, y * crop["side"] + crop["y"] * HEIGHT - HEIGHT / 2
    angle = np.deg2rad(rotation["angle_deg"])
    x, y = np.cos(angle) * x - np.sin(angle) * y, np.sin(angle) * x + np.cos(angle) * y
    x, y = (-x if flip["applied"] else x) + WIDTH / 2 - 0.5, y + HEIGHT / 2 - 0.5
    inside = (x > 1) & (x < WIDTH - 2) & (y > 1) & (y < HEIGHT - 2)
    assert np.abs(red - x)[inside].max() < 1.1
    assert np.abs(green - y)[inside].max() < 1.1


def test_crop_of_the_whole_image_is_the_identity() -> None:
    np.testing.assert_allclose(crop_matrix((64, 48), False, 0.0, 1.0, (0.0, 0.0)), np.eye(2, 3), atol=1e-12)
    mirrored = crop_matrix((64, 48), True, 0.0, 1.0, (0.0, 0.0))
    np.testing.assert_allclose(mirrored @ [0, 5, 1], [63, 5])
    assert np.linalg.det(crop_matrix((64, 48), True, 20.0, 0.8, (0.1, 0.2))[:, :2]) == pytest.approx(-0.64)


def test_resizing_averages_over_areas() -> None:
    rgb = np.arange(8 * 12 * 3, dtype=np.uint8).reshape(8, 12, 3)
    mask = np.zeros((8, 12), np.uint8)
    mask[:, :5] = 1
    small, small_mask = crop_and_resize(rgb, mask, 6, 4)
    np.testing.assert_allclose(small, rgb.reshape(4, 2, 6, 2, 3).mean(axis=(1, 3)), atol=0.51)
    np.testing.assert_array_equal(small_mask, [[1, 1, 1, 0, 0, 0]] * 4)


@pytest.mark.parametrize(("marked", "first"), [((0, 5), 0), ((5, 7), 2), ((10, 12), 4), ((0, 0), 2)])
def test_crop_of_another_aspect_ratio_is_around_the_hand(marked: tuple[int, int], first: int) -> None:
    rgb = np.arange(8 * 12 * 3, dtype=np.uint8).reshape(8, 12, 3)
    mask = np.zeros((8, 12), np.uint8)
    mask[:, slice(*marked)] = 1
    square, _ = crop_and_resize(rgb, mask, 4, 4)
    expected = rgb[:, first : first + 8].reshape(4, 2, 4, 2, 3).mean(axis=(1, 3))
    np.testing.assert_allclose(square, expected, atol=0.51)


@pytest.mark.parametrize("name", COMPARED)
def test_stored_set_is_complete_and_reproducible(
    name: str, three_images: LabeledImageSet, tmp_path: pathlib.Path
) -> None:
    chosen = SCHEMES[name](n_variants=4, width=64, height=48)
    made = augment_images(three_images, tmp_path / "set", chosen, workers=1)
    assert (made.n, made.settings) == (12, chosen)
    assert [r["source"] for r in made.recipes] == [item.id for item in three_images.items for _ in range(4)]
    made.verify()
    again = augment_images(three_images, tmp_path / "again", chosen, DATASETS / "backgrounds", workers=1)
    assert again.digest == made.digest, "the compared schemes ignore backgrounds"
    np.testing.assert_array_equal(again.images, made.images)
    reseeded = SCHEMES[name](n_variants=4, width=64, height=48, seed=1)
    other = augment_images(three_images, tmp_path / "other", reseeded, workers=1)
    assert other.digest != made.digest
    assert not np.array_equal(other.images, made.images)
    labels = made.labels(np.array([3, 0]))
    assert labels.dtype == np.float32
    assert labels.shape == (2, *made.images.shape[1:3])
    assert (labels.min(), labels.max()) == (0, 1)
    if name == "flip_rotate90":
        assert made.n_distinct <= 12
        assert made.images.shape == (12, 64, 64, 3)
    else:
        assert made.n_distinct == 12


def test_training_accepts_soft_labels(three_images: LabeledImageSet, tmp_path: pathlib.Path) -> None:
    from deltasafe.perception.settings import NetworkSettings, TrainingSettings
    from deltasafe.perception.training.train_member import train_member

    chosen = MixupSettings(n_variants=2, width=64, height=48, alpha=4.0)
    made = augment_images(three_images, tmp_path / "set", chosen, workers=1)
    labels = made.labels(slice(None))
    assert ((labels > 0.05) & (labels < 0.95)).any()
    np.testing.assert_allclose(labels, made.masks / 65535, atol=1e-7)
    training = TrainingSettings(NetworkSettings(pyramid_channels=16), epochs=1, batch_size=2)
    member = train_member(AugmentedSet.load(tmp_path / "set"), training, 0, tmp_path / "member", device="cpu")
    assert len(member.losses) == 3
    assert all(np.isfinite(member.losses))


def test_unknown_scheme_is_refused(three_images: LabeledImageSet, tmp_path: pathlib.Path) -> None:
    augment_images(three_images, tmp_path / "set", CutoutSettings(1, 64, 48), workers=1)
    text = (tmp_path / "set" / "set.json").read_text()
    (tmp_path / "set" / "set.json").write_text(text.replace('"scheme": "cutout"', '"scheme": "cutmix"'))
    with pytest.raises(DataError, match="unknown scheme 'cutmix'; known: cutout"):
        AugmentedSet.load(tmp_path / "set")


@pytest.mark.parametrize(
    ("kind", "value", "message"),
    [
        (CutoutSettings, {"side": 0.0}, r"^side must be .*, got 0.0$"),
        (CutoutSettings, {"n_variants": 0}, r"^n_variants must be .*, got 0$"),
        (MixupSettings, {"alpha": float("inf")}, r"^alpha must be .*, got inf$"),
        (FlipRotateCropSettings, {"smallest_crop": 1.5}, r"^smallest_crop must be .*, got 1.5$"),
        (FlipRotateCropSettings, {"largest_angle_deg": -1.0}, r"^largest_angle_deg must be .*, got -1.0$"),
        (FlipRotateCropSettings, {"supersampling": 0}, r"^supersampling must be .*, got 0$"),
        (FlipRotate90Settings, {"width": 8}, r"^width must be .*, got 8$"),
    ],
)
def test_settings_outside_their_range_are_refused(
    kind: type[ComparedSettings], value: dict[str, float], message: str
) -> None:
    with pytest.raises(SettingsError, match=message):
        kind(**value)


@pytest.mark.parametrize("name", SCHEMES)
def test_scheme_name_is_found_by_settings_class(name: str) -> None:
    assert scheme_name(SCHEMES[name]()) == name
