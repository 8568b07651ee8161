"""Near copies are found whatever was done to them; different images, and other hands on one table, are not."""

import pathlib
from collections.abc import Callable

import cv2
import numpy as np
import pytest

from deltasafe.perception.data.labeled_images import LabeledImageSet
from deltasafe.perception.data.near_copies import listed, near_copies

DATASETS = pathlib.Path(__file__).parents[4] / "datasets"
Array = np.ndarray


def reencoded(rgb: Array, mask: Array) -> tuple[Array, Array]:
    decoded = cv2.imdecode(cv2.imencode(".jpg", rgb, [cv2.IMWRITE_JPEG_QUALITY, 20])[1], cv2.IMREAD_COLOR)
    assert decoded is not None
    return decoded, mask


def brighter(rgb: Array, mask: Array) -> tuple[Array, Array]:
    return np.clip(rgb * 1.2 + 15, 0, 255).astype(np.uint8), mask


def half(rgb: Array, mask: Array) -> tuple[Array, Array]:
    return rgb[::2, ::2], mask[::2, ::2]


def mirrored(rgb: Array, mask: Array) -> tuple[Array, Array]:
    return rgb[:, ::-1], mask[:, ::-1]


def cropped(rgb: Array, mask: Array) -> tuple[Array, Array]:
    return rgb[5:-5, 7:-7], mask[5:-5, 7:-7]


def written(folder: pathlib.Path, pairs: dict[str, tuple[Array, Array]]) -> LabeledImageSet:
    for part in ("images", "masks"):
        (folder / part).mkdir(parents=True)
    for name, (rgb, mask) in pairs.items():
        cv2.imwrite(str(folder / "images" / f"{name}.png"), rgb[..., ::-1])
        cv2.imwrite(str(folder / "masks" / f"{name}.png"), 255 * mask)
    return LabeledImageSet.load(folder)


@pytest.mark.parametrize("change", [reencoded, brighter, half, mirrored, cropped])
def test_a_changed_copy_is_found_with_its_original(
    change: Callable[[Array, Array], tuple[Array, Array]], three_images: LabeledImageSet, tmp_path: pathlib.Path
) -> None:
    copies = written(tmp_path / "copies", {"copy": change(*three_images.read(1))})
    (found,) = near_copies(copies, three_images)
    assert (found.image.id, found.original.id) == ("copy", three_images.items[1].id)
    assert found.mirrored == (change is mirrored)
    assert listed([found] * 7).endswith("; and 2 more")


def test_packaged_sets_have_no_near_copies() -> None:
    train, test = (LabeledImageSet.load(DATASETS / "hands" / name) for name in ("train", "test"))
    assert near_copies(test, train) == near_copies(test) == near_copies(train) == []
    assert len(near_copies(train, train)) == len(train), "each is a copy of itself"


def test_a_mounted_camera_sees_one_table_and_many_hands(tmp_path: pathlib.Path) -> None:
    rng = np.random.default_rng(0)
    table = cv2.resize(rng.integers(0, 256, (6, 8, 3), dtype=np.uint8), (128, 96), interpolation=cv2.INTER_CUBIC)

    def photo(x: int, seed: int) -> tuple[Array, Array]:
        mask = np.zeros((96, 128), np.uint8)
        mask[40:60, x : x + 16] = x > 0
        noise = np.random.default_rng(seed).normal(0, 3, table.shape)
        return np.clip(np.where(mask[..., None] > 0, 0.5 * table + 60, table) + noise, 0, 255).astype(np.uint8), mask

    images = written(tmp_path / "one", {f"{k}": photo(x, k) for k, x in enumerate((0, 20, 60, 100, 101))})
    correlations = np.corrcoef(images.thumbnails[:, 0].reshape(5, -1))
    assert correlations.min() > 0.95, "the pictures alone would all be near copies"
    assert [(pair.image.id, pair.original.id) for pair in near_copies(images)] == [("4", "3")]
    other = written(tmp_path / "two", {"empty": photo(0, 9), "hand": photo(40, 10)})
    assert [(pair.image.id, pair.original.id) for pair in near_copies(other, images)] == [("empty", "0")]


def test_uniform_pictures_are_no_copies(tmp_path: pathlib.Path) -> None:
    mask = np.zeros((32, 32), np.uint8)
    mask[:9, :9] = 1
    flat = {str(value): (np.full((32, 32, 3), value, np.uint8), mask) for value in (20, 200)}
    assert near_copies(written(tmp_path / "flat", flat)) == []
