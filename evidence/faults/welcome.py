"""Inputs as people have them: each must be accepted, and give the pixels of the same picture in its plain form."""

import dataclasses
import io
import os
import pathlib
import shutil
import unicodedata
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from deltasafe.errors import DeltasafeError
from deltasafe.io.images import read_rgb
from deltasafe.perception.data.augmentation.background import Backgrounds
from deltasafe.perception.data.labeled_images import LabeledImageSet
from deltasafe.perception.data.masks import read_mask

EXIF_ORIENTATION = 0x0112
# how Pillow turns upright pixels into the ones that a camera stores; the inverse of what viewers do
STORED = {
    2: Image.Transpose.FLIP_LEFT_RIGHT,
    3: Image.Transpose.ROTATE_180,
    4: Image.Transpose.FLIP_TOP_BOTTOM,
    5: Image.Transpose.TRANSPOSE,
    6: Image.Transpose.ROTATE_90,
    7: Image.Transpose.TRANSVERSE,
    8: Image.Transpose.ROTATE_270,
}
Pixels = NDArray[np.uint8]


@dataclasses.dataclass(frozen=True)
class ImageKind:
    """An image file, what it shows, and how much its pixels may differ on average."""

    data: bytes
    expected: Pixels
    tolerance: float = 0.0


def image_kinds(rgb: Pixels) -> dict[str, ImageKind]:
    """Encode a photograph ``(H, W, 3)`` in every way that is read."""
    picture, gray = Image.fromarray(rgb), Image.fromarray(rgb).convert("L")
    shown_gray = np.asarray(gray.convert("RGB"))
    kinds = {
        "PNG": ImageKind(_encoded(picture, "PNG"), rgb),
        "BMP": ImageKind(_encoded(picture, "BMP"), rgb),
        "PPM": ImageKind(_encoded(picture, "PPM"), rgb),
        "TIFF": ImageKind(_encoded(picture, "TIFF"), rgb),
        "TIFF, LZW": ImageKind(_encoded(picture, "TIFF", compression="tiff_lzw"), rgb),
        "WebP": ImageKind(_encoded(picture, "WEBP", lossless=True), rgb),
        "WebP, lossy": ImageKind(_encoded(picture, "WEBP", quality=90), rgb, 8.0),
        "JPEG": ImageKind(_encoded(picture, "JPEG", quality=95), rgb, 6.0),
        "JPEG, progressive": ImageKind(_encoded(picture, "JPEG", quality=95, progressive=True), rgb, 6.0),
        "JPEG, CMYK": ImageKind(_encoded(picture.convert("CMYK"), "JPEG", quality=95), rgb, 6.0),
        "JPEG, gray": ImageKind(_encoded(gray, "JPEG", quality=95), shown_gray, 6.0),
        "PNG, gray": ImageKind(_encoded(gray, "PNG"), shown_gray),
        "PNG, opaque alpha": ImageKind(_encoded(picture.convert("RGBA"), "PNG"), rgb),
        "PNG, palette": ImageKind(
            _encoded(picture.quantize(32), "PNG"), np.asarray(picture.quantize(32).convert("RGB"))
        ),
        "PNG, one bit": ImageKind(_encoded(gray.convert("1"), "PNG"), np.asarray(gray.convert("1").convert("RGB"))),
        "PNG, gray with 16 bits": ImageKind(
            _encoded(Image.fromarray(np.asarray(gray, np.uint16) * 257), "PNG"), shown_gray
        ),
        "MPO": ImageKind(
            _encoded(picture, "MPO", save_all=True, append_images=[gray.convert("RGB")], quality=95), rgb, 6.0
        ),
    }
    if "AVIF" in Image.SAVE:
        kinds["AVIF"] = ImageKind(_encoded(picture, "AVIF", quality=90), rgb, 8.0)
    for orientation, turn in STORED.items():
        for form in ("PNG", "TIFF"):
            data = _encoded(picture.transpose(turn), form, exif=_orientation(orientation))
            kinds[f"{form}, EXIF orientation {orientation}"] = ImageKind(data, rgb)
    for orientation in (0, 9):
        data = _encoded(picture, "PNG", exif=_orientation(orientation))
        kinds[f"PNG, EXIF orientation {orientation}"] = ImageKind(data, rgb)
    return kinds


