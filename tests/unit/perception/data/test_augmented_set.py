"""The stored augmented set: its content does not depend on the processes, and it is checked when it is loaded."""

import json
import multiprocessing
import pathlib
import shutil

import cv2
import numpy as np
import pytest

from deltasafe.compute.executor import LocalExecutor
from deltasafe.errors import DataError, SettingsError
from deltasafe.perception.data import augmented_set
from deltasafe.perception.data.augmentation import METHOD_NAMES, AugmentationSettings
from deltasafe.perception.data.augmentation.augment import augment, cut_out_hand
from deltasafe.perception.data.augmentation.background import Backgrounds
from deltasafe.perception.data.augmented_set import AugmentedSet, augment_images
from deltasafe.perception.data.contact_sheet import contact_sheet, scheme_sheet
from deltasafe.perception.data.labeled_images import LabeledImageSet

BACKGROUNDS = pathlib.Path(__file__).parents[4] / "datasets" / "backgrounds"
SETTINGS = AugmentationSettings(n_variants=4, width=64, height=48)
FILES = ("images.npy", "masks.npy", "recipes.jsonl", "set.json")


@pytest.fixture(scope="module")
def stored(three_images: LabeledImageSet, tmp_path_factory: pytest.TempPathFactory) -> AugmentedSet:
    folder = tmp_path_factory.mktemp("augmented") / "set"
    return augment_images(three_images, folder, SETTINGS, BACKGROUNDS, workers=1)


@pytest.fixture
def copy(stored: AugmentedSet, tmp_path: pathlib.Path) -> pathlib.Path:
    shutil.copytree(stored.folder, tmp_path / "copy")
    return tmp_path / "copy"


def assert_same_files(one: AugmentedSet, other: AugmentedSet) -> None:
    for name in FILES:
        assert (one.folder / name).read_bytes() == (other.folder / name).read_bytes(), name


def test_set_has_all_variants_and_no_original(stored: AugmentedSet, three_images: LabeledImageSet) -> None:
    assert stored.n == 12
    assert stored.images.shape == (12, 48, 64, 3)
    assert stored.masks.shape == (12, 48, 64)
    assert [(r["source"], r["variant"]) for r in stored.recipes] == [
        (item.id, variant) for item in three_images.items for variant in range(4)
    ]
    assert set(np.unique(stored.masks)) == {0, 1}
    originals = [cv2.resize(three_images.read(i)[0], (64, 48), interpolation=cv2.INTER_AREA) for i in range(3)]
    for image in stored.images:
        assert all(np.abs(image.astype(int) - original.astype(int)).mean() > 5 for original in originals)
    assert not stored.images.flags.writeable
    stored.verify()


def test_number_of_workers_changes_no_byte(
    stored: AugmentedSet, three_images: LabeledImageSet, tmp_path: pathlib.Path
) -> None:
    reports: list[tuple[int, int]] = []
    other = augment_images(
        three_images,
        tmp_path / "two",
        SETTINGS,
        BACKGROUNDS,
        workers=2,
        progress=lambda done, total, message: reports.append((done, total)),
    )
    assert_same_files(other, stored)
    assert reports == [(1, 3), (2, 3), (3, 3)]


