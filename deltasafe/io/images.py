"""The one reader of photographs: labeled images, backgrounds, scenes and single images.

Every image is returned as RGB with 8 bits per channel, upright as viewers show it. What has no single meaning as such
an image (transparency, floating-point values, unused bits, several pictures in a file) is refused.
"""

import dataclasses
import io
import math
import pathlib
import re
import warnings
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageCms

from deltasafe.errors import DataError
from deltasafe.io.folder_entries import require_utf8_name

MAX_PIXELS = 80_000_000
"""Of one image. A corrupt header of a few bytes can claim any size, and the decoder would allocate it."""

_EXIF_ORIENTATION = 0x0112
_TIFF_SUBFILE_TYPE, _DNG_VERSION = 254, 50706
# without the formats of Pillow that run other programs (EPS) or have no photographs
_FORMATS = ("JPEG", "MPO", "PNG", "WEBP", "BMP", "DIB", "TIFF", "PPM", "AVIF", "HEIF")
_SEVERAL_PICTURES = ("MPO", "AVIF", "HEIF")
"""Formats of phones whose first picture is the photograph; others are previews and depths."""
_HEIF_BRANDS = (b"heic", b"heix", b"heim", b"heis", b"hevc", b"hevx", b"mif1", b"msf1")
_CONVERT = "convert it to RGB or gray with 8 bits per channel, from 0 (black) to 255 (white)"
_TURNS = {
    2: Image.Transpose.FLIP_LEFT_RIGHT,
    3: Image.Transpose.ROTATE_180,
    4: Image.Transpose.FLIP_TOP_BOTTOM,
    5: Image.Transpose.TRANSPOSE,
    6: Image.Transpose.ROTATE_270,
    7: Image.Transpose.TRANSVERSE,
    8: Image.Transpose.ROTATE_90,
}


@dataclasses.dataclass(frozen=True)
class ImageHeader:
    """Size and orientation of an image file.

    Attributes:
        size: width and height of the whole image, upright.
        orientation: of the stored pixels, 1 to 8 as in EXIF; 1 is upright, also for undefined values (0, 9, ...).
    """

    size: tuple[int, int]
    orientation: int


@dataclasses.dataclass(frozen=True)
class DecodedImage(ImageHeader):
    """An image file, decoded.

    Attributes:
        image: upright, in the mode of the file; reduced, if that was asked for.
    """

    image: Image.Image


@dataclasses.dataclass(frozen=True)
class RgbImage(ImageHeader):
    """A photograph.

    Attributes:
        rgb: ``(H, W, 3)`` uint8, upright; reduced, if that was asked for.
    """

    rgb: NDArray[np.uint8]


def read_rgb(path: str | pathlib.Path, max_pixels: int | None = None) -> NDArray[np.uint8]:
    """Read an image file as ``(H, W, 3)`` uint8 in RGB, upright; see `read_image`."""
    return read_image(path, max_pixels).rgb


def read_image(path: str | pathlib.Path, max_pixels: int | None = None) -> RgbImage:
    """Read an image file.

    Args:
        path: JPEG, PNG, WebP, BMP, TIFF, PPM or AVIF; HEIC with the extra ``heic``.
        max_pixels: a larger image is scaled down by area to `fitting_size`, with less memory and time than afterwards.

    Raises:
        DataError: the file is missing, cannot be decoded, or has no single meaning as an image of RGB with 8 bits.
    """
    path = pathlib.Path(path)
    decoded = decode_image(path, max_pixels)
    rgb, size = _as_rgb(path, decoded.image), fitting_size(decoded.size, max_pixels)
    if rgb.size != size:
        rgb = rgb.resize(size, Image.Resampling.BOX)
    return RgbImage(decoded.size, decoded.orientation, np.array(rgb))


def read_header(path: str | pathlib.Path) -> ImageHeader:
    """Read size and orientation of an image file.

    Raises:
        DataError: see `decode_image`.
    """
    decoded = decode_image(path, max_pixels=1)
    return ImageHeader(decoded.size, decoded.orientation)


def fitting_size(size: tuple[int, int], max_pixels: int | None) -> tuple[int, int]:
    """Return the (width, height) of an image after scaling it down to at most ``max_pixels``; None keeps every size."""
    width, height = size
    scale = 1.0 if max_pixels is None else math.sqrt(max_pixels / (width * height))
    return (width, height) if scale >= 1.0 else (max(1, int(width * scale)), max(1, int(height * scale)))


def decode_image(path: str | pathlib.Path, max_pixels: int | None = None) -> DecodedImage:
    """Decode an image file of any mode.

    Args:
        max_pixels: a JPEG may be decoded at 1/2, 1/4 or 1/8 of its size, with at least this number of pixels.

    Raises:
        DataError: the file is missing, not an image, damaged, too large, or holds several pictures.
    """
    path = pathlib.Path(path)
    require_utf8_name(path)
    if path.exists() and not path.is_file():  # reading a named pipe would block
        raise DataError(path, "is not a file; give an image file")
    try:
        with path.open("rb") as file, warnings.catch_warnings():
            warnings.simplefilter("ignore")  # about damaged EXIF data, and sizes that are checked here
            return _decoded(path, file, max_pixels)
    except OSError as error:
        raise DataError(path, f"cannot be read ({error.strerror or error}); restore the file") from error


