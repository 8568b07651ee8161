"""Sets of labeled hand images: read from a folder and checked before use."""

import dataclasses
import hashlib
import io
import pathlib
import warnings
from collections.abc import Callable

import cv2
import numpy as np
from PIL import Image

from deltasafe.errors import DataError
from deltasafe.io.storage import digest_of, sha256_of_file
from deltasafe.perception.data.masks import read_mask

_EXIF_ORIENTATION = 0x0112
IMAGE_SUFFIXES = (".jpg", ".jpeg", ".png")
MAX_PIXELS = 80_000_000
"""Of one image. A corrupt header of a few bytes can claim any size, and the decoder would allocate it."""


@dataclasses.dataclass(frozen=True)
class LabeledImage:
    """One labeled image: its id (the common stem of both files) and the paths of image and mask."""

    id: str
    image: pathlib.Path
    mask: pathlib.Path


@dataclasses.dataclass(frozen=True)
class LabeledImageSet:
    """Images of hands with their masks, sorted by id.

    Attributes:
        name: of the folder.
        items: the labeled images, sorted by id.
        pixel_digests: SHA-256 of the decoded pixels of each image, in the order of ``items``.
        digest: SHA-256 over ids, pixels and masks; it does not depend on the folder's path.
    """

    name: str
    items: tuple[LabeledImage, ...]
    pixel_digests: tuple[str, ...]
    digest: str

    @classmethod
    def load(cls, folder: str | pathlib.Path, registry: str | pathlib.Path | None = None) -> "LabeledImageSet":
        """Read and check the set in ``folder``: files in ``images/`` and ``masks/`` with equal stems.

        Args:
            folder: the set. Images are RGB with 8 bits per channel (JPEG or PNG, any size). Masks have one channel
                and the size of their image; 255 marks the hand, 0 everything else.
            registry: a file of SHA-256 digests in the format of ``sha256sum``, with paths relative to its folder.
                Every file of the set is compared with it.

        Raises:
            DataError: lists every defective file with the defect and the remedy.
        """
        folder, defects = pathlib.Path(folder), list[DataError]()
        if not folder.is_dir():
            raise DataError(folder, "is not a folder; give one that holds images/ and masks/")
        images, masks = (_files_by_stem(folder / part, defects) for part in ("images", "masks"))
        for stem in sorted(images.keys() ^ masks.keys()) if images and masks else ():
            path, other = (images[stem], "masks") if stem in images else (masks[stem], "images")
            defects.append(
                DataError(path, f"has no counterpart in {other}/; give both files the same stem, or remove it")
            )
        items = tuple(LabeledImage(stem, images[stem], masks[stem]) for stem in sorted(images.keys() & masks.keys()))
        if not items and not defects:
            defects.append(DataError(folder, "holds no images; put them into images/ and their masks into masks/"))
        if registry is not None:
            defects += _unregistered(items, pathlib.Path(registry))
        pixel_digests, contents = [], []
        for item in items:
            rgb, mask = _read_pair(item, defects)
            if rgb is not None and mask is not None:
                pixel_digests.append(_pixel_digest(rgb))
                contents.append((item.id, pixel_digests[-1], _pixel_digest(mask)))
        if defects:
            raise DataError.combined(folder, defects)
        return cls(folder.name, items, tuple(pixel_digests), digest_of(contents))

    def __len__(self) -> int:
        return len(self.items)

    def read(self, i: int) -> tuple[np.ndarray, np.ndarray]:
        """Read the ``i``-th image ``(H, W, 3)`` uint8, RGB, and its mask ``(H, W)`` uint8, 1 = hand.

        Raises:
            DataError: a file is missing or defective.
        """
        return _read(self.items[i])


def check_disjoint(train: LabeledImageSet, test: LabeledImageSet, role: str = "training") -> None:
    """Check that no image of the test set occurs in another set, under any name.

    Args:
        train: the other set.
        test: the test set.
        role: of ``train``, for the message.

    Raises:
        DataError: lists the images of ``test`` whose decoded pixels also occur in ``train``.
    """
    known = dict(zip(train.pixel_digests, train.items, strict=True))
    defects = [
        DataError(
            item.image,
            f"has the same pixels as {known[digest].image} of the {role} set; remove it from one of the two sets, "
            "because it makes all results on the test set too optimistic",
        )
        for digest, item in zip(test.pixel_digests, test.items, strict=True)
        if digest in known
    ]
    if defects:
        raise DataError.combined(test.items[0].image.parents[1], defects)


def read_rgb(path: str | pathlib.Path) -> np.ndarray:
    """Read an image file as ``(H, W, 3)`` uint8 in RGB.

    Raises:
        DataError: the file is missing, cannot be decoded, or is not RGB with 8 bits per channel.
    """
    image = _decode(pathlib.Path(path))
    if image.ndim != 3 or image.shape[2] != 3 or image.dtype != np.uint8:
        raise DataError(path, f"has {_channels(image)}; convert it to RGB with 8 bits per channel")
    return cv2.cvtColor(image, cv2.COLOR_BGR2RGB)


def read_or_none(
    read: Callable[[pathlib.Path], np.ndarray], path: pathlib.Path, defects: list[DataError]
) -> np.ndarray | None:
    """Return ``read(path)``; if the file is defective, append the error to ``defects`` and return None."""
    try:
        return read(path)
    except DataError as error:
        defects.append(error)
        return None


