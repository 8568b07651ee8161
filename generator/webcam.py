"""Simulation of a low-cost webcam: exposure, highlights, lens, noise, sharpening, JPEG."""

import dataclasses
import io

import numpy as np
from PIL import Image
from scipy.ndimage import gaussian_filter, map_coordinates

from generator.aliases import Array
from generator.noise import smoothstep
from generator.skin.palette import linear_to_srgb

LUMINANCE = np.array([0.2126, 0.7152, 0.0722])
MOTION_STEPS = 9
HIGHLIGHT_KNEE, HIGHLIGHT_RANGE = 0.7, 0.3  # highlights above the knee are compressed


@dataclasses.dataclass(frozen=True)
class Webcam:
    """Parameters of the camera.

    Attributes:
        exposure_ev: stops above or below the automatic exposure.
        white_balance: gain of each color channel.
        noise: standard deviation of the shot noise at full exposure, 0 to 1.
        blur_px: standard deviation of the lens blur.
        motion_px: length of the motion blur.
        motion_rad: direction of the motion blur.
        vignette: fraction of light lost in the corners, 0 to 1.
        contrast: blend weight of an S-curve.
        sharpening: strength of the unsharp mask.
        jpeg_quality: 1 to 95.
        seed: random seed of the noise.
    """

    exposure_ev: float = 0.0
    white_balance: tuple[float, float, float] = (1.0, 1.0, 1.0)
    noise: float = 0.01
    blur_px: float = 0.55
    motion_px: float = 0.0
    motion_rad: float = 0.0
    vignette: float = 0.15
    contrast: float = 0.0
    sharpening: float = 0.4
    jpeg_quality: int = 88
    seed: int = 0


def webcam_jpeg(radiance: Array, coverage: Array, webcam: Webcam) -> bytes:
    """Convert linear radiance (H, W, 3) to a JPEG file.

    Args:
        coverage: (H, W) fraction of hand in each pixel; the automatic exposure keeps the hand in range.
    """
    image = np.nan_to_num(radiance)
    image = np.minimum(image, 3 * np.percentile(image, 99.7)) * webcam.white_balance
    image = _auto_exposure(image, coverage, webcam.exposure_ev)
    compressed = HIGHLIGHT_KNEE + HIGHLIGHT_RANGE * (1 - np.exp(-(image - HIGHLIGHT_KNEE) / HIGHLIGHT_RANGE))
    image = np.where(image < HIGHLIGHT_KNEE, image, compressed)
    y, x = np.mgrid[: image.shape[0], : image.shape[1]]
    radius_squared = 2 * ((x / image.shape[1] - 0.5) ** 2 + (y / image.shape[0] - 0.5) ** 2)
    image = image * (1 - webcam.vignette * radius_squared)[..., None]
    image = gaussian_filter(image, (webcam.blur_px, webcam.blur_px, 0))
    if webcam.motion_px:
        image = _motion_blur(image, webcam.motion_px, webcam.motion_rad)
    grain = np.random.default_rng(webcam.seed).normal(0, 1, image.shape)
    grain = 0.6 * grain + 1.44 * gaussian_filter(grain, (0.7, 0.7, 0))  # demosaicing correlates neighboring pixels
    image = linear_to_srgb(image + webcam.noise * np.sqrt(0.25 + np.maximum(image, 0)) * grain)
    image = image + webcam.contrast * (smoothstep(0, 1, image) - image)
    image = image + webcam.sharpening * (image - gaussian_filter(image, (1.0, 1.0, 0)))
    file = io.BytesIO()
    pixels = (np.clip(image, 0, 1) * 255 + 0.5).astype(np.uint8)
    Image.fromarray(pixels).save(file, "JPEG", quality=webcam.jpeg_quality)
    return file.getvalue()


def _auto_exposure(image: Array, coverage: Array, ev: float) -> Array:
    luminance = image @ LUMINANCE
    gain_by_mean = 0.11 / np.exp(np.log(np.maximum(luminance, 1e-4)).mean())
    gain_by_highlights = 0.189 / max(float(np.percentile(luminance, 80)), 1e-4)
    image = image * (gain_by_mean + gain_by_highlights) * 2**ev
    hand = coverage > 0.9
    if hand.any():
        level = max(float(np.percentile((image @ LUMINANCE)[hand], 75)), 1e-6)
        image = image * np.clip(level, 0.06, 0.55) / level
    return np.asarray(image)


def _motion_blur(image: Array, length_px: float, angle_rad: float) -> Array:
    y, x, channel = np.indices(image.shape)
    steps = np.linspace(-length_px / 2, length_px / 2, MOTION_STEPS)
    shifted = [
        map_coordinates(image, [y + t * np.sin(angle_rad), x + t * np.cos(angle_rad), channel], order=1, mode="nearest")
        for t in steps
    ]
    return np.asarray(np.mean(shifted, axis=0))
