"""Where the hand is put: photographs of places, procedural surfaces, clutter, and mixtures of them."""

import dataclasses
import pathlib

import cv2
import numpy as np

from deltasafe.errors import DataError
from deltasafe.io.storage import digest_of, sha256_of_file
from deltasafe.perception.data.augmentation.clutter import add_clutter
from deltasafe.perception.data.augmentation.textures import light_falloff, smooth_noise, surface
from deltasafe.perception.data.labeled_images import IMAGE_SUFFIXES, read_rgb

__all__ = ["Backgrounds", "draw_background"]

PHOTOGRAPH_SHARE = 0.4
MIXED_SHARE = 0.2
CLUTTERED_SHARE = 0.5


@dataclasses.dataclass(frozen=True)
class Backgrounds:
    """Pictures without hands, read once.

    Attributes:
        names: file names, sorted.
        pictures: ``(H, W, 3)`` uint8 each, of any size.
        digest: SHA-256 over names and contents.
    """

    names: tuple[str, ...] = ()
    pictures: tuple[np.ndarray, ...] = ()
    digest: str = ""

    @classmethod
    def load(cls, folder: str | pathlib.Path) -> "Backgrounds":
        """Read all images of ``folder`` (RGB, JPEG or PNG).

        Raises:
            DataError: the folder is missing or holds no image, or a file is no RGB image.
        """
        folder = pathlib.Path(folder)
        if not folder.is_dir():
            raise DataError(folder, "is not a folder; name one with pictures that show no hand")
        paths = sorted(path for path in folder.iterdir() if path.suffix.lower() in IMAGE_SUFFIXES)
        if not paths:
            raise DataError(folder, f"holds no picture ({', '.join(IMAGE_SUFFIXES)}); add some")
        for path in paths:
            if path.stat().st_size == 0:
                raise DataError(path, "is empty; restore or remove it")
        pictures = tuple(read_rgb(path) for path in paths)
        digest = digest_of([(path.name, sha256_of_file(path)) for path in paths])
        return cls(tuple(path.name for path in paths), pictures, digest)


def draw_background(
    rng: np.random.Generator, backgrounds: Backgrounds, width: int, height: int
) -> tuple[np.ndarray, dict[str, object]]:
    """A new background ``(H, W, 3)`` float32 in [0, 1] and what it is made of.

    40 % are photographs (if there are any), 60 % procedural surfaces; a fifth joins two of them at a table's
    edge,
    half carry one to four things that lie about.
    """
    picture, source = _one(rng, backgrounds, width, height)
    recipe: dict[str, object] = {"source": source}
    if rng.random() < MIXED_SHARE:
        other, recipe["joined"] = _one(rng, backgrounds, width, height)
        edge = light_falloff(rng, width, height, 1.0) - 1.0 + rng.uniform(-0.5, 0.5)
        share = np.clip(0.5 + edge * rng.uniform(30, 100), 0, 1)
        picture = picture * share + other * (1 - share)
    if rng.random() < CLUTTERED_SHARE:
        recipe["clutter"] = add_clutter(rng, picture, int(rng.integers(1, 5)))
    if rng.random() < 0.25:  # the shadow of something outside the picture
        patch = smooth_noise(rng, width, height, width / 2, height / 2) + rng.uniform(-0.3, 0.3)
        strength = rng.uniform(0.2, 0.6)
        picture = picture * (1 - strength * np.clip(patch * rng.uniform(2, 20), 0, 1))[..., None]
    return np.clip(picture, 0.0, 1.0).astype(np.float32), recipe


def _one(rng: np.random.Generator, backgrounds: Backgrounds, width: int, height: int) -> tuple[np.ndarray, str]:
    if not backgrounds.pictures or rng.random() >= PHOTOGRAPH_SHARE:
        return surface(rng, width, height)
    index = int(rng.integers(len(backgrounds.pictures)))
    picture = _section(rng, backgrounds.pictures[index], width, height)
    hsv = cv2.cvtColor(picture, cv2.COLOR_RGB2HSV)
    if rng.random() < 0.4:
        hsv[..., 0] = (hsv[..., 0] + rng.uniform(-180, 180)) % 360
    hsv[..., 1] = np.clip(hsv[..., 1] * rng.uniform(0.4, 1.4), 0, 1)
    picture = cv2.cvtColor(hsv, cv2.COLOR_HSV2RGB) ** np.float32(np.exp(rng.uniform(-0.5, 0.6)))
    if rng.random() < 0.4:  # out of focus
        picture = cv2.GaussianBlur(picture, (0, 0), rng.uniform(0.8, 6.0))
    return picture, backgrounds.names[index]


def _section(rng: np.random.Generator, picture: np.ndarray, width: int, height: int) -> np.ndarray:
    fit = min(picture.shape[1] / width, picture.shape[0] / height) * rng.uniform(0.4, 1.0)
    section_width, section_height = max(2, int(width * fit)), max(2, int(height * fit))
    left = int(rng.integers(picture.shape[1] - section_width + 1))
    top = int(rng.integers(picture.shape[0] - section_height + 1))
    section = picture[top : top + section_height, left : left + section_width]
    if rng.random() < 0.5:
        section = section[:, ::-1]
    if rng.random() < 0.2:
        section = section[::-1]
    way = cv2.INTER_AREA if section_width > width else cv2.INTER_CUBIC
    section = cv2.resize(np.ascontiguousarray(section), (width, height), interpolation=way)
    return section.astype(np.float32) / 255.0