def _decoded(path: pathlib.Path, file: BinaryIO, max_pixels: int | None) -> DecodedImage:
    try:
        with Image.open(file, formats=_formats()) as image:
            _check_header(path, image)
            if image.format == "PNG":
                with Image.open(path, formats=("PNG",)) as checked:
                    checked.verify()  # the checksums, which decoding ignores
            orientation, size = _orientation(image), image.size
            if max_pixels is not None:
                image.draft(None, fitting_size(size, max_pixels))
            image.load()
            if orientation not in _TURNS:
                return DecodedImage(size, 1, image)
            if image.format == "TIFF":  # Pillow turns it by itself
                return DecodedImage(size, orientation, image)
            size = size[::-1] if orientation >= 5 else size
            return DecodedImage(size, orientation, image.transpose(_TURNS[orientation]))
    except DataError:
        raise
    except Image.DecompressionBombError as error:
        n_pixels = int((re.findall(r"\d+", str(error)) or ["0"])[0])
        raise DataError(path, _too_large(f"about {n_pixels / 1e6:.0f} million pixels")) from error
    except Exception as error:  # the type depends on the file format
        raise DataError(path, _unreadable(path, error)) from error


def _orientation(image: Image.Image) -> Any:
    try:
        return image.getexif().get(_EXIF_ORIENTATION, 1)
    except Exception:  # damaged EXIF data do not matter; damaged pixels raise again when they are loaded
        return 1


def _check_header(path: pathlib.Path, image: Image.Image) -> None:
    if image.width * image.height > MAX_PIXELS:
        raise DataError(path, _too_large(f"{image.width} x {image.height} pixels"))
    tags = getattr(image, "tag_v2", {})
    if _DNG_VERSION in tags or tags.get(_TIFF_SUBFILE_TYPE, 0) & 1:
        raise DataError(path, "is the raw file of a camera, or starts with a preview; convert it to JPEG or PNG")
    n_frames = getattr(image, "n_frames", 1)
    if n_frames > 1 and image.format not in _SEVERAL_PICTURES:
        raise DataError(path, f"holds {n_frames} pictures; save the one to use as a file of its own")


def _too_large(size: str) -> str:
    return f"has {size}, at most {MAX_PIXELS / 1e6:.0f} million are allowed; scale it down, or make it smaller"


def _formats() -> list[str]:
    """Return the formats that can be read here; registers HEIC if its package is installed."""
    if "HEIF" not in Image.OPEN:
        try:
            import pi_heif

            pi_heif.register_heif_opener()
        except ImportError:
            pass
    Image.init()
    return [name for name in _FORMATS if name in Image.OPEN]


def _unreadable(path: pathlib.Path, error: Exception) -> str:
    size = path.stat().st_size
    with path.open("rb") as file:
        start = file.read(64)
    if start[4:8] == b"ftyp" and start[8:12] in _HEIF_BRANDS and "HEIF" not in Image.OPEN:
        return "is a HEIC image; install the extra heic (pip install pi-heif), or convert it to JPEG"
    if start.startswith(b"version https://git-lfs"):
        return "is a pointer of Git LFS and not the image; restore the file with git lfs pull"
    unknown = isinstance(error, Image.UnidentifiedImageError)
    reason = "unknown format" if unknown else " ".join(str(error).split())[:120] or type(error).__name__
    return f"is not a readable image ({size} bytes; {reason}); restore it, convert it to JPEG or PNG, or remove it"


def _as_rgb(path: pathlib.Path, image: Image.Image) -> Image.Image:
    """Convert to RGB with 8 bits per channel, or refuse."""
    if image.has_transparency_data:
        image = image.convert("RGBA")
        histogram = image.getchannel("A").histogram()
        if n_transparent := sum(histogram[:255]):
            share = n_transparent / (image.width * image.height)
            raise DataError(path, f"is transparent in {share:.1%} of its pixels; save it without transparency")
    if image.mode == "CMYK":
        image = _from_cmyk(image)
    if image.mode in ("I", "I;16", "I;16B", "I;16L"):  # older releases of Pillow open a PNG of 16 bits as "I"
        return Image.fromarray(_eight_bits(path, np.asarray(image))).convert("RGB")
    if image.mode not in ("RGB", "RGBA", "RGBX", "L", "LA", "1", "P", "PA", "YCbCr", "HSV"):
        kind = "floating-point values" if image.mode == "F" else f"the mode {image.mode}"
        raise DataError(path, f"has {kind}; {_CONVERT}")
    return image if image.mode == "RGB" else image.convert("RGB")


def _eight_bits(path: pathlib.Path, values: NDArray[Any]) -> NDArray[np.uint8]:
    """Scale the full range of 16 bits to 8; refuse values of fewer bits, whose white is not known."""
    smallest, largest = int(values.min()), int(values.max())
    if smallest < 0 or 0 < largest < 2**12 or largest >= 2**16:
        raise DataError(path, f"has more than 8 bits per pixel, with values from {smallest} to {largest}; {_CONVERT}")
    return np.asarray((values.astype(np.uint32) + 128) // 257, np.uint8)


def _from_cmyk(image: Image.Image) -> Image.Image:
    """Convert by the embedded color profile if it is one of CMYK, else by Pillow's formula."""
    try:
        profile = ImageCms.ImageCmsProfile(io.BytesIO(image.info["icc_profile"]))
        converted = ImageCms.profileToProfile(image, profile, ImageCms.createProfile("sRGB"), outputMode="RGB")
    except (KeyError, OSError, ImageCms.PyCMSError):
        return image.convert("RGB")
    return image if converted is None else converted
