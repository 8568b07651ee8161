"""From radiance to the bytes of a cheap camera: exposure, highlights, lens, noise, sharpening, JPEG."""

import dataclasses
import io

import numpy as np
from numpy.typing import NDArray
from PIL import Image
from scipy.ndimage import gaussian_filter, map_coordinates

from generator.noise import smoothstep
from generator.skin.palette import srgb

__all__ = ["Webcam", "develop"]

Array = NDArray[np.float64]
LUMINANCE = np.array([0.2126, 0.7152, 0.0722])
MOTION_STEPS = 9


@dataclasses.dataclass(frozen=True)
class Webcam:
    """How a picture is taken.

    Attributes:
        exposure_ev: stops above or below what the automatic exposure chooses.
        white_balance: gain of each colour.
        noise: standard deviation of the shot noise at full exposure, 0 to 1.
        blur_px: standard deviation of the lens blur.
        motion_px: length of the motion blur.
        motion_rad: its direction.
        vignette: loss of light in the corners, 0 to 1.
        contrast: share of an S-curve.
        sharpening: strength of the unsharp mask.
        jpeg_quality: 1 to 95.
        seed: of the noise.
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


def develop(radiance: Array, coverage: Array, webcam: Webcam) -> bytes:
    """JPEG file of linear radiance (H, W, 3); the exposure keeps the hand (its share is ``coverage``) in range."""
    rng = np.random.default_rng(webcam.seed)
    image = np.nan_to_num(radiance)
    image = np.minimum(image, 3 * np.percentile(image, 99.7)) * webcam.white_balance
    image = _exposed(image, coverage, webcam.exposure_ev)
    image = np.where(image < 0.7, image, 0.7 + 0.3 * (1 - np.exp(-(image - 0.7) / 0.3)))
    image = image * (1 - webcam.vignette * _radius_squared(*image.shape[:2]))[..., None]
    image = gaussian_filter(image, (webcam.blur_px, webcam.blur_px, 0))
    if webcam.motion_px:
        image = _moved(image, webcam.motion_px, webcam.motion_rad)
    grain = rng.normal(0, 1, image.shape)
    grain = 0.6 * grain + 1.44 * gaussian_filter(grain, (0.7, 0.7, 0))  # demosaicing correlates neighbours
    image = srgb(image + webcam.noise * np.sqrt(0.25 + np.maximum(image, 0)) * grain)
    image = image + webcam.contrast * (smoothstep(0, 1, image) - image)
    image = image + webcam.sharpening * (image - gaussian_filter(image, (1.0, 1.0, 0)))
    file = io.BytesIO()
    pixels = (np.clip(image, 0, 1) * 255 + 0.5).astype(np.uint8)
    Image.fromarray(pixels).save(file, "JPEG", quality=webcam.jpeg_quality)
    return file.getvalue()


def _exposed(image: Array, coverage: Array, ev: float) -> Array:
    luminance = image @ LUMINANCE
    by_mean = 0.11 / np.exp(np.log(np.maximum(luminance, 1e-4)).mean())
    by_highlights = 0.189 / max(float(np.percentile(luminance, 80)), 1e-4)
    image = image * (by_mean + by_highlights) * 2**ev
    hand = coverage > 0.9
    if hand.any():
        level = max(float(np.percentile((image @ LUMINANCE)[hand], 75)), 1e-6)
        image = image * np.clip(level, 0.06, 0.55) / level
    return np.asarray(image)


def _radius_squared(height: int, width: int) -> Array:
    y, x = np.mgrid[:height, :width]
    return np.asarray(2 * ((x / width - 0.5) ** 2 + (y / height - 0.5) ** 2))


def _moved(image: Array, length_px: float, angle_rad: float) -> Array:
    y, x = np.mgrid[: image.shape[0], : image.shape[1]]
    steps = np.linspace(-length_px / 2, length_px / 2, MOTION_STEPS)
    shifted = [
        [
            map_coordinates(
                image[..., c], [y + t * np.sin(angle_rad), x + t * np.cos(angle_rad)], order=1, mode="nearest"
            )
            for c in range(3)
        ]
        for t in steps
    ]
    return np.moveaxis(np.mean(shifted, axis=0), 0, -1)
