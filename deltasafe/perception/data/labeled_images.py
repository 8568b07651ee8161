"""Sets of labeled hand images: read from a folder, checked before anything is computed from them."""

import dataclasses
import hashlib
import io
import pathlib
import warnings

import cv2
import numpy as np
from PIL import Image

from deltasafe.errors import DataError
from deltasafe.io.storage import digest_of, sha256_of_file

__all__ = ["LabeledImage", "LabeledImageSet", "check_disjoint", "read_mask", "read_registry", "read_rgb"]

_EXIF_ORIENTATION = 0x0112
IMAGE_SUFFIXES = (".jpg", ".jpeg", ".png")
MOST_PIXELS = 80_000_000
"""Of an image; a header of a few bytes can claim any number, and memory is reserved for it."""


@dataclasses.dataclass(frozen=True)
class LabeledImage:
    """One labeled image: its id (the common stem of both files) and where image and mask lie."""

    id: str
    image: pathlib.Path
    mask: pathlib.Path


@dataclasses.dataclass(frozen=True)
class LabeledImageSet:
    """Images of hands with their masks, in the order of their ids.

    Attributes:
        name: the folder's name.
        items: the labeled images, sorted by id.
        pixel_digests: SHA-256 of the decoded pixels of each image, in the order of ``items``.
        digest: SHA-256 over ids, pixels and masks; equal digests mean equal sets, wherever they lie.
    """

    name: str
    items: tuple[LabeledImage, ...]
    pixel_digests: tuple[str, ...]
    digest: str

    @classmethod
    def load(cls, folder: str | pathlib.Path, registry: str | pathlib.Path | None = None) -> "LabeledImageSet":
        """Read and check the set in ``folder``, which holds ``images/`` and ``masks/`` with files of equal
        stems.

        Args:
            folder: the set. Images are RGB with 8 bits a channel (JPEG or PNG, of any size); masks are of one
                channel and of the size of their image, 255 where there is hand and 0 elsewhere.
            registry: a file of SHA-256 sums (as by ``sha256sum``, paths relative to the registry's folder)
                against
                which every file of the set is compared.

        Raises:
            DataError: naming the first defective file, what is wrong and what to do.
        """
        folder = pathlib.Path(folder)
        images, masks = _files(folder / "images"), _files(folder / "masks")
        for stem in sorted(images.keys() ^ masks.keys()):
            path, other = (images[stem], "masks") if stem in images else (masks[stem], "images")
            raise DataError(path, f"has no counterpart in {other}/; give both files the same stem, or remove it")
        if not images:
            raise DataError(folder, "holds no images; put them into images/ and their masks into masks/")
        items = tuple(LabeledImage(stem, images[stem], masks[stem]) for stem in sorted(images))
        if registry is not None:
            _check_registered(items, pathlib.Path(registry))
        pixel_digests, contents = [], []
        for item in items:
            rgb, mask = _read(item)
            pixel_digests.append(_pixel_digest(rgb))
            contents.append((item.id, pixel_digests[-1], _pixel_digest(mask)))
        return cls(folder.name, items, tuple(pixel_digests), digest_of(contents))

    def __len__(self) -> int:
        return len(self.items)

    def read(self, i: int) -> tuple[np.ndarray, np.ndarray]:
        """Image ``(H, W, 3)`` uint8 in RGB and mask ``(H, W)`` uint8 (1 = hand) of the ``i``-th item.

        Raises:
            DataError: a file is missing or defective.
        """
        return _read(self.items[i])


def check_disjoint(train: LabeledImageSet, test: LabeledImageSet) -> None:
    """Refuse a test set that shares an image with the training set, under whatever name.

    Raises:
        DataError: naming the image of ``test`` whose decoded pixels also occur in ``train``.
    """
    known = dict(zip(train.pixel_digests, train.items, strict=True))
    for digest, item in zip(test.pixel_digests, test.items, strict=True):
        if digest in known:
            raise DataError(
                item.image,
                f"has the same pixels as {known[digest].image} of the training set; "
                "remove it from one of the two, or every figure measured on the test set is too good",
            )


def read_rgb(path: str | pathlib.Path) -> np.ndarray:
    """An image file as ``(H, W, 3)`` uint8 in RGB.

    Raises:
        DataError: the file is missing, cannot be decoded, or is not RGB with 8 bits a channel.
    """
    image = _decode(pathlib.Path(path))
    if image.ndim != 3 or image.shape[2] != 3 or image.dtype != np.uint8:
        channels = 1 if image.ndim == 2 else image.shape[2]
        raise DataError(path, f"has {channels} channel(s) of {image.dtype}; convert it to RGB with 8 bits a channel")
    return cv2.cvtColor(image, cv2.COLOR_BGR2RGB)


