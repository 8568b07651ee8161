"""The augmented training set on disk: arrays ready for training, and the recipe of every image."""

import contextlib
import dataclasses
import hashlib
import json
import os
import pathlib
from collections.abc import Generator
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from deltasafe.compute.executor import LOCAL, Needs, Task, in_order
from deltasafe.compute.progress import Progress, silent
from deltasafe.errors import DataError, SettingsError
from deltasafe.io.storage import atomic_folder, digest_of, read_json, write_json
from deltasafe.perception.data.augmentation import (
    METHOD_NAMES,
    AugmentationSettings,
    Augmented,
    Backgrounds,
    augment,
    cut_out,
)
from deltasafe.perception.data.labeled_images import LabeledImageSet
from deltasafe.perception.data.schemes import SCHEMES, SchemeSettings, scheme_of
from deltasafe.perception.data.schemes.generation import Maker, maker_of, stored_form
from deltasafe.perception.data.schemes.soft_masks import hand_share

__all__ = ["AugmentedSet", "augment_images", "remake"]

FORMAT = 1


@dataclasses.dataclass(frozen=True)
class AugmentedSet:
    """A stored augmented set, memory-mapped.

    Attributes:
        folder: where it lies.
        images: ``(N, H, W, 3)`` uint8, RGB, read-only.
        masks: ``(N, H, W)`` uint8, 1 = hand, or soft: uint16, 65535 = certainly hand; read-only.
        recipes: what was done to each image; variants of one original follow each other.
        settings: of the augmentation scheme.
        source_digest: of the hand set it was made from.
        background_digest: of the pictures the hands were put on; empty where there were none.
        digest: SHA-256 over all of it, pixels included.
    """

    folder: pathlib.Path
    images: np.ndarray
    masks: np.ndarray
    recipes: tuple[dict[str, Any], ...]
    settings: SchemeSettings
    source_digest: str
    background_digest: str
    digest: str

    @classmethod
    def load(cls, folder: str | pathlib.Path) -> "AugmentedSet":
        """Open a stored set; checks everything but the pixels, which :meth:`verify` checks.

        Raises:
            DataError: a file is missing, of another form, or the parts do not belong together.
        """
        folder = pathlib.Path(folder)
        described = read_json(folder / "set.json")
        if not isinstance(described, dict) or described.get("format") != FORMAT:
            raise DataError(folder / "set.json", f"is not of format {FORMAT}; write the augmented set again")
        scheme = described.get("scheme", "ours")
        if scheme not in SCHEMES:
            raise DataError(folder / "set.json", f"is of an unknown scheme {scheme!r}; known: {', '.join(SCHEMES)}")
        settings = SCHEMES[scheme](**described["settings"])
        n, (shape, mask_type) = described["n"], stored_form(settings)
        images = _mapped(folder / "images.npy", (n, *shape, 3), np.uint8)
        masks = _mapped(folder / "masks.npy", (n, *shape), mask_type)
        recipes = _read_recipes(folder / "recipes.jsonl")
        if len(recipes) != n:
            raise DataError(
                folder / "recipes.jsonl", f"holds {len(recipes)} recipes for {n} images; write the set again"
            )
        digest = _digest(settings, described["source_digest"], described["background_digest"], recipes)
        if digest != described["digest"]:
            raise DataError(folder, "has a digest that is not that of its recipes; write the augmented set again")
        return cls(
            folder,
            images,
            masks,
            recipes,
            settings,
            described["source_digest"],
            described["background_digest"],
            digest,
        )

    @property
    def n(self) -> int:
        """How many images."""
        return len(self.recipes)

    @property
    def scheme(self) -> str:
        """Name of the scheme that made it."""
        return scheme_of(self.settings)

    @property
    def n_distinct(self) -> int:
        """How many different images; schemes that draw from few variants repeat themselves."""
        return len({recipe["digest"] for recipe in self.recipes})

    def labels(self, indices: NDArray[np.integer] | slice) -> NDArray[np.float32]:
        """``(B, H, W)`` float32 in [0, 1]: how much of each pixel is hand, of the images ``indices``."""
        return hand_share(self.masks[indices])

    def verify(self) -> None:
        """Compare every image and mask with the digest in its recipe.

        Raises:
            DataError: naming the first image that differs.
        """
        for i, recipe in enumerate(self.recipes):
            if hashlib.sha256(self.images[i].tobytes() + self.masks[i].tobytes()).hexdigest() != recipe["digest"]:
                raise DataError(self.folder, f"image {i} differs from its recipe; write the augmented set again")


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
        folder: destination; an existing one is replaced when the new one is complete.
        settings: of the scheme; their class selects it (`deltasafe.perception.data.schemes`). Default: ours.
        backgrounds: folder of pictures without the object, for our scheme; None uses procedural surfaces only.
        workers: number of processes; it does not change the result. 1 works in this process.
        progress: called after each original.

    Raises:
        DataError: an original or a background is defective.
        SettingsError: ``workers`` is less than 1.
    """
    if workers < 1:
        raise SettingsError(f"workers is {workers}; choose at least 1")
    settings = settings or AugmentationSettings()
    ours = isinstance(settings, AugmentationSettings)
    backgrounds = backgrounds if ours else None
    pictures = _pictures(backgrounds)
    n, (size, mask_type) = len(images) * settings.n_variants, stored_form(settings)
    recipes: list[dict[str, Any]] = []
    with atomic_folder(folder) as temporary:
        pixels = _room(temporary / "images.npy", np.uint8, (n, *size, 3))
        masks = _room(temporary / "masks.npy", mask_type, (n, *size))
        with contextlib.closing(_all_variants(images, backgrounds, settings, workers)) as originals:
            for done, variants in enumerate(originals, start=1):
                for made in variants:
                    pixels[len(recipes)], masks[len(recipes)] = made.image, made.mask
                    recipes.append(made.recipe)
                progress(done, len(images), f"augmented {images.items[done - 1].id}")
        pixels.flush()
        masks.flush()
        del pixels, masks
        with (temporary / "recipes.jsonl").open("w", encoding="utf-8") as file:
            file.writelines(json.dumps(recipe) + "\n" for recipe in recipes)
        described = {
            "format": FORMAT,
            "n": n,
            "settings": dataclasses.asdict(settings),
            "source": images.name,
            "source_digest": images.digest,
            "background_digest": pictures.digest,
            "digest": _digest(settings, images.digest, pictures.digest, tuple(recipes)),
            "applied": {name: _count(recipes, name) for name in (METHOD_NAMES if ours else _methods(recipes))},
            **({} if ours else {"scheme": scheme_of(settings)}),
        }
        write_json(temporary / "set.json", described)
    return AugmentedSet.load(folder)


def remake(
    hands: LabeledImageSet, backgrounds: Backgrounds, settings: AugmentationSettings, source: str, variant: int
) -> Augmented:
    """One image of a set again, alone: the same bytes as in the stored set.

    Raises:
        DataError: there is no original with the id ``source``.
    """
    for i, item in enumerate(hands.items):
        if item.id == source:
            return augment(source, cut_out(*hands.read(i), settings), variant, backgrounds, settings)
    raise DataError(
        hands.name, f"holds no image {source!r}; its ids go from {hands.items[0].id} to {hands.items[-1].id}"
    )


_maker: Maker | None = None


def _all_variants(
    hands: LabeledImageSet, backgrounds: str | pathlib.Path | None, settings: SchemeSettings, workers: int
) -> Generator[list[Augmented], None, None]:
    if workers == 1:
        maker = maker_of(hands, _pictures(backgrounds), settings)
        yield from (maker.variants(i) for i in range(len(hands)))
        return
    tasks = [
        Task(f"augmentation of {item.id}", _work, (hands, backgrounds, settings, i))
        for i, item in enumerate(hands.items)
    ]
    with contextlib.closing(LOCAL.run(tasks, workers, Needs(apart=True))) as finished:
        yield from in_order(finished)


def _work(
    hands: LabeledImageSet, backgrounds: str | pathlib.Path | None, settings: SchemeSettings, i: int
) -> list[Augmented]:
    """Called in a worker process, which serves one set: it reads the backgrounds itself, once."""
    global _maker  # noqa: PLW0603
    if _maker is None:
        _maker = maker_of(hands, _pictures(backgrounds), settings)
        cv2.setNumThreads(1)
    return _maker.variants(i)


def _pictures(backgrounds: str | pathlib.Path | None) -> Backgrounds:
    return Backgrounds() if backgrounds is None else Backgrounds.load(backgrounds)


def _read_recipes(path: pathlib.Path) -> tuple[dict[str, Any], ...]:
    if not path.is_file():
        raise DataError(path, "is missing; write the augmented set again")
    recipes = []
    for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), start=1):
        try:
            recipes.append(json.loads(line))
        except json.JSONDecodeError as error:
            raise DataError(path, f"line {number} is no recipe ({error}); write the augmented set again") from error
    return tuple(recipes)


def _room(path: pathlib.Path, kind: type[np.generic], shape: tuple[int, ...]) -> np.memmap:
    """An array on disk that can be filled: a full disk is an error now, not the death of the process later."""
    array: np.memmap = np.lib.format.open_memmap(path, mode="w+", dtype=kind, shape=shape)
    if hasattr(os, "posix_fallocate"):
        with path.open("r+b") as file:
            os.posix_fallocate(file.fileno(), 0, path.stat().st_size)
    return array


def _mapped(path: pathlib.Path, shape: tuple[int, ...], kind: type[np.generic]) -> np.ndarray:
    try:
        array = np.load(path, mmap_mode="r", allow_pickle=False)
    except (OSError, ValueError) as error:
        raise DataError(path, f"cannot be opened ({error}); write the augmented set again") from error
    if array.shape != shape or array.dtype != kind:
        expected = f"{np.dtype(kind)} {shape}"
        raise DataError(path, f"holds {array.dtype} {array.shape}, not {expected}; write the augmented set again")
    return array


def _digest(settings: SchemeSettings, source: str, backgrounds: str, recipes: tuple[dict[str, Any], ...]) -> str:
    scheme = [] if isinstance(settings, AugmentationSettings) else [scheme_of(settings)]
    return digest_of([*scheme, settings, source, backgrounds, recipes])


def _methods(recipes: list[dict[str, Any]]) -> list[str]:
    """In the order in which they are applied."""
    return list(dict.fromkeys(step["method"] for recipe in recipes for step in recipe["operations"]))


def _count(recipes: list[dict[str, Any]], name: str) -> int:
    return sum(any(step["method"] == name for step in recipe["operations"]) for recipe in recipes)
