"""Backgrounds behind the hand: photographs, procedural surfaces, clutter, and combinations of them."""

import dataclasses
import functools
import pathlib

import cv2
import numpy as np

from deltasafe.errors import DataError
from deltasafe.io.folder_entries import IMAGE_SUFFIXES, FolderEntries
from deltasafe.io.images import read_rgb
from deltasafe.io.storage import digest_of, sha256_of_file
from deltasafe.perception.data.augmentation.clutter import add_clutter
from deltasafe.perception.data.augmentation.textures import light_gradient, random_surface, smooth_noise
from deltasafe.perception.data.labeled_images import read_or_none

P_PHOTOGRAPH = 0.4
P_SECOND_SURFACE = 0.2
P_CLUTTER = 0.5
P_SHADOW = 0.25
MAX_PIXELS = 2**20
"""Of a photograph in memory. Its smallest crop (0.4 of each side) has the pixels of a canvas of 384 x 288."""

_CACHED = 64
"""Photographs in memory of each process: at most 200 MB. Further ones are read again when they are drawn."""

_MIN_SIDE_PX = 16


@dataclasses.dataclass(frozen=True)
class Backgrounds:
    """Photographs without hands.

    Attributes:
        paths: of the files, sorted; each is read when it is drawn.
        digest: SHA-256 over names and contents.
        ignored: entries of the folder that are no images, for a log.
    """

    paths: tuple[pathlib.Path, ...] = ()
    digest: str = ""
    ignored: str = ""

    @classmethod
    def load(cls, folder: str | pathlib.Path | None) -> "Backgrounds":
        """Check all images of ``folder``; None gives no photographs. One image at a time is in memory.

        Raises:
            DataError: the folder is missing or holds no image; or lists the files that are defective or too small.
        """
        if folder is None:
            return cls()
        folder = pathlib.Path(folder)
        if not folder.is_dir():
            raise DataError(folder, "is not a folder; give a folder of images without hands")
        entries = FolderEntries.of(folder)
        if not entries.images:
            raise DataError(folder, f"holds no image ({', '.join(IMAGE_SUFFIXES)}); add some")
        defects: list[DataError] = []
        for path in entries.images:
            read_or_none(_read, path, defects)
        if defects:
            raise DataError.combined(folder, defects)
        _cached.cache_clear()  # a file may have changed
        digest = digest_of([(path.name, sha256_of_file(path)) for path in entries.images])
        return cls(entries.images, digest, entries.ignored)

    def read(self, index: int) -> np.ndarray:
        """Return a photograph ``(H, W, 3)`` uint8 of at most ``MAX_PIXELS`` pixels."""
        return _cached(self.paths[index])


def draw_background(
    rng: np.random.Generator, backgrounds: Backgrounds, width: int, height: int
) -> tuple[np.ndarray, dict[str, object]]:
    """Draw a background ``(H, W, 3)`` float32 in [0, 1]; returns it with its parameters.

    40 % are photographs (if there are any) and 60 % procedural surfaces. One in five joins two of them along a line,
    like the edge of a table. Half show one to four objects.
    """
    background, source = _photograph_or_surface(rng, backgrounds, width, height)
    drawn: dict[str, object] = {"source": source}
    if rng.random() < P_SECOND_SURFACE:
        second, drawn["joined"] = _photograph_or_surface(rng, backgrounds, width, height)
        edge = light_gradient(rng, width, height, 1.0) - 1.0 + rng.uniform(-0.5, 0.5)
        blend = np.clip(0.5 + edge * rng.uniform(30, 100), 0, 1)
        background = background * blend + second * (1 - blend)
    if rng.random() < P_CLUTTER:
        drawn["clutter"] = add_clutter(rng, background, int(rng.integers(1, 5)))
    if rng.random() < P_SHADOW:  # cast by something outside the image
        shadow = smooth_noise(rng, width, height, width / 2, height / 2) + rng.uniform(-0.3, 0.3)
        strength = rng.uniform(0.2, 0.6)
        background = background * (1 - strength * np.clip(shadow * rng.uniform(2, 20), 0, 1))[..., None]
    return np.clip(background, 0.0, 1.0).astype(np.float32), drawn


def _photograph_or_surface(
    rng: np.random.Generator, backgrounds: Backgrounds, width: int, height: int
) -> tuple[np.ndarray, str]:
    if not backgrounds.paths or rng.random() >= P_PHOTOGRAPH:
        return random_surface(rng, width, height)
    index = int(rng.integers(len(backgrounds.paths)))
    rgb = _random_crop(rng, backgrounds.read(index), width, height)
    hsv = cv2.cvtColor(rgb, cv2.COLOR_RGB2HSV)
    if rng.random() < 0.4:
        hsv[..., 0] = (hsv[..., 0] + rng.uniform(-180, 180)) % 360
    hsv[..., 1] = np.clip(hsv[..., 1] * rng.uniform(0.4, 1.4), 0, 1)
    rgb = cv2.cvtColor(hsv, cv2.COLOR_HSV2RGB) ** np.float32(np.exp(rng.uniform(-0.5, 0.6)))
    if rng.random() < 0.4:  # out of focus
        rgb = cv2.GaussianBlur(rgb, (0, 0), rng.uniform(0.8, 6.0))
    return rgb, backgrounds.paths[index].name


def _read(path: pathlib.Path) -> np.ndarray:
    rgb = read_rgb(path, MAX_PIXELS)
    if min(rgb.shape[:2]) < _MIN_SIDE_PX:
        size = f"{rgb.shape[1]} x {rgb.shape[0]} pixels"
        raise DataError(path, f"has {size}, a background needs at least {_MIN_SIDE_PX} per side; remove it")
    return rgb


_cached = functools.lru_cache(maxsize=_CACHED)(_read)


def _random_crop(rng: np.random.Generator, image: np.ndarray, width: int, height: int) -> np.ndarray:
    scale = min(image.shape[1] / width, image.shape[0] / height) * rng.uniform(0.4, 1.0)
    crop_width, crop_height = max(2, int(width * scale)), max(2, int(height * scale))
    left = int(rng.integers(image.shape[1] - crop_width + 1))
    top = int(rng.integers(image.shape[0] - crop_height + 1))
    crop = image[top : top + crop_height, left : left + crop_width]
    if rng.random() < 0.5:
        crop = crop[:, ::-1]
    if rng.random() < 0.2:
        crop = crop[::-1]
    interpolation = cv2.INTER_AREA if crop_width > width else cv2.INTER_CUBIC
    crop = cv2.resize(np.ascontiguousarray(crop), (width, height), interpolation=interpolation)
    return crop.astype(np.float32) / 255.0