def test_order_in_which_tasks_end_changes_no_byte(
    stored: AugmentedSet,
    three_images: LabeledImageSet,
    tmp_path: pathlib.Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    class Reversed(LocalExecutor):
        def run(self, tasks, workers, *arguments):
            yield from reversed(list(super().run(tasks, workers, *arguments)))

    monkeypatch.setattr(augmented_set, "LOCAL", Reversed())
    messages: list[str] = []
    other = augment_images(
        three_images,
        tmp_path / "reversed",
        SETTINGS,
        BACKGROUNDS,
        workers=1,
        progress=lambda done, total, message: messages.append(message),
    )
    assert_same_files(other, stored)
    assert messages == [f"augmented {item.id}" for item in reversed(three_images.items)]


def test_one_image_can_be_regenerated_alone(stored: AugmentedSet, three_images: LabeledImageSet) -> None:
    backgrounds = Backgrounds.load(BACKGROUNDS)
    for i in (11, 2, 5):
        recipe = stored.recipes[i]
        hand = cut_out_hand(*three_images.read(i // SETTINGS.n_variants), SETTINGS)
        again = augment(recipe["source"], hand, recipe["variant"], backgrounds, SETTINGS)
        np.testing.assert_array_equal(again.image, stored.images[i])
        np.testing.assert_array_equal(again.mask, stored.masks[i])
        assert again.recipe == recipe


def test_applied_methods_are_counted(stored: AugmentedSet) -> None:
    applied = json.loads((stored.folder / "set.json").read_text())["applied"]
    assert set(applied) == set(METHOD_NAMES)
    assert applied["background"] == 12
    assert sum(applied.values()) == sum(len(recipe["operations"]) for recipe in stored.recipes)


def test_without_photographs_surfaces_are_procedural(three_images: LabeledImageSet, tmp_path: pathlib.Path) -> None:
    one_variant = AugmentationSettings(n_variants=1, width=64, height=48)
    made = augment_images(three_images, tmp_path / "set", one_variant, workers=1)
    assert made.background_digest == ""
    assert all(not r["operations"][0]["source"].endswith(".jpg") for r in made.recipes)


def test_changed_photographs_are_read_again(three_images: LabeledImageSet, tmp_path: pathlib.Path) -> None:
    """Photographs are cached per process during a call, but not between calls."""
    photographs = tmp_path / "photographs"
    photographs.mkdir()
    sets = []
    for gray in (20, 200):
        assert cv2.imwrite(str(photographs / "a.png"), np.full((60, 80, 3), gray, np.uint8))
        sets.append(augment_images(three_images, tmp_path / str(gray), SETTINGS, photographs, workers=1))
    assert sets[0].background_digest != sets[1].background_digest
    assert not np.array_equal(sets[0].images, sets[1].images)


def test_digest_depends_on_settings(
    stored: AugmentedSet, three_images: LabeledImageSet, tmp_path: pathlib.Path
) -> None:
    reseeded = AugmentationSettings(n_variants=4, width=64, height=48, seed=1)
    other = augment_images(three_images, tmp_path / "set", reseeded, BACKGROUNDS, workers=1)
    assert other.digest != stored.digest


@pytest.mark.parametrize("workers", [1, 2])
def test_interrupt_leaves_no_file_and_no_process(
    workers: int, three_images: LabeledImageSet, tmp_path: pathlib.Path
) -> None:
    def interrupt(done: int, total: int, message: str) -> None:
        raise KeyboardInterrupt

    n_threads = cv2.getNumThreads()
    with pytest.raises(KeyboardInterrupt):
        augment_images(three_images, tmp_path / "set", SETTINGS, workers=workers, progress=interrupt)
    assert list(tmp_path.iterdir()) == []
    assert multiprocessing.active_children() == []
    assert cv2.getNumThreads() == n_threads


def test_invalid_arguments_are_refused_without_output(three_images: LabeledImageSet, tmp_path: pathlib.Path) -> None:
    with pytest.raises(SettingsError, match="workers must be at least 1, got 0"):
        augment_images(three_images, tmp_path / "set", SETTINGS, workers=0)
    with pytest.raises(DataError, match="is not a folder"):
        augment_images(three_images, tmp_path / "set", SETTINGS, tmp_path / "none", workers=1)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("name", FILES)
def test_missing_file_is_named(copy: pathlib.Path, name: str) -> None:
    (copy / name).unlink()
    with pytest.raises(DataError) as caught:
        AugmentedSet.load(copy)
    assert caught.value.path == copy / name


def test_arrays_of_another_dtype_are_refused(copy: pathlib.Path) -> None:
    np.save(copy / "masks.npy", np.zeros((12, 48, 64), np.float32))
    with pytest.raises(DataError, match="float32"):
        AugmentedSet.load(copy)
    np.save(copy / "masks.npy", np.array([{"a": 1}], dtype=object), allow_pickle=True)
    with pytest.raises(DataError, match="cannot be opened"):
        AugmentedSet.load(copy)


def test_recipes_of_another_set_are_refused(copy: pathlib.Path) -> None:
    lines = (copy / "recipes.jsonl").read_text().splitlines()
    (copy / "recipes.jsonl").write_text("\n".join(lines[:-1]))
    with pytest.raises(DataError, match="11 recipes for 12 images"):
        AugmentedSet.load(copy)
    lines[0] = lines[0].replace('"variant": 0', '"variant": 9')
    (copy / "recipes.jsonl").write_text("\n".join(lines))
    with pytest.raises(DataError, match="differs from its recipes"):
        AugmentedSet.load(copy)
    (copy / "recipes.jsonl").write_text("\n".join(["{", *lines[1:]]))
    with pytest.raises(DataError, match="line 1"):
        AugmentedSet.load(copy)


def test_another_format_is_refused(copy: pathlib.Path) -> None:
    (copy / "set.json").write_text('{"format": 99}')
    with pytest.raises(DataError, match="format 1"):
        AugmentedSet.load(copy)


def test_verification_finds_a_changed_pixel(copy: pathlib.Path) -> None:
    images = np.lib.format.open_memmap(copy / "images.npy", mode="r+")
    images[7, 3, 3, 0] ^= 1
    images.flush()
    del images
    with pytest.raises(DataError, match="image 7 differs"):
        AugmentedSet.load(copy).verify()


def test_scheme_sheet_shows_images_of_each_set(stored: AugmentedSet) -> None:
    figure = scheme_sheet({"One": stored, "Other": stored}, n_images=3)
    first = figure.axes[0]
    assert len(figure.axes) == 6
    assert first.get_title(loc="left") == f"One, {stored.n_distinct} different of {stored.n}"
    np.testing.assert_array_equal(first.images[0].get_array(), stored.images[0])


def test_contact_sheet_shows_first_and_last_original_with_their_variants(
    stored: AugmentedSet, three_images: LabeledImageSet, tmp_path: pathlib.Path
) -> None:
    contact_sheet(three_images, stored, tmp_path / "sheet.png", n_originals=2, n_variants=3)
    sheet = cv2.imread(str(tmp_path / "sheet.png"))
    assert sheet is not None
    cell_px, row_px, left_px, top_px = 295, 243, 7, 56  # 1.64 and 1.35 inches, at 180 dpi
    assert sheet.shape == (529, 1188, 3)
    rows = [[three_images.read(i)[0], *stored.images[4 * i : 4 * i + 3]] for i in (0, 2)]
    for row, column in np.ndindex(2, 4):
        tile = sheet[top_px + row * row_px :, left_px + column * cell_px :][:216, :288, ::-1]
        np.testing.assert_allclose(tile.mean(axis=(0, 1)), rows[row][column].mean(axis=(0, 1)), atol=4)


def test_contact_sheet_of_other_originals_is_refused(
    stored: AugmentedSet, three_images: LabeledImageSet, tmp_path: pathlib.Path
) -> None:
    other = LabeledImageSet("other", three_images.items, three_images.pixel_digests, "0" * 64)
    with pytest.raises(DataError, match="was not made from"):
        contact_sheet(other, stored, tmp_path / "other.png")
    assert not (tmp_path / "other.png").exists()
