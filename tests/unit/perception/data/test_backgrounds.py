"""Backgrounds are read when they are drawn, of any size and kind, with bounded memory."""

import pathlib
import tempfile
import tracemalloc

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image

from deltasafe.errors import DataError
from deltasafe.perception.data.augmentation import AugmentationSettings, background
from deltasafe.perception.data.augmentation.augment import augment, cut_out_hand
from deltasafe.perception.data.augmentation.background import Backgrounds, draw_background

SMALL = AugmentationSettings(width=64, height=48)


def test_backgrounds_are_named_in_the_recipe(tmp_path) -> None:
    with pytest.raises(DataError, match="is not a folder"):
        Backgrounds.load(tmp_path / "none")
    with pytest.raises(DataError, match="holds no image"):
        Backgrounds.load(tmp_path)
    assert cv2.imwrite(str(tmp_path / "b.png"), np.full((30, 20, 3), 9, np.uint8))
    assert cv2.imwrite(str(tmp_path / "a.jpg"), np.full((50, 400, 3), 9, np.uint8))
    backgrounds = Backgrounds.load(tmp_path)
    assert [path.name for path in backgrounds.paths] == ["a.jpg", "b.png"]
    rgb, mask = np.full((48, 64, 3), 120, np.uint8), np.zeros((48, 64), np.uint8)
    mask[10:30, 20:40] = 1
    hand = cut_out_hand(rgb, mask, SMALL)
    sources = {augment("x", hand, v, backgrounds, SMALL).recipe["operations"][0]["source"] for v in range(40)}
    assert {"a.jpg", "b.png"} < sources


def test_ignored_and_hidden_files_among_backgrounds(tmp_path: pathlib.Path) -> None:
    for name in ("a.webp", "b.TIF", "c.jpg"):
        Image.new("RGB", (40, 30), (90, 80, 70)).save(tmp_path / name)
    for name in ("._c.jpg", "Thumbs.db", ".DS_Store", "notes.txt"):
        (tmp_path / name).write_bytes(b"\x00\x05\x16\x07")
    (tmp_path / "more").mkdir()
    backgrounds = Backgrounds.load(tmp_path)
    assert [path.name for path in backgrounds.paths] == ["a.webp", "b.TIF", "c.jpg"]
    assert backgrounds.ignored == "more/, notes.txt"


def test_turned_background_is_upright(tmp_path: pathlib.Path) -> None:
    exif = Image.Exif()
    exif[0x0112] = 6
    Image.new("RGB", (40, 30)).save(tmp_path / "turned.jpg", exif=exif)
    assert Backgrounds.load(tmp_path).read(0).shape == (40, 30, 3)


@pytest.mark.parametrize("size", [(300, 1), (1, 300), (15, 15)])
def test_tiny_background_is_refused(tmp_path: pathlib.Path, size: tuple[int, int]) -> None:
    Image.new("RGB", size).save(tmp_path / "line.png")
    with pytest.raises(DataError, match=r"line\.png: .* at least 16 per side; remove it"):
        Backgrounds.load(tmp_path)


@settings(max_examples=25, deadline=None)
@given(width=st.integers(16, 700), height=st.integers(16, 700), seed=st.integers(0, 9))
def test_background_of_any_size_gives_a_canvas(width: int, height: int, seed: int) -> None:
    with tempfile.TemporaryDirectory() as folder:
        Image.new("RGB", (width, height), (200, 10, 10)).save(pathlib.Path(folder, "b.png"))
        backgrounds = Backgrounds.load(folder)
        for each in range(3):
            drawn, _ = draw_background(np.random.default_rng([seed, each]), backgrounds, 64, 48)
            assert drawn.shape == (48, 64, 3)


def test_large_backgrounds_are_reduced_and_few_stay_in_memory(tmp_path: pathlib.Path, monkeypatch) -> None:
    monkeypatch.setattr(background, "MAX_PIXELS", 10_000)
    for i in range(70):
        Image.new("RGB", (400, 300), (i, 0, 0)).save(tmp_path / f"{i:02d}.jpg")
    backgrounds = Backgrounds.load(tmp_path)
    tracemalloc.start()
    for i in range(70):
        assert backgrounds.read(i).shape == (86, 115, 3)
    held, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert held < 1.1 * 64 * 3 * 10_000  # the cache holds 64 images
    assert peak < held + 10 * 3 * 10_000
