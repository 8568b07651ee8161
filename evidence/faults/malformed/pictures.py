"""Corruptions of images and masks, in hand sets and alone: truncated, oversized, rotated, wrong modes and values."""

import io
import pathlib
import shutil
import struct
import zlib
from collections.abc import Iterator
from random import Random

import numpy as np
from PIL import Image

from deltasafe.io.images import read_rgb
from deltasafe.perception.data.labeled_images import LabeledImageSet
from evidence.faults.malformed.files import (
    at,
    cases_of,
    edited,
    file_cases,
    file_changes,
    filled,
    prefixed,
    with_text,
)
from evidence.faults.rejection import Case, Change, Corruption, InputKind, rewrite
from pipelines.home import DATASETS

EXIF_ORIENTATION = 0x0112
NAMES = ("hand_a", "hand_b", "hand_c")
TRAIN = DATASETS / "hands" / "train"


def picture_cases(home: pathlib.Path, ensemble: pathlib.Path) -> list[Case]:
    """A single image, as ``deltasafe predict`` reads it."""
    valid = home / "picture.jpg"
    shutil.copyfile(min((TRAIN / "images").iterdir()), valid)

    def command(given: pathlib.Path, out: pathlib.Path) -> list[str]:
        return ["predict", str(ensemble), str(given), "-o", str(out / "answer.png")]

    kind = InputKind("picture", valid, lambda given, out: read_rgb(given), command)
    return file_cases(kind, {**file_changes(), **_image_changes(valid)})


def hand_cases(home: pathlib.Path) -> list[Case]:
    """A set of three images with masks."""
    valid = home / "hands"
    for folder in ("images", "masks"):
        (valid / folder).mkdir(parents=True)
        for source, name in zip(sorted((TRAIN / folder).iterdir()), NAMES, strict=False):
            shutil.copyfile(source, valid / folder / f"{name}{source.suffix}")
    image, mask = (min((valid / folder).iterdir()) for folder in ("images", "masks"))
    kind = InputKind("hands", valid, lambda given, out: LabeledImageSet.load(given))
    with Image.open(image) as opened:
        picture = opened.convert("RGB")
    ambiguous = {f"exif orientation {n}": filled(_rotated(picture, "JPEG", n)) for n in (2, 3, 4)}
    image_changes = {**file_changes(), **_image_changes(image), **ambiguous}
    mask_changes = {**file_changes(), **dict(_mask_changes(mask))}
    return cases_of(
        kind,
        {
            **prefixed("image", image_changes, lambda change: at(f"images/{image.name}", change)),
            **prefixed("mask", mask_changes, lambda change: at(f"masks/{mask.name}", change)),
            **_set_corruptions(image.name, mask.name),
        },
    )


def _image_changes(valid: pathlib.Path) -> dict[str, Change]:
    with Image.open(valid) as opened:
        picture = opened.convert("RGB")
    png, jpeg = _encoded(picture, "PNG"), _encoded(picture, "JPEG")
    others = {form.lower(): _encoded(picture, form) for form in ("WEBP", "TIFF", "BMP")}
    changes = {
        f"{form} truncated at {fraction:g}": _truncated(whole, fraction)
        for form, whole in {"png": png, "jpeg": jpeg, **others}.items()
        for fraction in (0.01, 0.1, 0.3, 0.6, 0.9, 0.99)
    }
    for width, height in ((2**31 - 1, 2**31 - 1), (100_000, 100_000), (0, 100), (30_000, 30_000)):
        changes[f"png claims {width} x {height}"] = filled(_png_of_size(png, width, height))
    for width, height in ((65_535, 65_535), (65_500, 20_000), (0, 100), (30_000, 30_000)):
        changes[f"jpeg claims {width} x {height}"] = filled(_jpeg_of_size(jpeg, width, height))
    changes["png that unpacks to 400 million pixels"] = filled(_encoded(Image.new("1", (20_000, 20_000)), "PNG"))
    changes["exposed in 12 of 16 bits"] = filled(
        _encoded(Image.fromarray(_gray(picture).astype(np.uint16) * 16), "PNG")
    )
    changes["half transparent"] = filled(_encoded(_half_transparent(picture), "PNG"))
    changes["two pages"] = filled(_encoded(picture, "TIFF", save_all=True, append_images=[picture]))
    changes["preview of a raw file"] = filled(_encoded(picture, "TIFF", tiffinfo={254: 1}))
    changes["pointer of git lfs"] = filled(b"version https://git-lfs.github.com/spec/v1\noid sha256:0\nsize 9\n")
    changes["tiff with floats"] = filled(_encoded(picture.convert("F"), "TIFF"))
    changes["palette with a transparent color"] = filled(_encoded(picture.quantize(16), "PNG", transparency=0))
    for n in range(5):
        changes[f"png with a flipped bit, {n}"] = _bit_flipped(png)
    changes["jpeg without its tables"] = filled(jpeg[:2] + jpeg[jpeg.index(b"\xff\xda") :])
    return changes