def resize_labeled(
    rgb: np.ndarray, mask: np.ndarray, size: tuple[int, int], interpolation: int
) -> tuple[np.ndarray, np.ndarray]:
    """Resize an image and its mask to ``size`` (width, height); a pixel is hand if at least half of it is covered."""
    coverage = cv2.resize(mask.astype(np.float32), size, interpolation=interpolation)
    return cv2.resize(rgb, size, interpolation=interpolation), (coverage >= 0.5).astype(np.uint8)


def read_registry(path: str | pathlib.Path) -> dict[str, str]:
    """Read SHA-256 digests by relative path from a file in the format of ``sha256sum``.

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
            raise DataError(path, f"line {number} is {line!r}, not a SHA-256 and a path; write it with sha256sum")
        registry[name] = digest
    return registry


def _files_by_stem(folder: pathlib.Path, defects: list[DataError]) -> dict[str, pathlib.Path]:
    """Return the images of a folder by stem, and append the defects to ``defects``."""
    files: dict[str, pathlib.Path] = {}
    if not folder.is_dir():
        defects.append(DataError(folder, "is not a folder; make it, a set consists of images/ and masks/"))
        return files
    for path in sorted(folder.iterdir()):
        if path.name.startswith("."):
            continue
        if path.suffix.lower() not in IMAGE_SUFFIXES:
            defect = f"is not an image ({', '.join(IMAGE_SUFFIXES)}); remove or convert it"
        elif not path.is_file():
            defect = "is not a file; remove it, subfolders are not read"
        elif path.stem in files:
            defect = f"has the same stem as {files[path.stem].name}; rename or remove one of the two"
        else:
            files[path.stem] = path
            continue
        defects.append(DataError(path, defect))
    return files


def _read(item: LabeledImage) -> tuple[np.ndarray, np.ndarray]:
    defects: list[DataError] = []
    rgb, mask = _read_pair(item, defects)
    if rgb is None or mask is None or defects:
        raise DataError.combined(item.image, defects)
    return rgb, mask


def _read_pair(item: LabeledImage, defects: list[DataError]) -> tuple[np.ndarray | None, np.ndarray | None]:
    """Read image and mask (1 = hand); a defective one is None, and its defect is appended to ``defects``."""
    rgb, mask = read_or_none(read_rgb, item.image, defects), read_or_none(read_mask, item.mask, defects)
    if rgb is not None and mask is not None and mask.shape != rgb.shape[:2]:
        sizes = f"is {mask.shape[1]} x {mask.shape[0]} but its image is {rgb.shape[1]} x {rgb.shape[0]}"
        defects.append(DataError(item.mask, f"{sizes}; export both at the same size"))
    return rgb, None if mask is None else mask // 255


def _channels(image: np.ndarray) -> str:
    return f"{1 if image.ndim == 2 else image.shape[2]} channel(s) of {image.dtype}"


def _decode(path: pathlib.Path) -> np.ndarray:
    if path.exists() and not path.is_file():
        raise DataError(path, "is not a file; give an image file")
    try:
        data = path.read_bytes()
    except OSError as error:
        raise DataError(path, f"cannot be read ({error.strerror}); restore the file") from error
    _check_image(path, data)
    try:
        image = cv2.imdecode(np.frombuffer(data, dtype=np.uint8), cv2.IMREAD_UNCHANGED)
    except cv2.error:
        image = None
    if image is None:
        raise DataError(path, f"is not a readable image ({len(data)} bytes); restore or remove it")
    return image


def _check_image(path: pathlib.Path, data: bytes) -> None:
    """Refuse images that OpenCV decodes without an error: truncated, too large, CMYK, or with an EXIF rotation."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # damaged EXIF does not matter: the orientation then defaults to 1
            with Image.open(io.BytesIO(data)) as opened:
                width, height = opened.size
                if width * height > MAX_PIXELS:
                    raise DataError(path, f"has {width} x {height} pixels; at most {MAX_PIXELS} are allowed")
                mode, orientation = opened.mode, opened.getexif().get(_EXIF_ORIENTATION, 1)
                opened.load()
    except DataError:
        raise
    except Exception as error:  # the type depends on the file format
        reason = " ".join(str(error).split())[:120].replace(repr(data), "")
        raise DataError(path, f"is not a readable image ({len(data)} bytes; {reason}); restore or remove it") from error
    if mode == "CMYK":
        raise DataError(path, "has CMYK colors; convert it to RGB with 8 bits per channel")
    if orientation != 1:
        raise DataError(
            path,
            f"has EXIF orientation {orientation}, and its mask may not be rotated in the same way; "
            "rotate the pixels and remove the tag",
        )


def _unregistered(items: tuple[LabeledImage, ...], registry: pathlib.Path) -> list[DataError]:
    """List the files whose digest is missing in the registry, or is another one."""
    digests, root, defects = read_registry(registry), registry.resolve().parent, []
    for path in (path for item in items for path in (item.image, item.mask)):
        resolved = path.resolve()
        name = resolved.relative_to(root).as_posix() if resolved.is_relative_to(root) else ""
        if name not in digests:
            reason = f"is not registered in {registry}; the packaged sets are immutable, remove it"
            defects.append(DataError(path, reason))
        elif (found := sha256_of_file(path)) != digests[name]:
            reason = f"has SHA-256 {found[:12]}..., registered is {digests[name][:12]}...; restore the original file"
            defects.append(DataError(path, reason))
    return defects


def _pixel_digest(pixels: np.ndarray) -> str:
    return hashlib.sha256(repr(pixels.shape).encode() + np.ascontiguousarray(pixels).tobytes()).hexdigest()
