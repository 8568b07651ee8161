"""The augmented training set on disk: arrays of images and masks, and the recipe of every image."""

import collections
import contextlib
import dataclasses
import functools
import json
import os
import pathlib
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from deltasafe.compute.executor import LOCAL, Task
from deltasafe.compute.progress import Progress, silent
from deltasafe.errors import DataError
from deltasafe.io.storage import atomic_folder, digest_of, read_json, write_json
from deltasafe.perception.data.augmentation import METHOD_NAMES, AugmentationSettings
from deltasafe.perception.data.augmentation.augment import AugmentedImage, pixel_digest
from deltasafe.perception.data.augmentation.background import Backgrounds
from deltasafe.perception.data.dataset_info import HANDS, DatasetInfo
from deltasafe.perception.data.labeled_images import LabeledImageSet
from deltasafe.perception.data.schemes import SCHEMES, SchemeSettings, scheme_name
from deltasafe.perception.data.schemes.generation import VariantGenerator, size_and_mask_dtype, variant_generator
from deltasafe.perception.data.schemes.mixup import soft_labels

FORMAT = 1


@dataclasses.dataclass(frozen=True)
class AugmentedSet:
    """A stored augmented set, memory-mapped.

    Attributes:
        folder: of the stored set.
        images: ``(N, H, W, 3)`` uint8, RGB, read-only.
        masks: ``(N, H, W)``, read-only: uint8 with 1 = hand, or soft masks in uint16 with 65535 = hand.
        recipes: source, seed and operations of each image; all variants of an original are consecutive.
        settings: of the augmentation scheme.
        source_digest: of the set of originals.
        background_digest: of the background photographs; empty without photographs.
        digest: SHA-256 of settings, sources and recipes; the recipes contain the digests of the pixels.
        without_hand: ids of the originals that show no hand.
        info: what the masks mark.
    """

    folder: pathlib.Path
    images: np.ndarray
    masks: np.ndarray
    recipes: tuple[dict[str, Any], ...]
    settings: SchemeSettings
    source_digest: str
    background_digest: str
    digest: str
    without_hand: frozenset[str] = frozenset()
    info: DatasetInfo = HANDS

    @classmethod
    def load(cls, folder: str | pathlib.Path) -> "AugmentedSet":
        """Open a stored set. Checks everything except the pixels, which :meth:`verify` checks.

        Raises:
            DataError: a file is missing or has another format, or the files do not belong together.
        """
        folder = pathlib.Path(folder)
        header = read_json(folder / "set.json")
        if not isinstance(header, dict) or header.get("format") != FORMAT:
            raise DataError(folder / "set.json", f"does not have format {FORMAT}; make the augmented set again")
        scheme = header.get("scheme", "ours")
        if scheme not in SCHEMES:
            raise DataError(folder / "set.json", f"has the unknown scheme {scheme!r}; known: {', '.join(SCHEMES)}")
        settings = SCHEMES[scheme](**header["settings"])
        n, (size, mask_dtype) = header["n"], size_and_mask_dtype(settings)
        images = _open_array(folder / "images.npy", (n, *size, 3), np.uint8)
        masks = _open_array(folder / "masks.npy", (n, *size), mask_dtype)
        recipes = _read_recipes(folder / "recipes.jsonl")
        if len(recipes) != n:
            raise DataError(folder / "recipes.jsonl", f"has {len(recipes)} recipes for {n} images; make the set again")
        source, background = header["source_digest"], header["background_digest"]
        digest = _digest(settings, source, background, recipes)
        if digest != header["digest"]:
            raise DataError(folder, "has a digest that differs from its recipes' digest; make the augmented set again")
        without_hand, info = frozenset(header.get("without_hand", ())), DatasetInfo.load(folder)
        return cls(folder, images, masks, recipes, settings, source, background, digest, without_hand, info)

    @property
    def n(self) -> int:
        """Number of images."""
        return len(self.recipes)

    @property
    def n_distinct(self) -> int:
        """Number of different images; a scheme with few possible variants draws some of them repeatedly."""
        return len({recipe["digest"] for recipe in self.recipes})

    def labels(self, indices: NDArray[np.integer] | slice) -> NDArray[np.float32]:
        """``(B, H, W)`` float32 in [0, 1]: the hand's coverage of each pixel, of the images at ``indices``."""
        return soft_labels(self.masks[indices])

    def verify(self) -> None:
        """Compare every image and mask with the digest in its recipe.

        Raises:
            DataError: names the first image that differs.
        """
        for i, recipe in enumerate(self.recipes):
            if pixel_digest(self.images[i], self.masks[i]) != recipe["digest"]:
                raise DataError(self.folder, f"image {i} differs from its recipe; make the augmented set again")