def read_mask(path: str | pathlib.Path) -> np.ndarray:
    """A mask as ``(H, W)`` uint8: 255 where there is hand, somewhere, and 0 elsewhere.

    Raises:
        DataError: the file is missing, cannot be decoded, or holds anything else.
    """
    path = pathlib.Path(path)
    mask = _decode(path)
    if mask.ndim != 2 or mask.dtype != np.uint8:
        channels = 1 if mask.ndim == 2 else mask.shape[2]
        raise DataError(
            path, f"has {channels} channel(s) of {mask.dtype}; a mask is of one channel with 8 bits, convert it"
        )
    values = np.unique(mask)
    if not np.isin(values, (0, 255)).all():
        found = ", ".join(str(value) for value in values if value not in (0, 255))
        hint = "; JPEG cannot hold a mask" if path.suffix.lower() != ".png" else ""
        raise DataError(path, f"holds the value(s) {found[:60]}; only 0 and 255 are allowed, store it as PNG{hint}")
    if 255 not in values:
        raise DataError(path, "marks no hand (255 nowhere); label the image, or remove it from the set")
    return mask


def read_registry(path: str | pathlib.Path) -> dict[str, str]:
    """SHA-256 by relative path, from a file in the format of ``sha256sum``.

    Raises:
        DataError: the file is missing, or a line is not a digest and a path.
    """
    path = pathlib.Path(path)
    if not path.is_file():
        raise DataError(path, "is missing; write it with sha256sum, or load the set without a registry")
    try:
        lines = path.read_text(encoding="utf-8").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise DataError(path, f"cannot be read ({error}); write it with sha256sum") from error
    registry = {}
    for number, line in enumerate(lines, start=1):
        digest, _, name = line.partition("  ")
        if len(digest) != 64 or not name:
            raise DataError(path, f"line {number} is {line!r}, not a SHA-256 sum and a path; write it with sha256sum")
        registry[name] = digest
    return registry


def _files(folder: pathlib.Path) -> dict[str, pathlib.Path]:
    if not folder.is_dir():
        raise DataError(folder, "is not a folder; make it, a set consists of images/ and masks/")
    files: dict[str, pathlib.Path] = {}
    for path in sorted(folder.iterdir()):
        if path.name.startswith("."):
            continue
        if path.suffix.lower() not in IMAGE_SUFFIXES:
            raise DataError(path, f"is no image ({', '.join(IMAGE_SUFFIXES)}); remove or convert it")
        if not path.is_file():
            raise DataError(path, "is no file; remove it, images and masks lie side by side")
        if path.stem in files:
            raise DataError(path, f"has the stem of {files[path.stem].name}; rename or remove one of the two")
        files[path.stem] = path
    return files


def _read(item: LabeledImage) -> tuple[np.ndarray, np.ndarray]:
    rgb = read_rgb(item.image)
    mask = read_mask(item.mask)
    if mask.shape != rgb.shape[:2]:
        raise DataError(
            item.mask,
            f"is {mask.shape[1]} x {mask.shape[0]} but its image is {rgb.shape[1]} x {rgb.shape[0]}; "
            "export both at the same size",
        )
    return rgb, mask // 255


def _decode(path: pathlib.Path) -> np.ndarray:
    if path.exists() and not path.is_file():
        raise DataError(path, "is no file; give an image file")
    try:
        data = path.read_bytes()
    except OSError as error:
        raise DataError(path, f"cannot be read ({error.strerror}); restore the file") from error
    _check_whole(path, data)
    try:
        image = cv2.imdecode(np.frombuffer(data, dtype=np.uint8), cv2.IMREAD_UNCHANGED)
    except cv2.error:
        image = None
    if image is None:
        raise DataError(path, f"is no readable image ({len(data)} bytes); restore or remove it")
    return image


def _check_whole(path: pathlib.Path, data: bytes) -> None:
    """Refuse what a decoder would make an image of all the same: cut short, too large to be one, or to be turned."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of damaged EXIF, which matters only if it can be read
            with Image.open(io.BytesIO(data)) as opened:
                width, height = opened.size
                if width * height > MOST_PIXELS:
                    raise DataError(
                        path,
                        f"claims to be {width} x {height} pixels; at most {MOST_PIXELS} are read, make it smaller",
                    )
                mode, orientation = opened.mode, opened.getexif().get(_EXIF_ORIENTATION, 1)
                opened.load()
    except DataError:
        raise
    except Exception as error:  # of many kinds, as the format is read
        reason = " ".join(str(error).split())[:120].replace(repr(data), "")
        raise DataError(path, f"is no readable image ({len(data)} bytes; {reason}); restore or remove it") from error
    if mode == "CMYK":
        raise DataError(path, "holds the four colors of print (CMYK); convert it to RGB with 8 bits a channel")
    if orientation != 1:
        raise DataError(
            path, f"asks viewers to turn it (EXIF orientation {orientation}), which its mask may not; save it turned"
        )


def _check_registered(items: tuple[LabeledImage, ...], registry: pathlib.Path) -> None:
    digests, root = read_registry(registry), registry.resolve().parent
    for path in (path for item in items for path in (item.image, item.mask)):
        resolved = path.resolve()
        if not resolved.is_relative_to(root) or resolved.relative_to(root).as_posix() not in digests:
            raise DataError(path, f"is not registered in {registry}; the packaged sets are immutable, remove it")
        expected, found = digests[resolved.relative_to(root).as_posix()], sha256_of_file(path)
        if found != expected:
            raise DataError(
                path,
                f"has SHA-256 {found[:12]}..., registered is {expected[:12]}...; restore the original file",
            )


def _pixel_digest(pixels: np.ndarray) -> str:
    return hashlib.sha256(repr(pixels.shape).encode() + np.ascontiguousarray(pixels).tobytes()).hexdigest()
