"""Masks as tools write them: one bit, gray, palette, colors, alpha or 16 bits."""

import dataclasses
import functools
import pathlib
from collections.abc import Collection, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from deltasafe.errors import DataError
from deltasafe.io.images import decode_image

ANY_CLASS = "*"
_MAX_NAMED = 8
_MIN_DITHERED = 100
"""Marked pixels; a line of one pixel width has two edges for each."""
Pixels = NDArray[np.uint8]
Codes = NDArray[np.unsignedinteger[Any]]


@dataclasses.dataclass(frozen=True)
class MaskPlane:
    """A decoded mask, before it is decided which pixels are obstacle.

    Attributes:
        path: of the file.
        codes: ``(H, W)`` gray values, or colors as ``0xRRGGBB``; 0 is the background.
        full_scale: the largest possible gray value, or 0 if the codes are colors.
        names: names of codes, where the format has them. A code without one is named by its value.
    """

    path: pathlib.Path
    codes: Codes
    full_scale: int
    names: Mapping[int, str] = dataclasses.field(default_factory=dict)

    @functools.cached_property
    def classes(self) -> dict[str, int]:
        """Pixels of each class that occurs, without the background, by name."""
        codes, counts = np.unique(self.codes, return_counts=True)
        return {self.name(int(code)): int(n) for code, n in zip(codes, counts, strict=True) if code}

    @property
    def has_background(self) -> bool:
        """Whether some pixel is 0."""
        return bool((self.codes == 0).any())

    def name(self, code: int) -> str:
        """Return the name of a code: that of the format, the gray value, or the color as ``#rrggbb``."""
        return self.names.get(code) or (str(code) if self.full_scale else f"#{code:06x}")

    def select(self, classes: Collection[str]) -> NDArray[np.bool_]:
        """Return the pixels ``(H, W)`` of the classes."""
        if ANY_CLASS in classes:
            return np.asarray(self.codes != 0)
        present = (int(code) for code in np.unique(self.codes) if code)
        return np.isin(self.codes, [code for code in present if self.name(code) in classes])

    def above(self, threshold: float) -> NDArray[np.bool_]:
        """Return the pixels ``(H, W)`` at or above a fraction of full scale, of a gray mask or one of a single hue.

        Raises:
            DataError: the bright pixels have several hues.
        """
        if self.full_scale:
            return np.asarray(self.codes >= threshold * self.full_scale)
        channels = np.stack([self.codes >> shift & 255 for shift in (16, 8, 0)], axis=-1).astype(np.float64)
        brightness = channels.max(axis=-1)
        bright = channels[brightness >= 255 * threshold]
        if len(bright):
            hue = np.median(bright, axis=0)
            along = (bright @ hue / max(hue @ hue, 1.0))[:, None] * hue
            if np.abs(bright - along).max() > 64:
                raise DataError(self.path, f"has several colors ({self.listed()}); give --class COLOR instead")
        return np.asarray(brightness >= 255 * threshold)

    def listed(self) -> str:
        """List the classes that occur, most pixels first."""
        names = sorted(self.classes, key=lambda name: -self.classes[name])
        more = f" and {len(names) - _MAX_NAMED} more" if len(names) > _MAX_NAMED else ""
        return ", ".join(names[:_MAX_NAMED]) + more


def read_mask_plane(
    path: str | pathlib.Path,
    alpha: bool = False,
    colors: Mapping[int, str] | None = None,
    values: Mapping[int, str] | None = None,
) -> MaskPlane:
    """Read a mask file of any kind.

    Equal channels are one channel. Transparent pixels are background. If all visible pixels have one color, the alpha
    channel is the mask.

    Args:
        path: of the file.
        alpha: take the alpha channel and ignore the colors.
        colors: names of colors ``0xRRGGBB``.
        values: names of gray values.

    Raises:
        DataError: the file is missing, damaged, too large, turned by EXIF, or of a kind that cannot be a mask.
    """
    path = pathlib.Path(path)
    image = _opened(path)
    if "transparency" in image.info:
        image = image.convert("RGBA")
    if alpha and image.mode not in ("LA", "PA", "RGBA"):
        raise DataError(path, f"has no alpha channel (mode {image.mode}); leave out --alpha")
    if image.mode in ("1", "L", "F") or image.mode.startswith("I"):
        codes, full_scale = _gray(path, image)
    elif image.mode in ("P", "PA", "LA", "RGB", "RGBA"):
        codes, full_scale = _colors(image, alpha)
    else:
        raise DataError(path, f"has the mode {image.mode}; save the mask as PNG, gray or with a palette")
    return MaskPlane(path, codes, full_scale, (values if full_scale else colors) or {})


def read_mask(path: str | pathlib.Path, may_be_empty: bool = False) -> Pixels:
    """Read a mask of one class as ``(H, W)`` uint8: 255 marks the hand, 0 everything else.

    Raises:
        DataError: the file is unreadable, or its meaning is ambiguous; the message names the option that decides. Or
            it marks no hand, unless it ``may_be_empty``.
    """
    mask, mark = read_marked(path)
    if not mark and not may_be_empty:
        raise DataError(path, "marks no hand (every pixel is 0); label the image, or remove it from the set")
    return mask


