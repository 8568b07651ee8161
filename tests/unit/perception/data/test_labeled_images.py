"""A labeled image set is checked before use; the error of each defect names the file and the remedy."""

import pathlib
import re
import shutil
import struct
import subprocess
import sys
import unicodedata
import zlib

import cv2
import numpy as np
import pytest

from deltasafe.errors import DataError
from deltasafe.io.checksum_list import read_registry
from deltasafe.io.images import read_rgb
from deltasafe.io.storage import sha256_of_file
from deltasafe.perception.data.labeled_images import LabeledImageSet, check_disjoint, check_distinct

DATASETS = pathlib.Path(__file__).parents[4] / "datasets"


def write(path: pathlib.Path, pixels: np.ndarray) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    assert cv2.imwrite(str(path), pixels)


def image_and_mask(seed: int, height: int = 24, width: int = 32) -> tuple[np.ndarray, np.ndarray]:
    mask = np.zeros((height, width), np.uint8)
    mask[6:18, 8:24] = 255
    return np.random.default_rng(seed).integers(0, 256, (height, width, 3), dtype=np.uint8), mask


@pytest.fixture
def folder(tmp_path: pathlib.Path) -> pathlib.Path:
    for name, seed in (("b", 1), ("a", 2), ("Hände 手", 3)):
        bgr, mask = image_and_mask(seed, 24 + seed, 32)
        write(tmp_path / "set" / "images" / f"{seed}.png", bgr)
        write(tmp_path / "set" / "masks" / f"{seed}.png", mask)
        for kind in ("images", "masks"):
            (tmp_path / "set" / kind / f"{seed}.png").rename(tmp_path / "set" / kind / f"{name}.png")
    return tmp_path / "set"


def registered(folder: pathlib.Path) -> pathlib.Path:
    registry = folder.parent / "registry.sha256"
    lines = [f"{sha256_of_file(p)}  {p.relative_to(folder.parent)}\n" for p in sorted(folder.rglob("*.png"))]
    registry.write_text("".join(lines), encoding="utf-8")
    return registry


