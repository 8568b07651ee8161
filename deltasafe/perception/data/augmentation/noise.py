"""Noise and random erase: the effects of lens, sensor and compression, and of objects in front of the hand."""

import os
from typing import Any

import cv2
import numpy as np

ERASED_FRACTIONS = (0.1, 0.3)
NOISE_DEVIATIONS = (1.5, 12.0)


def degrade(rng: np.random.Generator, image: np.ndarray) -> tuple[np.ndarray, dict[str, float | int]]:
    """Apply blur, noise in HSV and in patches, sharpening and JPEG compression to ``(H, W, 3)`` uint8.

    The paper's noise has a standard deviation of 10 of 255 in HSV. Here it is drawn from 1.5 to 12.
    """
    drawn: dict[str, float | int] = {}
    blur = rng.random()
    if blur < 0.3:
        sigma = drawn["blur_px"] = float(rng.uniform(0.4, 1.3))
        image = _albumentations(rng, image, "GaussianBlur", blur_limit=0, sigma_limit=(sigma, sigma))
    elif blur < 0.45:
        length = drawn["motion_blur_px"] = int(rng.choice((3, 5, 7)))
        image = _albumentations(rng, image, "MotionBlur", blur_limit=(length, length))
    if rng.random() < 0.7:
        drawn["hsv_deviation"] = float(rng.uniform(*NOISE_DEVIATIONS))
        image = _add_hsv_noise(rng, image, drawn["hsv_deviation"])
    if rng.random() < 0.4:
        drawn["patchy_deviation"] = float(rng.uniform(2.0, 12.0))
        image = _add_patchy_noise(rng, image, drawn["patchy_deviation"])
    if rng.random() < 0.25:
        amount = drawn["sharpened"] = float(rng.uniform(0.2, 1.0))
        image = cv2.addWeighted(image, 1 + amount, cv2.GaussianBlur(image, (0, 0), 1.0), -amount, 0)
    if rng.random() < 0.5:
        quality = drawn["jpeg_quality"] = int(rng.integers(30, 96))
        image = _albumentations(rng, image, "ImageCompression", quality_range=(quality, quality))
    return image, drawn


def random_erase(rng: np.random.Generator, image: np.ndarray, mask: np.ndarray) -> tuple[np.ndarray, dict[str, object]]:
    """Fill a box with noise: its center in the hand's bounding box, its sides 10 to 30 % of the image's.

    The mask does not change: a hand that is partly hidden is still there. Without a hand, the box is anywhere.
    """
    height, width = mask.shape
    ys, xs = np.nonzero(mask)
    low, high = ((xs.min(), ys.min()), (xs.max(), ys.max())) if xs.size else ((0, 0), (width - 1, height - 1))
    center = rng.uniform(low, np.add(high, 1))
    size = np.maximum(1, np.rint(rng.uniform(*ERASED_FRACTIONS, 2) * (width, height))).astype(int)
    left, top = np.clip(np.rint(center - size / 2).astype(int), 0, np.array([width, height]) - size)
    image = image.copy()
    image[top : top + size[1], left : left + size[0]] = rng.integers(0, 256, (size[1], size[0], 3), dtype=np.uint8)
    return image, {"box_px": [int(left), int(top), int(size[0]), int(size[1])]}


def _add_hsv_noise(rng: np.random.Generator, image: np.ndarray, deviation: float) -> np.ndarray:
    hsv = cv2.cvtColor(image, cv2.COLOR_RGB2HSV_FULL).astype(np.float32)
    hsv += rng.standard_normal(hsv.shape, dtype=np.float32) * np.float32(deviation)
    hsv[..., 0] %= 256.0
    return cv2.cvtColor(np.clip(hsv, 0, 255).astype(np.uint8), cv2.COLOR_HSV2RGB_FULL)


def _add_patchy_noise(rng: np.random.Generator, image: np.ndarray, deviation: float) -> np.ndarray:
    """Add low-light noise as it is after the camera's denoising: patches of a few pixels, stronger in dark areas."""
    height, width = image.shape[:2]
    coarse = rng.standard_normal((height // 2 + 1, width // 2 + 1, 3), dtype=np.float32)
    noise = cv2.resize(coarse, (width, height), interpolation=cv2.INTER_CUBIC)
    strength = deviation * (1.3 - 0.8 * image.astype(np.float32) / 255.0)
    return np.clip(image + strength * noise, 0, 255).astype(np.uint8)


def _albumentations(rng: np.random.Generator, image: np.ndarray, transform: str, **settings: Any) -> np.ndarray:
    """Apply a transform of albumentations with a seed from ``rng``. Imported late, because it imports torch."""
    os.environ.setdefault("NO_ALBUMENTATIONS_UPDATE", "1")  # prevents a network request for the newest version
    import albumentations

    seeded = getattr(albumentations, transform)(p=1.0, **settings)
    seeded.set_random_seed(int(rng.integers(2**31)))
    return seeded(image=image)["image"]