def augment_images(
    images: LabeledImageSet,
    folder: str | pathlib.Path,
    settings: SchemeSettings | None = None,
    backgrounds: str | pathlib.Path | None = None,
    *,
    workers: int = 2,
    progress: Progress = silent,
) -> AugmentedSet:
    """Make ``settings.n_variants`` new images of each original and store them as one folder.

    Args:
        images: the labeled originals.
        folder: destination; an existing folder is replaced when the new one is complete.
        settings: of a scheme of `deltasafe.perception.data.schemes`; their class selects it. Default: our scheme. It
            leaves skin tones and clothing out unless the images show hands (`DatasetInfo.hand_recipe`).
        backgrounds: folder of photographs without hands, for our scheme. None: procedural surfaces only.
        workers: number of processes; the result does not depend on it. 1 works in this process; more need the guard
            ``if __name__ == "__main__":`` in a script.
        progress: called after each original, in the order in which they are finished.

    Raises:
        DataError: an original or a background is defective.
        SettingsError: ``workers`` is less than 1.
    """
    settings = settings or AugmentationSettings()
    ours = isinstance(settings, AugmentationSettings)
    if isinstance(settings, AugmentationSettings) and not images.info.hand_recipe:
        settings = settings.without_hand_parts()
    photographs = Backgrounds.load(backgrounds if ours else None)
    if photographs.ignored:
        progress(0, len(images), f"ignored in {backgrounds}: {photographs.ignored}")
    with atomic_folder(folder) as temporary:
        try:
            recipes = _write_images(images, temporary, settings, photographs, workers, progress)
        finally:  # a single worker is this process
            _cached_generator.cache_clear()
        with (temporary / "recipes.jsonl").open("w", encoding="utf-8") as file:
            file.writelines(json.dumps(recipe) + "\n" for recipe in recipes)
        applied = collections.Counter(dict.fromkeys(METHOD_NAMES, 0) if ours else {})
        applied.update(step["method"] for recipe in recipes for step in recipe["operations"])
        header = {
            "format": FORMAT,
            "n": len(recipes),
            "settings": dataclasses.asdict(settings),
            "source": images.name,
            "source_digest": images.digest,
            "background_digest": photographs.digest,
            "digest": _digest(settings, images.digest, photographs.digest, recipes),
            "applied": applied,
            "without_hand": images.without_hand,
            **({} if ours else {"scheme": scheme_name(settings)}),
        }
        write_json(temporary / "set.json", header)
        images.info.save(temporary)
    return AugmentedSet.load(folder)


def _write_images(
    images: LabeledImageSet,
    folder: pathlib.Path,
    settings: SchemeSettings,
    backgrounds: Backgrounds,
    workers: int,
    progress: Progress,
) -> tuple[dict[str, Any], ...]:
    """Write the arrays and return the recipes. In memory are only the variants of one original per worker."""
    n, (size, mask_dtype) = len(images) * settings.n_variants, size_and_mask_dtype(settings)
    stored_images = _allocate(folder / "images.npy", np.uint8, (n, *size, 3))
    stored_masks = _allocate(folder / "masks.npy", mask_dtype, (n, *size))
    recipes: list[dict[str, Any]] = [{}] * n
    tasks = [
        Task(f"augmentation of {item.id}", _variants, (images, backgrounds, settings, os.getpid(), i))
        for i, item in enumerate(images.items)
    ]
    with contextlib.closing(LOCAL.run(tasks, workers)) as results:
        for done, (i, variants) in enumerate(results, start=1):
            for row, variant in enumerate(variants, start=i * settings.n_variants):
                stored_images[row], stored_masks[row], recipes[row] = variant.image, variant.mask, variant.recipe
            progress(done, len(images), f"augmented {images.items[i].id}")
    stored_images.flush()
    stored_masks.flush()
    return tuple(recipes)


def _variants(
    images: LabeledImageSet, backgrounds: Backgrounds, settings: SchemeSettings, caller_pid: int, i: int
) -> list[AugmentedImage]:
    if os.getpid() != caller_pid:
        # the workers share the cores; in the caller itself OpenCV's pool may stem from before a fork and would hang
        cv2.setNumThreads(1)
    return _cached_generator(images, backgrounds, settings)(i)


@functools.lru_cache(maxsize=1)
def _cached_generator(images: LabeledImageSet, backgrounds: Backgrounds, settings: SchemeSettings) -> VariantGenerator:
    """Create the generator once per process, because it may read all originals."""
    return variant_generator(images, backgrounds, settings)


def _read_recipes(path: pathlib.Path) -> tuple[dict[str, Any], ...]:
    if not path.is_file():
        raise DataError(path, "is missing; make the augmented set again")
    recipes = []
    for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), start=1):
        try:
            recipes.append(json.loads(line))
        except json.JSONDecodeError as error:
            raise DataError(path, f"line {number} is not a recipe ({error}); make the augmented set again") from error
    return tuple(recipes)


def _allocate(path: pathlib.Path, dtype: type[np.generic], shape: tuple[int, ...]) -> np.memmap:
    """Create an array on disk and reserve its space: a disk that is full later would kill the process by SIGBUS."""
    array: np.memmap = np.lib.format.open_memmap(path, mode="w+", dtype=dtype, shape=shape)
    if hasattr(os, "posix_fallocate"):
        with path.open("r+b") as file:
            os.posix_fallocate(file.fileno(), 0, path.stat().st_size)
    return array


def _open_array(path: pathlib.Path, shape: tuple[int, ...], dtype: type[np.generic]) -> np.ndarray:
    try:
        array = np.load(path, mmap_mode="r", allow_pickle=False)
    except (OSError, ValueError) as error:
        raise DataError(path, f"cannot be opened ({error}); make the augmented set again") from error
    if array.shape != shape or array.dtype != dtype:
        expected = f"{np.dtype(dtype)} {shape}"
        raise DataError(path, f"holds {array.dtype} {array.shape}, not {expected}; make the augmented set again")
    return array


def _digest(settings: SchemeSettings, source: str, backgrounds: str, recipes: tuple[dict[str, Any], ...]) -> str:
    scheme = [] if isinstance(settings, AugmentationSettings) else [scheme_name(settings)]
    return digest_of([*scheme, settings, source, backgrounds, recipes])
