"""The scheme of the paper: the background always, then seven methods with probability one half each."""

import dataclasses
import hashlib
from typing import Any

import cv2
import numpy as np

from deltasafe.perception.data.augmentation import geometry
from deltasafe.perception.data.augmentation.background import Backgrounds
from deltasafe.perception.data.augmentation.color import color_hand, color_picture
from deltasafe.perception.data.augmentation.cutout import CutOut
from deltasafe.perception.data.augmentation.layers import Layers
from deltasafe.perception.data.augmentation.noise import degrade, erase
from deltasafe.perception.data.augmentation.settings import METHOD_NAMES, AugmentationSettings

__all__ = ["Augmented", "augment", "chosen_methods", "cut_out", "image_seed"]

GEOMETRY = {
    "flip": geometry.flip,
    "rotation": geometry.rotation,
    "grid_distortion": geometry.grid_distortion,
    "cropping": geometry.cropping,
}


@dataclasses.dataclass(frozen=True)
class Augmented:
    """One new image.

    Attributes:
        image: ``(H, W, 3)`` uint8, RGB.
        mask: ``(H, W)`` uint8, 1 = hand.
        recipe: what was done: source, variant, seed, background, operations with parameters, digest of the
            pixels.
    """

    image: np.ndarray
    mask: np.ndarray
    recipe: dict[str, object]


def image_seed(image_id: str, variant: int, seed: int) -> int:
    """The seed of one image: a hash of the original's id, the variant's number and the seed of the set."""
    text = f"{seed}\x00{image_id}\x00{variant}".encode()
    return int.from_bytes(hashlib.sha256(text).digest()[:8], "big")


def chosen_methods(seed: int, settings: AugmentationSettings) -> tuple[str, ...]:
    """Names of the methods applied to the image of that seed, in their order."""
    draws = np.random.default_rng([seed, 0]).random(len(METHOD_NAMES))
    return tuple(
        name
        for name, draw in zip(METHOD_NAMES, draws, strict=True)
        if name not in settings.left_out and (name == "background" or draw < settings.probability)
    )


def cut_out(rgb: np.ndarray, mask: np.ndarray, settings: AugmentationSettings) -> CutOut:
    """The hand of an original, ready for :func:`augment`; it is the same for all variants."""
    factor = settings.supersampling
    return CutOut.of(rgb, mask, settings.width * factor, settings.height * factor)


def augment(
    image_id: str, hand: CutOut, variant: int, backgrounds: Backgrounds, settings: AugmentationSettings
) -> Augmented:
    """Make variant number ``variant`` of an original: alone, in any process, always the same bytes.

    The chosen methods come in the order of ``METHOD_NAMES``; each draws from a stream of its own.
    """
    seed = image_seed(image_id, variant, settings.seed)
    chosen = chosen_methods(seed, settings)
    rngs = {name: np.random.default_rng([seed, 1 + i]) for i, name in enumerate(METHOD_NAMES)}
    width, height = settings.width * settings.supersampling, settings.height * settings.supersampling
    done: dict[str, dict[str, Any]] = {}

    covering = min(hand.alpha.shape[1] / width, hand.alpha.shape[0] / height)
    origin = np.array([hand.alpha.shape[1] - 1, hand.alpha.shape[0] - 1]) / 2
    middle = np.array([width - 1, height - 1]) / 2
    center = (hand.center - origin) / covering + middle
    warps = []
    for name, method in GEOMETRY.items():
        if name in chosen:
            warp, center, done[name] = method(rngs[name], (width, height), center)
            warps.append(warp)
    points = np.stack(np.meshgrid(np.arange(width), np.arange(height)), axis=-1).astype(np.float32)
    for warp in reversed(warps):
        points = warp(points)
    points = ((points - middle) * covering + origin).astype(np.float32)

    layers = Layers.sample(hand, points)
    lit: dict[str, float | int] = {}
    if "color" in chosen:
        layers.rgb, lit = color_hand(rngs["color"], layers.rgb, layers.alpha)
    if "background" in chosen:
        done["background"] = layers.put_elsewhere(rngs["background"], hand, points, backgrounds)
    picture = layers.composed()
    if "color" in chosen:
        picture, camera = color_picture(rngs["color"], picture)
        done["color"] = lit | camera
    image, mask = _stored(picture, layers.alpha, settings)
    if "noise" in chosen:
        image, done["noise"] = degrade(rngs["noise"], image)
    if "random_erase" in chosen:
        image, done["random_erase"] = erase(rngs["random_erase"], image, mask)
    recipe = {
        "source": image_id,
        "variant": variant,
        "seed": seed,
        "operations": [{"method": name, **done[name]} for name in METHOD_NAMES if name in done],
        "digest": hashlib.sha256(image.tobytes() + mask.tobytes()).hexdigest(),
    }
    return Augmented(image, mask, recipe)


def _stored(picture: np.ndarray, alpha: np.ndarray, settings: AugmentationSettings) -> tuple[np.ndarray, np.ndarray]:
    size = (settings.width, settings.height)
    small = cv2.resize(picture, size, interpolation=cv2.INTER_AREA)
    coverage = cv2.resize(alpha, size, interpolation=cv2.INTER_AREA)
    return np.rint(np.clip(small, 0, 1) * 255).astype(np.uint8), (coverage >= 0.5).astype(np.uint8)
