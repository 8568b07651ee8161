"""Sets of labeled hand images: read from a folder and checked before use."""

import dataclasses
import hashlib
import pathlib
import unicodedata
from collections.abc import Callable, Iterable
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from deltasafe.errors import DataError
from deltasafe.io.checksum_list import listed_name, read_registry
from deltasafe.io.folder_entries import IMAGE_SUFFIXES, FolderEntries, require_utf8_name
from deltasafe.io.images import read_image
from deltasafe.io.storage import digest_of, sha256_of_file
from deltasafe.perception.data.dataset_info import HANDS, DatasetInfo, SetOptions
from deltasafe.perception.data.labeled_pair import aligned_mask, scaled_mask
from deltasafe.perception.data.masks import dither_defect, polarity_defect, read_marked
from deltasafe.perception.data.thumbnails import SIDE_PX, thumbnail

T = TypeVar("T")


@dataclasses.dataclass(frozen=True)
class LabeledImage:
    """One labeled image.

    Attributes:
        id: the common stem of both files, in the Unicode form NFC.
        image, mask: the files.
        mark: gray value or color of the hand in the mask; empty if the mask marks none.
    """

    id: str
    image: pathlib.Path
    mask: pathlib.Path
    mark: str = "255"

    @property
    def shows_hand(self) -> bool:
        """Whether the mask marks a hand."""
        return bool(self.mark)


@dataclasses.dataclass(frozen=True)
class LabeledImageSet:
    """Images of hands with their masks, sorted by id.

    Attributes:
        name: of the folder.
        items: the labeled images, sorted by id.
        pixel_digests: SHA-256 of the decoded pixels of each image, in the order of ``items``.
        digest: SHA-256 over ids, pixels and masks, and the obstacle if it is no hand; it does not depend on the
            folder's path.
        options: how the masks are read, from the file ``dataset.json``.
        info: what the masks mark, from the same file.
        thumbnails: (N, 2, 16, 16) of images and masks, see `near_copies`.
    """

    name: str
    items: tuple[LabeledImage, ...]
    pixel_digests: tuple[str, ...]
    digest: str
    options: SetOptions = dataclasses.field(default_factory=SetOptions)
    info: DatasetInfo = HANDS
    thumbnails: NDArray[np.float32] = dataclasses.field(
        default_factory=lambda: np.zeros((0, 2, SIDE_PX, SIDE_PX), np.float32), compare=False, repr=False
    )

    @classmethod
    def load(cls, folder: str | pathlib.Path, registry: str | pathlib.Path | None = None) -> "LabeledImageSet":
        """Read and check the set in ``folder``: files in ``images/`` and ``masks/`` with equal stems, ``dataset.json``.

        Args:
            folder: the set. Images have any size and any format of `read_image`. Masks have the size of their image;
                0 or black is everything else, and one value or color, the same in all masks, is the hand. Some images
                may show no hand.
            registry: a file of SHA-256 digests in the format of ``sha256sum``, with paths relative to its folder.
                Every file of the set is compared with it.

        Raises:
            DataError: lists every defective file with the defect and the remedy.
        """
        folder, defects = pathlib.Path(folder), list[DataError]()
        if not folder.is_dir():
            raise DataError(folder, "is not a folder; give one that holds images/ and masks/")
        described = read_or_none(lambda path: (DatasetInfo.load(path), SetOptions.load(path)), folder, defects)
        info, options = described or (HANDS, SetOptions())
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
            files = [path for item in items for path in (item.image, item.mask)]
            defects += _unregistered([*files, *folder.glob("dataset.json")], pathlib.Path(registry))
        read, pixel_digests, contents, thumbnails = [], [], [], []
        for item in items:
            if (found := _read_or_note(item, options, defects)) is not None:
                rgb, mask, mark = found
                pixel_digests.append(_pixel_digest(rgb))
                contents.append((item.id, pixel_digests[-1], _pixel_digest(mask)))
                thumbnails.append(thumbnail(rgb, mask))
                read.append(dataclasses.replace(item, mark=mark))
        defects += _different_marks(folder / "masks", read)
        if read and not any(item.shows_hand for item in read):
            defects.append(DataError(folder / "masks", "mark no hand in any image (255 = hand); label the images"))
        if defects:
            raise DataError.combined(folder, defects)
        digest = digest_of(contents if info.obstacle == HANDS.obstacle else [info, contents])
        return cls(folder.name, tuple(read), tuple(pixel_digests), digest, options, info, np.stack(thumbnails))

    def __len__(self) -> int:
        return len(self.items)

    @property
    def without_hand(self) -> tuple[str, ...]:
        """Ids of the images that show no hand."""
        return tuple(item.id for item in self.items if not item.shows_hand)

    @property
    def copies(self) -> tuple[tuple[LabeledImage, LabeledImage], ...]:
        """Images with the same pixels as an earlier one of the set, each with that one."""
        first: dict[str, LabeledImage] = {}
        pairs = zip(self.items, self.pixel_digests, strict=True)
        return tuple((item, first[digest]) for item, digest in pairs if first.setdefault(digest, item) != item)

    def read(self, i: int, max_pixels: int | None = None) -> tuple[np.ndarray, np.ndarray]:
        """Read the ``i``-th image ``(H, W, 3)`` uint8, RGB, upright, and its mask ``(H, W)`` uint8, 1 = hand.

        Args:
            i: index of the image.
            max_pixels: a larger image and its mask are scaled down to at most this number of pixels.

        Raises:
            DataError: a file is missing or defective.
        """
        return read_labeled(self.items[i], self.options, max_pixels)


