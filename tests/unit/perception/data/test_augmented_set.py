"""The stored set: the same bytes however it was made, checked when it is opened."""

import json
import pathlib
import shutil

import cv2
import numpy as np
import pytest

from deltasafe.errors import DataError, SettingsError
from deltasafe.perception.data.augmentation import METHOD_NAMES, AugmentationSettings, Backgrounds
from deltasafe.perception.data.augmented_set import AugmentedSet, augment_images, remake
from deltasafe.perception.data.contact_sheet import contact_sheet, scheme_sheet
from deltasafe.perception.data.labeled_images import LabeledImageSet

DATASETS = pathlib.Path(__file__).parents[4] / "datasets"
SETTINGS = AugmentationSettings(n_variants=4, width=64, height=48)
FILES = ("images.npy", "masks.npy", "recipes.jsonl", "set.json")


@pytest.fixture(scope="module")
def hands(tmp_path_factory: pytest.TempPathFactory) -> LabeledImageSet:
    folder = tmp_path_factory.mktemp("hands") / "three"
    for kind in ("images", "masks"):
        (folder / kind).mkdir(parents=True)
        for source in sorted((DATASETS / "hands" / "train" / kind).iterdir())[:3]:
            shutil.copy(source, folder / kind)
    return LabeledImageSet.load(folder)


@pytest.fixture(scope="module")
def made(hands: LabeledImageSet, tmp_path_factory: pytest.TempPathFactory) -> AugmentedSet:
    folder = tmp_path_factory.mktemp("augmented") / "set"
    return augment_images(hands, folder, SETTINGS, DATASETS / "backgrounds", workers=1)


@pytest.fixture
def copy(made: AugmentedSet, tmp_path: pathlib.Path) -> pathlib.Path:
    shutil.copytree(made.folder, tmp_path / "copy")
    return tmp_path / "copy"


def test_it_holds_every_variant_of_every_original_and_no_original(made: AugmentedSet, hands: LabeledImageSet) -> None:
    assert made.n == 12
    assert made.images.shape == (12, 48, 64, 3)
    assert made.masks.shape == (12, 48, 64)
    assert [(r["source"], r["variant"]) for r in made.recipes] == [
        (item.id, variant) for item in hands.items for variant in range(4)
    ]
    assert set(np.unique(made.masks)) == {0, 1}
    originals = [cv2.resize(hands.read(i)[0], (64, 48), interpolation=cv2.INTER_AREA) for i in range(3)]
    for image in made.images:
        assert all(np.abs(image.astype(int) - original.astype(int)).mean() > 5 for original in originals)
    assert not made.images.flags.writeable
    made.verify()


def test_the_number_of_processes_changes_no_byte(
    made: AugmentedSet, hands: LabeledImageSet, tmp_path: pathlib.Path
) -> None:
    told: list[tuple[int, int]] = []
    other = augment_images(
        hands,
        tmp_path / "two",
        SETTINGS,
        DATASETS / "backgrounds",
        workers=2,
        progress=lambda done, total, message: told.append((done, total)),
    )
    for name in FILES:
        assert (other.folder / name).read_bytes() == (made.folder / name).read_bytes(), name
    assert told == [(1, 3), (2, 3), (3, 3)]


def test_any_one_image_is_remade_alone_bit_by_bit(made: AugmentedSet, hands: LabeledImageSet) -> None:
    backgrounds = Backgrounds.load(DATASETS / "backgrounds")
    for i in (11, 2, 5):
        recipe = made.recipes[i]
        again = remake(hands, backgrounds, made.settings, recipe["source"], recipe["variant"])
        np.testing.assert_array_equal(again.image, made.images[i])
        np.testing.assert_array_equal(again.mask, made.masks[i])
        assert again.recipe == recipe
    with pytest.raises(DataError, match="holds no image 'nobody'"):
        remake(hands, backgrounds, made.settings, "nobody", 0)


def test_what_was_applied_is_counted(made: AugmentedSet) -> None:
    applied = json.loads((made.folder / "set.json").read_text())["applied"]
    assert set(applied) == set(METHOD_NAMES)
    assert applied["background"] == 12
    assert sum(applied.values()) == sum(len(recipe["operations"]) for recipe in made.recipes)


def test_without_a_folder_of_backgrounds_surfaces_are_procedural(
    hands: LabeledImageSet, tmp_path: pathlib.Path
) -> None:
    few = AugmentationSettings(n_variants=1, width=64, height=48)
    made = augment_images(hands, tmp_path / "set", few, workers=1)
    assert made.background_digest == ""
    assert all(not r["operations"][0]["source"].endswith(".jpg") for r in made.recipes)


