"""The paper's augmentation of one image: always a new background, then seven methods with probability 1/2 each."""

import dataclasses
import hashlib
from typing import Any

import cv2
import numpy as np

from deltasafe.perception.data.augmentation.background import Backgrounds
from deltasafe.perception.data.augmentation.color import recolor_hand, recolor_object, simulate_camera
from deltasafe.perception.data.augmentation.geometry import draw_scale, warps_of
from deltasafe.perception.data.augmentation.hand_cutout import HandCutout
from deltasafe.perception.data.augmentation.layers import Layers
from deltasafe.perception.data.augmentation.noise import degrade, random_erase
from deltasafe.perception.data.augmentation.settings import METHOD_NAMES, AugmentationSettings
from deltasafe.perception.data.labeled_pair import resize_labeled


@dataclasses.dataclass(frozen=True)
class AugmentedImage:
    """One new image.

    Attributes:
        image: ``(H, W, 3)`` uint8, RGB.
        mask: ``(H, W)`` uint8, 1 = hand, or a soft mask in uint16.
        recipe: source, variant, seed, operations with their parameters, and digest of the pixels.
    """

    image: np.ndarray
    mask: np.ndarray
    recipe: dict[str, Any]

    @classmethod
    def with_digest(cls, image: np.ndarray, mask: np.ndarray, recipe: dict[str, Any]) -> "AugmentedImage":
        """Add the digest of the pixels to ``recipe``."""
        return cls(image, mask, {**recipe, "digest": pixel_digest(image, mask)})


def pixel_digest(image: np.ndarray, mask: np.ndarray) -> str:
    """SHA-256 over the bytes of an image and its mask."""
    return hashlib.sha256(image.tobytes() + mask.tobytes()).hexdigest()


def image_seed(image_id: str, variant: int, seed: int) -> int:
    """Seed of one image: a hash of the original's id, the variant's number and the seed of the set."""
    text = f"{seed}\x00{image_id}\x00{variant}".encode()
    return int.from_bytes(hashlib.sha256(text).digest()[:8], "big")


def chosen_methods(seed: int, settings: AugmentationSettings) -> tuple[str, ...]:
    """Names of the methods that are applied to the image with this seed, in order of application."""
    draws = np.random.default_rng([seed, 0]).random(len(METHOD_NAMES))
    return tuple(
        name
        for name, draw in zip(METHOD_NAMES, draws, strict=True)
        if name not in settings.left_out and (name == "background" or draw < settings.probability)
    )


def cut_out_hand(rgb: np.ndarray, mask: np.ndarray, settings: AugmentationSettings) -> HandCutout:
    """Cut out the hand of an original for `augment`; all variants share the result."""
    return HandCutout.from_image(rgb, mask, *_canvas_size(settings))


def augment(
    image_id: str, hand: HandCutout, variant: int, backgrounds: Backgrounds, settings: AugmentationSettings
) -> AugmentedImage:
    """Make variant number ``variant`` of an original; the result depends on the arguments alone.

    Methods are applied in the order of ``METHOD_NAMES``. Each draws from its own random stream, so that leaving one
    out does not change the others. An image without a hand keeps its background, which is all that it shows.
    """
    seed = image_seed(image_id, variant, settings.seed)
    chosen = chosen_methods(seed, settings)
    if not hand.alpha.any():
        chosen = tuple(name for name in chosen if name != "background")
    rngs = {name: np.random.default_rng([seed, 1 + i]) for i, name in enumerate(METHOD_NAMES) if name in chosen}
    points, drawn = _source_points(hand, rngs, _canvas_size(settings))
    layers = Layers.sample(hand, points)
    if "color" in rngs:
        recolor = recolor_object if "skin_tones" in settings.left_out else recolor_hand
        layers.rgb, drawn["color"] = recolor(rngs["color"], layers.rgb, layers.alpha)
    if "background" in rngs:
        clothed = "clothing" not in settings.left_out
        drawn["background"] = layers.replace_background(rngs["background"], hand, points, backgrounds, clothed)
    composed = layers.compose()
    if "color" in rngs:
        composed, camera = simulate_camera(rngs["color"], composed)
        drawn["color"] |= camera
    small, mask = resize_labeled(composed, layers.alpha, (settings.width, settings.height), cv2.INTER_AREA)
    image = np.rint(np.clip(small, 0, 1) * 255).astype(np.uint8)
    if "noise" in rngs:
        image, drawn["noise"] = degrade(rngs["noise"], image)
    if "random_erase" in rngs:
        image, drawn["random_erase"] = random_erase(rngs["random_erase"], image, mask)
    operations = [{"method": name, **drawn[name]} for name in METHOD_NAMES if name in drawn]
    recipe = {"source": image_id, "variant": variant, "seed": seed, "operations": operations}
    return AugmentedImage.with_digest(image, mask, recipe)


def _canvas_size(settings: AugmentationSettings) -> tuple[int, int]:
    return settings.width * settings.supersampling, settings.height * settings.supersampling


def _source_points(
    hand: HandCutout, rngs: dict[str, np.random.Generator], size: tuple[int, int]
) -> tuple[np.ndarray, dict[str, dict[str, Any]]]:
    """``(H, W, 2)`` float32, where each canvas pixel comes from in the original, and what each warp has drawn."""
    width, height = size
    source = np.array(hand.alpha.shape[::-1])
    covering = min(source[0] / width, source[1] / height)
    crop_px = np.rint(covering * np.array(size))
    focus, beside_px = hand.focus(crop_px), np.maximum(source - crop_px, 0) / 2
    # of an image with another aspect ratio than the canvas, the part around the hand is shown
    source_middle = (source - 1) / 2
    source_middle = source_middle + np.clip(focus - source_middle, -beside_px, beside_px)
    middle = np.array([width - 1, height - 1]) / 2
    scale = draw_scale(rngs["cropping"]) if "cropping" in rngs else 1.0
    # magnified, the fingers are shown rather than the arm
    center = (hand.focus(crop_px / max(scale, 1.0)) - source_middle) / covering + middle
    warps, drawn = [], {}
    for name, draw_warp in warps_of(scale).items():
        if name in rngs:
            warp, center, drawn[name] = draw_warp(rngs[name], size, center)
            warps.append(warp)
    points = np.stack(np.meshgrid(np.arange(width), np.arange(height)), axis=-1).astype(np.float32)
    for warp in reversed(warps):
        points = warp(points)
    return ((points - middle) * covering + source_middle).astype(np.float32), drawn