def mask_kinds(mask: Pixels) -> dict[str, bytes]:
    """Encode a mask ``(H, W)`` of 0 and 255 in every way that is read."""
    picture = Image.fromarray(mask)
    return {
        "0 and 1": _encoded(Image.fromarray(mask // 255), "PNG"),
        "one bit": _encoded(picture.convert("1", dither=Image.Dither.NONE), "PNG"),
        "16 bits": _encoded(Image.fromarray(mask.astype(np.uint16) * 257), "PNG"),
        "palette": _encoded(picture.convert("RGB").quantize(4), "PNG"),
        **{mode: _encoded(picture.convert(mode), "PNG") for mode in ("RGB", "RGBA", "LA")},
        "TIFF": _encoded(picture, "TIFF"),
        "one color": _encoded(_colored(mask, (250, 50, 83)), "PNG"),
        "on transparent": _encoded(_colored(mask, (9, 9, 9, 255)), "PNG"),
    }


def folder_changes() -> dict[str, Callable[[pathlib.Path], None]]:
    """Changes of a folder of images that change nothing of what is read."""

    def clutter(folder: pathlib.Path) -> None:
        for name in ("._a.png", ".DS_Store", "Thumbs.db", "desktop.ini"):
            (folder / name).write_bytes(b"\x00\x05\x16\x07")
        (folder / "@eaDir").mkdir()

    def decomposed(folder: pathlib.Path) -> None:
        for path in sorted(folder.iterdir()):
            path.rename(path.with_name(unicodedata.normalize("NFD", path.name)))

    def upper_case(folder: pathlib.Path) -> None:
        for path in sorted(folder.iterdir()):
            path.rename(path.with_suffix(path.suffix.upper()))

    return {"clutter": clutter, "decomposed names": decomposed, "upper case": upper_case}


def wrong_welcomes(home: pathlib.Path, hands: pathlib.Path) -> tuple[int, list[str]]:
    """Read every welcome input; return their number, and what went wrong with which.

    Args:
        home: folder for temporary files.
        hands: a valid set of labeled images, one of them with a name that is not ASCII.
    """
    images, wrong = LabeledImageSet.load(hands), []
    rgb, mask = images.read(0)
    photographs, masks = image_kinds(rgb), mask_kinds(mask * 255)

    def expect(what: str, check: Callable[..., bool], *given: object) -> None:
        try:
            if not check(*given):
                wrong.append(f"{what}: gives other pixels")
        except (DeltasafeError, OSError) as error:
            wrong.append(f"{what}: {error}")

    file = home / "welcome.jpg"  # the content decides, not the suffix
    for name, kind in photographs.items():
        file.write_bytes(kind.data)
        expect(f"image: {name}", _shows, file, kind)
    for name, data in masks.items():
        file.write_bytes(data)
        expect(f"mask: {name}", lambda: np.array_equal(read_mask(file), mask * 255))
    for name, change in folder_changes().items():
        changed = home / f"welcome {name}"
        shutil.copytree(hands, changed, copy_function=os.link)
        for part in ("images", "masks"):
            change(changed / part)
        expect(f"hands: {name}", _is_set, changed, images.digest)
        expect(f"backgrounds: {name}", _has_backgrounds, changed / "images", len(images))
    return len(photographs) + len(masks) + 2 * len(folder_changes()), wrong


def _shows(file: pathlib.Path, kind: ImageKind) -> bool:
    found = read_rgb(file)
    return found.shape == kind.expected.shape and np.abs(found.astype(int) - kind.expected).mean() <= kind.tolerance


def _is_set(folder: pathlib.Path, digest: str) -> bool:
    return LabeledImageSet.load(folder).digest == digest


def _has_backgrounds(folder: pathlib.Path, n_images: int) -> bool:
    return len(Backgrounds.load(folder).paths) == n_images


def _encoded(picture: Image.Image, form: str, **options: object) -> bytes:
    stream = io.BytesIO()
    picture.save(stream, form, **options)
    return stream.getvalue()


def _colored(mask: Pixels, color: tuple[int, ...]) -> Image.Image:
    return Image.fromarray(np.where(mask[..., None] > 0, np.array(color, np.uint8), np.uint8(0)))


def _orientation(value: int) -> Image.Exif:
    exif = Image.Exif()
    exif[EXIF_ORIENTATION] = value
    return exif