def test_the_digest_follows_settings_and_backgrounds(
    made: AugmentedSet, hands: LabeledImageSet, tmp_path: pathlib.Path
) -> None:
    reseeded = AugmentationSettings(n_variants=4, width=64, height=48, seed=1)
    other = augment_images(hands, tmp_path / "set", reseeded, DATASETS / "backgrounds", workers=1)
    assert other.digest != made.digest


def test_a_failed_writing_leaves_nothing_behind(hands: LabeledImageSet, tmp_path: pathlib.Path) -> None:
    def stop(done: int, total: int, message: str) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        augment_images(hands, tmp_path / "set", SETTINGS, workers=1, progress=stop)
    with pytest.raises(SettingsError, match="workers is 0"):
        augment_images(hands, tmp_path / "set", SETTINGS, workers=0)
    with pytest.raises(DataError, match="is not a folder"):
        augment_images(hands, tmp_path / "set", SETTINGS, tmp_path / "none", workers=1)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("name", FILES)
def test_a_missing_file_is_named(copy: pathlib.Path, name: str) -> None:
    (copy / name).unlink()
    with pytest.raises(DataError) as caught:
        AugmentedSet.load(copy)
    assert caught.value.path == copy / name


def test_arrays_of_another_form_are_refused(copy: pathlib.Path) -> None:
    np.save(copy / "masks.npy", np.zeros((12, 48, 64), np.float32))
    with pytest.raises(DataError, match="float32"):
        AugmentedSet.load(copy)
    np.save(copy / "masks.npy", np.array([{"a": 1}], dtype=object), allow_pickle=True)
    with pytest.raises(DataError, match="cannot be opened"):
        AugmentedSet.load(copy)


def test_recipes_that_do_not_belong_are_refused(copy: pathlib.Path) -> None:
    lines = (copy / "recipes.jsonl").read_text().splitlines()
    (copy / "recipes.jsonl").write_text("\n".join(lines[:-1]))
    with pytest.raises(DataError, match="11 recipes for 12 images"):
        AugmentedSet.load(copy)
    lines[0] = lines[0].replace('"variant": 0', '"variant": 9')
    (copy / "recipes.jsonl").write_text("\n".join(lines))
    with pytest.raises(DataError, match="not that of its recipes"):
        AugmentedSet.load(copy)
    (copy / "recipes.jsonl").write_text("\n".join(["{", *lines[1:]]))
    with pytest.raises(DataError, match="line 1"):
        AugmentedSet.load(copy)


def test_another_format_is_refused(copy: pathlib.Path) -> None:
    (copy / "set.json").write_text('{"format": 99}')
    with pytest.raises(DataError, match="format 1"):
        AugmentedSet.load(copy)


def test_a_changed_pixel_is_found_by_verification(copy: pathlib.Path) -> None:
    images = np.lib.format.open_memmap(copy / "images.npy", mode="r+")
    images[7, 3, 3, 0] ^= 1
    images.flush()
    del images
    with pytest.raises(DataError, match="image 7 differs"):
        AugmentedSet.load(copy).verify()


def test_a_sheet_of_schemes_shows_images_of_each(made: AugmentedSet) -> None:
    figure = scheme_sheet({"One": made, "Other": made}, n_images=3)
    first = figure.axes[0]
    assert len(figure.axes) == 6
    assert first.get_title(loc="left") == f"One, {made.n_distinct} different of {made.n}"
    np.testing.assert_array_equal(first.images[0].get_array(), made.images[0])


def test_the_contact_sheet_is_a_picture_of_the_right_form(
    made: AugmentedSet, hands: LabeledImageSet, tmp_path: pathlib.Path
) -> None:
    sheet = contact_sheet(hands, made, tmp_path / "sheet.png", n_originals=2, n_variants=3)
    pixels = cv2.imread(str(sheet))
    assert pixels is not None
    assert pixels.shape[1] > 1.5 * pixels.shape[0]  # one original and three variants beside two rows
    assert pixels.std() > 20
    other = LabeledImageSet("other", hands.items, hands.pixel_digests, "0" * 64)
    with pytest.raises(DataError, match="was not made from"):
        contact_sheet(other, made, tmp_path / "other.png")
    assert not (tmp_path / "other.png").exists()