def _mask_changes(valid: pathlib.Path) -> Iterator[tuple[str, Change]]:
    with Image.open(valid) as opened:
        mask = np.array(opened.convert("L"))
    height, width = mask.shape
    png = _encoded(Image.fromarray(mask), "PNG")
    for fraction in (0.1, 0.5, 0.9):
        yield f"truncated at {fraction:g}", _truncated(png, fraction)
    for size in ((width + 1, height), (width, height - 1), (height, width), (1, 1), (2 * width, 2 * height)):
        yield f"with size {size}", filled(_encoded(Image.fromarray(mask).resize(size, 0), "PNG"))
    for value in (1, 2, 100, 127, 128, 200, 254):
        yield f"one pixel with value {value}", filled(_encoded(Image.fromarray(_with_pixel(mask, value)), "PNG"))
    yield "with floats", filled(_encoded(Image.fromarray(mask).convert("F"), "TIFF"))
    noisy = np.clip(mask.astype(int) + np.random.default_rng(0).integers(-9, 9, mask.shape), 0, 255)
    yield "with noise", filled(_encoded(Image.fromarray(noisy.astype(np.uint8)), "PNG"))
    yield "inverted", filled(_encoded(Image.fromarray(255 - mask), "PNG"))
    yield "with another value than the other masks", filled(_encoded(Image.fromarray(mask // 255 * 7), "PNG"))
    colors = np.zeros((height, width, 3), np.uint8)
    colors[: height // 3, : width // 2, 0], colors[2 * height // 3 :, : width // 2, 1] = 255, 255
    yield "with two colors", filled(_encoded(Image.fromarray(colors), "PNG"))
    yield "rotated by exif", filled(_rotated(Image.fromarray(mask), "PNG", 3))
    for n in range(3):
        yield f"with a flipped bit, {n}", _bit_flipped(png)


def _set_corruptions(image: str, mask: str) -> dict[str, Corruption]:
    stem = pathlib.PurePath(image).stem

    def emptied(given: pathlib.Path) -> None:
        for path in [*given.glob("*/*")]:
            path.unlink()

    def folders_added(given: pathlib.Path) -> None:
        for folder in ("images", "masks"):
            (given / folder / "more.png").mkdir()

    def without_hands(given: pathlib.Path) -> None:
        for path in sorted((given / "masks").iterdir()):
            with Image.open(path) as opened:
                rewrite(path, _encoded(Image.new("L", opened.size), "PNG"))

    def two_unicode_forms(given: pathlib.Path) -> None:
        for name in ("h\u00e4nd.png", "ha\u0308nd.png"):
            (given / "images" / name).touch()

    def replaced_by_file(given: pathlib.Path) -> None:
        shutil.rmtree(given)
        given.write_text("hands")

    return {
        # the message names the stem, because the other file of the pair is left
        "image: missing": edited(stem, lambda given: (given / "images" / image).unlink()),
        "mask: missing": edited(stem, lambda given: (given / "masks" / mask).unlink()),
        "image with another stem": edited(stem, lambda given: _rename(given / "images" / image)),
        "mask with another stem": edited(stem, lambda given: _rename(given / "masks" / mask)),
        "no masks": edited("masks", lambda given: shutil.rmtree(given / "masks")),
        "no images": edited("images", lambda given: shutil.rmtree(given / "images")),
        "empty folders": edited("", emptied),
        "masks without any hand": edited("masks", without_hands),
        "two images with one name in two Unicode forms": edited("Unicode", two_unicode_forms),
        "a name that is not UTF-8": edited("UTF-8", lambda given: (given / "images" / "h\udce4nd.png").touch()),
        "options with another key": edited(
            "dataset.json", lambda given: (given / "dataset.json").write_text('{"masks_drawn_on": "both"}')
        ),
        "a text file among the images": with_text("images/notes.txt"),
        "a text file among the masks": with_text("masks/notes.md"),
        "a program among the images": with_text("images/image.py"),
        "folders named like images": edited("more.png", folders_added),
        "two images with one stem": edited(
            stem, lambda given: shutil.copyfile(given / "images" / image, given / "images" / f"{stem}.JPEG")
        ),
        "a file instead of the folder": edited("", replaced_by_file),
    }


def _rename(path: pathlib.Path) -> None:
    path.rename(path.with_name(f"other{path.suffix}"))


def _encoded(picture: Image.Image, form: str, **options: object) -> bytes:
    stream = io.BytesIO()
    picture.save(stream, form, **options)
    return stream.getvalue()


def _rotated(picture: Image.Image, form: str, orientation: int) -> bytes:
    exif = Image.Exif()
    exif[EXIF_ORIENTATION] = orientation
    return _encoded(picture, form, exif=exif)


def _gray(picture: Image.Image) -> np.ndarray:
    return np.asarray(picture.convert("L"))


def _half_transparent(picture: Image.Image) -> Image.Image:
    alpha = np.full((picture.height, picture.width), 255, np.uint8)
    alpha[::2] = 0
    return Image.fromarray(np.dstack([np.asarray(picture), alpha]))


def _truncated(data: bytes, fraction: float) -> Change:
    return filled(data[: int(fraction * len(data))])


def _with_pixel(mask: np.ndarray, value: int) -> np.ndarray:
    changed = mask.copy()
    changed[3, 3] = value
    return changed


def _png_of_size(data: bytes, width: int, height: int) -> bytes:
    header = b"IHDR" + struct.pack(">II", width, height) + data[24:29]
    return data[:12] + header + struct.pack(">I", zlib.crc32(header)) + data[33:]


def _jpeg_of_size(data: bytes, width: int, height: int) -> bytes:
    frame = data.index(b"\xff\xc0")
    return data[: frame + 5] + struct.pack(">HH", height, width) + data[frame + 9 :]


def _bit_flipped(png: bytes) -> Change:
    def change(path: pathlib.Path, random: Random) -> None:
        first = png.index(b"IDAT") + 4
        position = random.randrange(first, len(png) - 16)
        rewrite(path, png[:position] + bytes([png[position] ^ (1 << random.randrange(8))]) + png[position + 1 :])

    return change