def test_reads_rgb_and_masks_of_any_size_sorted_by_id(folder: pathlib.Path) -> None:
    images = LabeledImageSet.load(folder)
    assert [item.id for item in images.items] == ["Hände 手", "a", "b"]
    assert len(images) == 3
    rgb, mask = images.read(2)
    bgr, expected = image_and_mask(1, 25, 32)
    np.testing.assert_array_equal(rgb, bgr[..., ::-1])
    np.testing.assert_array_equal(mask, expected // 255)
    assert images.read(0)[0].shape == (27, 32, 3)


def test_digest_depends_on_content_and_not_on_path(folder: pathlib.Path, tmp_path: pathlib.Path) -> None:
    copy = tmp_path / "elsewhere"
    shutil.copytree(folder, copy)
    assert LabeledImageSet.load(copy).digest == LabeledImageSet.load(folder).digest
    mask = image_and_mask(1, 25, 32)[1]
    mask[0, 0] = 255
    write(copy / "masks" / "b.png", mask)
    assert LabeledImageSet.load(copy).digest != LabeledImageSet.load(folder).digest


def test_packaged_sets_match_the_registry_and_are_disjoint() -> None:
    registry = DATASETS / "registry.sha256"
    train = LabeledImageSet.load(DATASETS / "hands" / "train", registry)
    test = LabeledImageSet.load(DATASETS / "hands" / "test", registry)
    assert (len(train), len(test)) == (50, 50)
    check_disjoint(train, test)


def test_registry_lists_every_file_of_the_datasets() -> None:
    registry = read_registry(DATASETS / "registry.sha256")
    files = [p for p in DATASETS.rglob("*") if p.is_file() and p.name not in ("registry.sha256", "README.md")]
    assert list(registry) == sorted(p.relative_to(DATASETS).as_posix() for p in files)
    sha256sum = shutil.which("sha256sum")
    if sha256sum:  # an independent implementation
        subprocess.run([sha256sum, "--check", "--quiet", "registry.sha256"], cwd=DATASETS, check=True)
    else:
        assert all(sha256_of_file(DATASETS / name) == digest for name, digest in registry.items())


def missing_mask(folder: pathlib.Path) -> pathlib.Path:
    (folder / "masks" / "a.png").unlink()
    return folder / "images" / "a.png"


def missing_image(folder: pathlib.Path) -> pathlib.Path:
    (folder / "images" / "a.png").unlink()
    return folder / "masks" / "a.png"


def no_folder(folder: pathlib.Path) -> pathlib.Path:
    shutil.rmtree(folder / "masks")
    return folder / "masks"


def no_images(folder: pathlib.Path) -> pathlib.Path:
    for path in [*folder.glob("images/*"), *folder.glob("masks/*")]:
        path.unlink()
    return folder


def transparent_image(folder: pathlib.Path) -> pathlib.Path:
    write(folder / "images" / "a.png", np.zeros((26, 32, 4), np.uint8))
    return folder / "images" / "a.png"


def other_size(folder: pathlib.Path) -> pathlib.Path:
    write(folder / "masks" / "a.png", image_and_mask(2, 20)[1])
    return folder / "masks" / "a.png"


def mask_of_two_colors(folder: pathlib.Path) -> pathlib.Path:
    mask = np.zeros((26, 32, 3), np.uint8)
    mask[2:9, 3:8], mask[12:20, 3:8] = (0, 0, 255), (0, 255, 0)
    write(folder / "masks" / "a.png", mask)
    return folder / "masks" / "a.png"


def gray_values(folder: pathlib.Path) -> pathlib.Path:
    mask = image_and_mask(2, 26)[1]
    mask[3, 3] = 7
    write(folder / "masks" / "a.png", mask)
    return folder / "masks" / "a.png"


def truncated(folder: pathlib.Path) -> pathlib.Path:
    path = folder / "images" / "a.png"
    path.write_bytes(path.read_bytes()[:20])
    return path


def empty_file(folder: pathlib.Path) -> pathlib.Path:
    (folder / "images" / "a.png").write_bytes(b"")
    return folder / "images" / "a.png"


def stray_file(folder: pathlib.Path) -> pathlib.Path:
    (folder / "images" / "notes.txt").write_text("hello")
    return folder / "images" / "notes.txt"


def same_stem(folder: pathlib.Path) -> pathlib.Path:
    shutil.copy(folder / "images" / "a.png", folder / "images" / "a.PNG.jpg")
    (folder / "images" / "a.PNG.jpg").rename(folder / "images" / "a.jpg")
    return folder / "images" / "a.png"


def test_header_with_too_many_pixels_is_refused(folder: pathlib.Path) -> None:
    path = folder / "images" / "a.png"
    data = path.read_bytes()
    header = b"IHDR" + struct.pack(">II", 90_000, 90_000) + data[24:29]
    path.write_bytes(data[:12] + header + struct.pack(">I", zlib.crc32(header)) + data[33:])
    with pytest.raises(DataError, match=r"a\.png: (has about 8100 million pixels|is not a readable image)"):
        LabeledImageSet.load(folder)


def test_truncated_jpeg_is_refused(folder: pathlib.Path, tmp_path: pathlib.Path) -> None:
    write(tmp_path / "a.jpg", image_and_mask(2, 200, 300)[0])
    data = (tmp_path / "a.jpg").read_bytes()
    read_rgb(tmp_path / "a.jpg")
    (tmp_path / "a.jpg").write_bytes(data[: len(data) // 2])
    with pytest.raises(DataError, match=r"a\.jpg: is not a readable image"):
        read_rgb(tmp_path / "a.jpg")


@pytest.mark.parametrize(
    ("make_defect", "message"),
    [
        (missing_mask, "no counterpart in masks/"),
        (missing_image, "no counterpart in images/"),
        (no_folder, "is not a folder"),
        (no_images, "holds no images"),
        (transparent_image, "transparent in 100.0% of its pixels; save it without"),
        (other_size, "is 32 x 20 but its image is 32 x 26"),
        (mask_of_two_colors, r"has 2 colors besides black \(#00ff00, #ff0000\)"),
        (gray_values, r"has 2 gray values besides black \(255, 7\)"),
        (truncated, "not a readable image"),
        (empty_file, "not a readable image .0 bytes"),
        (stray_file, "is not an image"),
        (same_stem, "has the same stem as a.jpg"),
    ],
    ids=lambda value: value.__name__ if callable(value) else "",
)
def test_defects_are_refused_by_name(folder: pathlib.Path, make_defect, message: str) -> None:
    defective = make_defect(folder)
    with pytest.raises(DataError, match=message) as caught:
        LabeledImageSet.load(folder)
    assert caught.value.path == defective


def test_file_changed_since_registration_is_refused(folder: pathlib.Path) -> None:
    registry = registered(folder)
    LabeledImageSet.load(folder, registry)
    mask = image_and_mask(2, 26)[1]
    mask[0, 0] = 255
    write(folder / "masks" / "a.png", mask)
    with pytest.raises(DataError, match="registered is") as caught:
        LabeledImageSet.load(folder, registry)
    assert caught.value.path == folder / "masks" / "a.png"


def test_unregistered_file_is_refused(folder: pathlib.Path) -> None:
    registry = registered(folder)
    for kind in ("images", "masks"):
        shutil.copy(folder / kind / "a.png", folder / kind / "new.png")
    with pytest.raises(DataError, match="is not listed in"):
        LabeledImageSet.load(folder, registry)


def test_missing_or_malformed_registry_is_refused(folder: pathlib.Path, tmp_path: pathlib.Path) -> None:
    with pytest.raises(DataError, match="is missing"):
        LabeledImageSet.load(folder, tmp_path / "none.sha256")
    (tmp_path / "bad.sha256").write_text("abc  images/a.png\n")
    with pytest.raises(DataError, match="line 1"):
        LabeledImageSet.load(folder, tmp_path / "bad.sha256")


def test_image_in_both_sets_is_found_under_another_name(folder: pathlib.Path, tmp_path: pathlib.Path) -> None:
    bgr, mask = image_and_mask(1, 25, 32)
    write(tmp_path / "test" / "images" / "renamed.png", bgr)
    write(tmp_path / "test" / "masks" / "renamed.png", mask)
    # same pixels, other bytes
    assert cv2.imwrite(str(tmp_path / "test/images/renamed.png"), bgr, [cv2.IMWRITE_PNG_COMPRESSION, 0])
    with pytest.raises(DataError, match=r"same pixels as .*b\.png") as caught:
        check_disjoint(LabeledImageSet.load(folder), LabeledImageSet.load(tmp_path / "test"))
    assert caught.value.path.name == "renamed.png"


def test_images_without_a_hand_are_allowed_beside_others(folder: pathlib.Path) -> None:
    write(folder / "masks" / "a.png", np.zeros((26, 32), np.uint8))
    images = LabeledImageSet.load(folder)
    assert images.without_hand == ("a",)
    assert not images.read(1)[1].any()
    for name in ("b", "Hände 手"):
        mask = cv2.imdecode(np.fromfile(folder / "masks" / f"{name}.png", np.uint8), cv2.IMREAD_GRAYSCALE)
        cv2.imencode(".png", np.zeros_like(mask))[1].tofile(folder / "masks" / f"{name}.png")
    with pytest.raises(DataError, match="mark no hand in any image"):
        LabeledImageSet.load(folder)


def test_copies_within_a_set_are_found_and_refused_in_test_sets(folder: pathlib.Path) -> None:
    assert LabeledImageSet.load(folder).copies == ()
    check_distinct(LabeledImageSet.load(folder), "test")
    for kind in ("images", "masks"):
        for name in ("copy", "later"):
            shutil.copy(folder / kind / "a.png", folder / kind / f"{name}.png")
    images = LabeledImageSet.load(folder)
    assert [(item.id, first.id) for item, first in images.copies] == [("copy", "a"), ("later", "a")]
    with pytest.raises(
        DataError, match=r"(?s)copy\.png: has the same pixels as a\.png of the same test set.*later\.png"
    ):
        check_distinct(images, "test")


def test_unicode_forms_of_a_name_are_one_name(folder: pathlib.Path) -> None:
    """Names from a Mac are decomposed, others are not."""
    before = LabeledImageSet.load(folder).digest
    decomposed = unicodedata.normalize("NFD", "Hände 手")
    (folder / "images" / "Hände 手.png").rename(folder / "images" / f"{decomposed}.png")
    assert LabeledImageSet.load(folder).digest == before
    registry = registered(folder)
    assert LabeledImageSet.load(folder, registry).items[0].id == "Hände 手"
    shutil.copy(folder / "images" / f"{decomposed}.png", folder / "images" / "Hände 手.jpg")
    with pytest.raises(DataError, match="has in another Unicode form, the stem of"):
        LabeledImageSet.load(folder)


def test_name_that_is_not_utf8_is_refused(folder: pathlib.Path) -> None:
    if sys.platform == "darwin":
        pytest.skip("the file system allows UTF-8 only")
    for kind in ("images", "masks"):
        (folder / kind / "a.png").rename(folder / kind / "h\udce4nd.png")
    with pytest.raises(DataError, match=r"h\\xe4nd\.png: has a name that is not UTF-8; rename it") as caught:
        LabeledImageSet.load(folder)
    str(caught.value).encode("utf-8")


def test_files_of_desktops_are_ignored(folder: pathlib.Path) -> None:
    before = LabeledImageSet.load(folder).digest
    for kind in ("images", "masks"):
        for name in ("._a.png", ".DS_Store", "Thumbs.db", "desktop.ini"):
            (folder / kind / name).write_bytes(b"\x00\x05\x16\x07")
        (folder / kind / "@eaDir").mkdir()
    assert LabeledImageSet.load(folder).digest == before


def test_unlisted_file_is_added_by_the_command_of_the_message(folder: pathlib.Path) -> None:
    if shutil.which("sha256sum") is None:
        pytest.skip("this machine has no sha256sum")
    registry = registered(folder)
    for kind in ("images", "masks"):
        shutil.copy(folder / kind / "a.png", folder / kind / "new one.png")
    with pytest.raises(DataError) as caught:
        LabeledImageSet.load(folder, registry)
    for command in re.findall("`([^`]+)`", str(caught.value)):
        subprocess.run(["sh", "-c", command], check=True)
    assert len(LabeledImageSet.load(folder, registry)) == 4
