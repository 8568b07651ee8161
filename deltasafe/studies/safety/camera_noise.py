"""Camera noise: another image of the same scene with new exposure, white balance, sensor noise and compression."""

import numpy as np
from numpy.typing import NDArray

from deltasafe.studies.safety.settings import CameraSettings


def photograph_again(rgb: NDArray[np.uint8], settings: CameraSettings, rng: np.random.Generator) -> NDArray[np.uint8]:
    """Simulate another image (H, W, 3) of the same camera, compressed and decoded again."""
    import cv2

    image = expose(rgb, settings, rng)
    quality = int(rng.integers(settings.jpeg_quality[0], settings.jpeg_quality[1] + 1))
    _, stored = cv2.imencode(".jpg", image[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, quality])
    return np.asarray(cv2.imdecode(stored, cv2.IMREAD_COLOR_RGB), np.uint8)


def expose(rgb: NDArray[np.uint8], settings: CameraSettings, rng: np.random.Generator) -> NDArray[np.uint8]:
    """Simulate another exposure (H, W, 3) of an image, before compression.

    Gains act on the stored values, like a camera's digital gain. The variance of shot noise is proportional to the
    light (Healey and Kondepudy 1994); read noise is constant.
    """
    gain = 2.0 ** rng.normal(0.0, settings.exposure_stops_sd)
    balance = 1.0 + rng.normal(0.0, settings.white_balance_sd, 2)
    light = rgb.astype(np.float32) * np.float32(gain) * np.array([balance[0], 1.0, balance[1]], np.float32)
    spread = np.sqrt(settings.read_noise_sd**2 + settings.shot_noise_sd**2 * np.clip(light, 0, 255) / 255)
    noisy = light + spread.astype(np.float32) * rng.standard_normal(rgb.shape, dtype=np.float32)
    return np.asarray(np.clip(np.round(noisy), 0, 255), np.uint8)
