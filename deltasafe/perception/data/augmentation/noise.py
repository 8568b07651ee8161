"""Noise and random erase: what sensor, lens, compression and things in between do to a picture."""

import os
from typing import Any

import cv2
import numpy as np

__all__ = ["degrade", "erase"]

ERASED_SHARE = (0.1, 0.3)
NOISE_DEVIATION = (1.5, 12.0)


def degrade(rng: np.random.Generator, picture: np.ndarray) -> tuple[np.ndarray, dict[str, float | int]]:
    """Blur of lens or motion, noise in HSV, in sRGB and in patches, sharpening, and JPEG, on ``(H, W, 3)``
    uint8.

    The authors' noise has a deviation of 10 of 255 in HSV; here it is drawn from 1.5 to 12.
    """
    drawn: dict[str, float | int] = {}
    blur = rng.random()
    if blur < 0.3:
        drawn["blur_px"] = float(rng.uniform(0.4, 1.3))
        deviation = (drawn["blur_px"], drawn["blur_px"])
        picture = _applied(rng, picture, "GaussianBlur", blur_limit=0, sigma_limit=deviation)
    elif blur < 0.45:
        drawn["motion_blur_px"] = int(rng.choice((3, 5, 7)))
        length = drawn["motion_blur_px"]
        picture = _applied(rng, picture, "MotionBlur", blur_limit=(length, length))
    if rng.random() < 0.7:
        drawn["hsv_deviation"] = float(rng.uniform(*NOISE_DEVIATION))
        picture = _hsv_noise(rng, picture, drawn["hsv_deviation"])
    if rng.random() < 0.4:
        drawn["patchy_deviation"] = float(rng.uniform(2.0, 12.0))
        picture = _patchy_noise(rng, picture, drawn["patchy_deviation"])
    if rng.random() < 0.25:
        drawn["sharpened"] = float(rng.uniform(0.2, 1.0))
        soft = cv2.GaussianBlur(picture, (0, 0), 1.0)
        picture = cv2.addWeighted(picture, 1 + drawn["sharpened"], soft, -drawn["sharpened"], 0)
    if rng.random() < 0.5:
        drawn["jpeg_quality"] = int(rng.integers(30, 96))
        quality = (drawn["jpeg_quality"], drawn["jpeg_quality"])
        picture = _applied(rng, picture, "ImageCompression", quality_range=quality)
    return picture, drawn


def erase(rng: np.random.Generator, picture: np.ndarray, mask: np.ndarray) -> tuple[np.ndarray, dict[str, object]]:
    """Fill a box of 10 to 30 % of each side of the picture, about a point of the hand's bounding box, with
    noise.

    The mask is kept: a hand that is partly covered is still there. Without a hand the box lies anywhere.
    """
    height, width = mask.shape
    ys, xs = np.nonzero(mask)
    low, high = ((xs.min(), ys.min()), (xs.max(), ys.max())) if xs.size else ((0, 0), (width - 1, height - 1))
    middle = rng.uniform(low, np.add(high, 1))
    size = np.maximum(1, np.rint(rng.uniform(*ERASED_SHARE, 2) * (width, height))).astype(int)
    left, top = np.clip(np.rint(middle - size / 2).astype(int), 0, np.array([width, height]) - size)
    picture = picture.copy()
    picture[top : top + size[1], left : left + size[0]] = rng.integers(0, 256, (size[1], size[0], 3), dtype=np.uint8)
    return picture, {"box_px": [int(left), int(top), int(size[0]), int(size[1])]}


def _hsv_noise(rng: np.random.Generator, picture: np.ndarray, deviation: float) -> np.ndarray:
    hsv = cv2.cvtColor(picture, cv2.COLOR_RGB2HSV_FULL).astype(np.float32)
    hsv += rng.standard_normal(hsv.shape, dtype=np.float32) * np.float32(deviation)
    hsv[..., 0] %= 256.0
    return cv2.cvtColor(np.clip(hsv, 0, 255).astype(np.uint8), cv2.COLOR_HSV2RGB_FULL)


def _patchy_noise(rng: np.random.Generator, picture: np.ndarray, deviation: float) -> np.ndarray:
    """Noise of dim light after a camera's own smoothing: patches of a few pixels, stronger in the dark."""
    height, width = picture.shape[:2]
    coarse = rng.standard_normal((height // 2 + 1, width // 2 + 1, 3), dtype=np.float32)
    noise = cv2.resize(coarse, (width, height), interpolation=cv2.INTER_CUBIC)
    strength = deviation * (1.3 - 0.8 * picture.astype(np.float32) / 255.0)
    return np.clip(picture + strength * noise, 0, 255).astype(np.uint8)


def _applied(rng: np.random.Generator, picture: np.ndarray, transform: str, **settings: Any) -> np.ndarray:
    """A transform of albumentations, seeded from ``rng``; imported late, since it brings torch along."""
    os.environ.setdefault("NO_ALBUMENTATIONS_UPDATE", "1")  # it would ask the network for its newest version
    import albumentations

    filtered = getattr(albumentations, transform)(p=1.0, **settings)
    filtered.set_random_seed(int(rng.integers(2**31)))
    return filtered(image=picture)["image"]
