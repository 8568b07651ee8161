"""Ten skin tones from light to dark, and the palm that belongs to each. Albedos are linear."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

__all__ = ["TONES", "darkness_of", "linear", "palm_albedo", "srgb", "tone_albedo"]

Array = NDArray[np.float64]
TONES = (
    (238, 196, 176),
    (228, 178, 154),
    (222, 170, 142),
    (208, 152, 120),
    (196, 142, 108),
    (174, 120, 86),
    (146, 98, 70),
    (112, 74, 54),
    (84, 55, 42),
    (66, 44, 36),
)
PALM = (226, 168, 150)


def linear(srgb_255: ArrayLike) -> Array:
    """Linear 0 to 1 of sRGB 0 to 255 (IEC 61966-2-1)."""
    value = np.asarray(srgb_255, dtype=float) / 255
    return np.where(value <= 0.04045, value / 12.92, ((value + 0.055) / 1.055) ** 2.4)


def srgb(value: Array) -> Array:
    """sRGB 0 to 1 of linear values, which are clipped to 0 to 1."""
    value = np.clip(value, 0, 1)
    return np.where(value <= 0.0031308, 12.92 * value, 1.055 * value ** (1 / 2.4) - 0.055)


def darkness_of(tone: float) -> float:
    """0 for light skin, 1 for the darkest tone."""
    return float(np.clip((tone - 3) / 6, 0, 1))


def tone_albedo(tone: float) -> Array:
    """(3,) albedo of a tone between 0 and 9, interpolated between neighbours of the palette."""
    i = min(int(tone), len(TONES) - 2)
    return np.asarray(linear(TONES[i]) * (1 - tone + i) + linear(TONES[i + 1]) * (tone - i))


def palm_albedo(tone: float) -> Array:
    """(3,) albedo of the palm: nearer to that of other people than the back of the hand is."""
    dark = darkness_of(tone)
    mixed = tone_albedo(tone) * (0.75 - 0.45 * dark)
    return np.asarray(mixed + linear(PALM) * (0.25 + 0.45 * dark) * (0.95 - 0.35 * dark))