def read_marked(path: str | pathlib.Path) -> tuple[Pixels, str]:
    """Read a mask of one class as `read_mask` does, and the gray value or color of the hand; empty if there is none.

    Raises:
        DataError: see `read_mask`.
    """
    plane = read_mask_plane(path)
    if len(plane.classes) > 1:
        kind = "gray values" if plane.full_scale else "colors"
        options = f"--class '{next(iter(plane.classes))}' if that is the obstacle"
        options += ", or --threshold 0.5 if they are shades" if len(plane.classes) > 2 else ""
        found = f"has {len(plane.classes)} {kind} besides black ({plane.listed()})"
        raise DataError(path, f"{found}; convert the set by `deltasafe hands import SET NEW_SET` with {options}")
    return plane.select([ANY_CLASS]).astype(np.uint8) * 255, next(iter(plane.classes), "")


def polarity_defect(mask: NDArray[np.generic]) -> str | None:
    """Say why a mask ``(H, W)`` is probably inverted: its shares of the image and of the border add up to more than 1.

    Of a mask and its inverse, one is suspected. A share of the image alone would suspect close-ups: of 142 photographs
    of hands, two masks cover more than half, but the greatest sum is 0.91.
    """
    marked = mask != 0
    border = np.concatenate([marked[0], marked[-1], marked[1:-1, 0], marked[1:-1, -1]])
    if marked.mean() + border.mean() <= 1:
        return None
    return f"marks {marked.mean():.0%} of the image and {border.mean():.0%} of its border: is it inverted?"


def dither_defect(mask: NDArray[np.generic]) -> str | None:
    """Say why a mask ``(H, W)`` was probably dithered, as a conversion to one bit does by default: it is all edges."""
    marked = mask != 0
    n_edges = np.count_nonzero(marked[1:] != marked[:-1]) + np.count_nonzero(marked[:, 1:] != marked[:, :-1])
    if n_edges < 2 * max(int(marked.sum()), _MIN_DITHERED):
        return None
    return "is speckled, as after dithering; save it again without dithering, or with more than one bit"


def _opened(path: pathlib.Path) -> Image.Image:
    decoded = decode_image(path)
    if decoded.orientation != 1:
        raise DataError(path, f"has EXIF orientation {decoded.orientation}; save the mask without it, as PNG")
    return decoded.image


def _gray(path: pathlib.Path, image: Image.Image) -> tuple[Codes, int]:
    pixels = np.asarray(image)
    if pixels.dtype == bool:
        return pixels.astype(np.uint8) * np.uint8(255), 255
    if pixels.dtype == np.uint8:
        return pixels, 255
    if pixels.dtype.kind == "f":
        if not (np.isfinite(pixels).all() and pixels.min() >= 0 and pixels.max() <= 1):
            raise DataError(path, "has floats outside [0, 1]; save the mask as PNG with 8 or 16 bits")
        pixels = np.round(pixels * 65535).astype(np.int64)
    if pixels.min() < 0 or pixels.max() > 65535:
        raise DataError(path, "has values outside 16 bits; save the mask as PNG with 8 or 16 bits")
    codes = pixels.astype(np.uint16)
    if (codes % 257).any():
        return codes, 65535
    return (codes // 257).astype(np.uint8), 255  # 8 bits that a tool has widened


def _colors(image: Image.Image, alpha: bool) -> tuple[Codes, int]:
    pixels = np.asarray(image.convert("RGB" if image.mode in ("P", "RGB") else "RGBA"))
    if image.mode == "P":
        indices, (codes, full_scale) = np.asarray(image), _packed(pixels)
        is_distinct = len(np.unique(codes)) == len(np.unique(indices))  # else only the index tells classes apart
        return (codes, full_scale) if is_distinct else (indices, 255)
    if pixels.shape[2] == 3:
        return _packed(pixels)
    opacity = pixels[..., 3]
    is_opaque = opacity.min() == opacity.max()
    if alpha or (not is_opaque and len(np.unique(_packed(pixels)[0][opacity > 0])) == 1):
        return opacity, 255
    visible = pixels[..., :3] if is_opaque else (pixels[..., :3] * (opacity[..., None] / 255)).astype(np.uint8)
    return _packed(visible)


def _packed(pixels: Pixels) -> tuple[Codes, int]:
    """Return gray values if the channels red, green and blue are equal, else colors as ``0xRRGGBB``; and full scale."""
    red, green, blue = (pixels[..., channel] for channel in range(3))
    if np.array_equal(red, green) and np.array_equal(green, blue):
        return red, 255
    packed = red.astype(np.uint32) << 16 | green.astype(np.uint32) << 8 | blue
    return packed.astype(np.uint32, copy=False), 0