def check_disjoint(train: LabeledImageSet, test: LabeledImageSet, role: str = "training") -> None:
    """Check that two sets show the same obstacle, and that no image of the test set occurs in the other one.

    Args:
        train: the other set.
        test: the test set.
        role: of ``train``, for the message.

    Raises:
        DataError: lists the images of ``test`` whose decoded pixels also occur in ``train``; or the sets show different
            obstacles.
    """
    test.info.require_same_obstacle(train.info, test.items[0].image.parents[1], role)
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


def check_distinct(images: LabeledImageSet, role: str) -> None:
    """Check that no image occurs twice in a test or calibration set: it would count as evidence twice.

    Args:
        images: the set.
        role: of the set, for the message.

    Raises:
        DataError: lists the images whose decoded pixels occur before in the set.
    """
    defects = [
        DataError(item.image, f"has the same pixels as {first.image.name} of the same {role} set; remove one of them")
        for item, first in images.copies
    ]
    if defects:
        raise DataError.combined(images.items[0].image.parents[1], defects)


def read_or_none(read: Callable[[pathlib.Path], T], path: pathlib.Path, defects: list[DataError]) -> T | None:
    """Return ``read(path)``; if the file is defective, append the error to ``defects`` and return None."""
    try:
        return read(path)
    except DataError as error:
        defects.append(error)
        return None


def _files_by_stem(folder: pathlib.Path, defects: list[DataError]) -> dict[str, pathlib.Path]:
    """Return the images of a folder by stem (in the Unicode form NFC), and append the defects to ``defects``."""
    files: dict[str, pathlib.Path] = {}
    if not folder.is_dir():
        defects.append(DataError(folder, "is not a folder; make it, a set consists of images/ and masks/"))
        return files
    entries = FolderEntries.of(folder)
    for path in entries.others:
        defect = f"is not an image ({', '.join(IMAGE_SUFFIXES)}); remove or convert it"
        if path.is_dir():
            defect = "is not a file; remove it, subfolders are not read"
        defects.append(DataError(path, defect))
    for path in entries.images:
        if read_or_none(require_utf8_name, path, defects) is None:
            continue
        stem = unicodedata.normalize("NFC", path.stem)
        if stem in files:
            same = "the same stem as" if path.stem == files[stem].stem else "in another Unicode form, the stem of"
            defects.append(DataError(path, f"has {same} {files[stem].name}; rename or remove one of the two"))
        else:
            files[stem] = path
    return files


def read_labeled(
    item: LabeledImage, options: SetOptions, max_pixels: int | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """Read an image and its mask, see `LabeledImageSet.read`."""
    defects: list[DataError] = []
    found = _read_or_note(item, options, defects, max_pixels)
    if found is None:
        raise DataError.combined(item.image, defects)
    return found[:2]


def _read_or_note(
    item: LabeledImage, options: SetOptions, defects: list[DataError], max_pixels: int | None = None
) -> tuple[np.ndarray, np.ndarray, str] | None:
    """Read image, mask (1 = hand) and its mark; if they are defective, append the defects and return None."""
    image = read_or_none(lambda path: read_image(path, max_pixels), item.image, defects)
    marked = read_or_none(read_marked, item.mask, defects)
    if image is None or marked is None:
        return None
    mask, mark = marked
    try:
        mask = aligned_mask(image, mask, options, (item.image, item.mask)) // 255
    except DataError as error:
        defects.append(error)
        return None
    if defect := dither_defect(mask):
        defects.append(DataError(item.mask, defect))
        return None
    if not options.large_masks and (doubt := polarity_defect(mask)):
        confirm = f'write {{"large_masks": true}} into {item.mask.parents[1] / "dataset.json"} if it is right'
        invert = "convert the set by `deltasafe hands import SET NEW_SET --inverted` if it is"
        defects.append(DataError(item.mask, f"{doubt} {confirm}, or {invert}"))
        return None
    size = (image.rgb.shape[1], image.rgb.shape[0])
    return image.rgb, mask if size == image.size else scaled_mask(mask, size), mark


def _different_marks(folder: pathlib.Path, items: list[LabeledImage]) -> list[DataError]:
    """Refuse masks that mark with different values: they are classes, of which each mask shows one."""
    example = {item.mark: item.mask.name for item in reversed(items) if item.mark}
    if len(example) < 2:
        return []
    found = ", ".join(f"{mark} ({name})" for mark, name in sorted(example.items())[:8])
    options = " ".join(f"--class '{mark}'" for mark in sorted(example)[:8])
    convert = f"convert the set by `deltasafe hands import SET NEW_SET {options}`, without those that are no obstacle"
    return [
        DataError(folder, f"mark with {len(example)} values or colors, perhaps of several classes: {found}; {convert}")
    ]


def _unregistered(files: Iterable[pathlib.Path], registry: pathlib.Path) -> list[DataError]:
    """List the files whose digest is missing in the registry, or is another one."""
    digests, root, defects = read_registry(registry), registry.resolve().parent, []
    for path in files:
        resolved = path.resolve()
        name = resolved.relative_to(root).as_posix() if resolved.is_relative_to(root) else resolved.as_posix()
        digest = digests.get(listed_name(name)) or digests.get(listed_name(resolved.as_posix()))
        if digest is None:
            reason = f"is not listed in {registry}; add it with `cd {root} && sha256sum '{name}' >> {registry.name}`"
            defects.append(DataError(path, f"{reason}, or remove it"))
        elif (found := sha256_of_file(path)) != digest:
            reason = f"has SHA-256 {found[:12]}..., registered is {digest[:12]}...; restore the original file"
            defects.append(DataError(path, reason))
    return defects


def _pixel_digest(pixels: np.ndarray) -> str:
    digest = hashlib.sha256(repr(pixels.shape).encode())
    digest.update(np.ascontiguousarray(pixels).data)
    return digest.hexdigest()
