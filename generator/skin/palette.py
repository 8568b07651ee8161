"""Skin tones, palm colors, and the conversion between sRGB and linear colors. Albedos are linear."""

import numpy as np
from numpy.typing import ArrayLike

from generator.aliases import Array, Rgb

# from lightest (0) to darkest (9)
TONES_SRGB = (
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
PALM_SRGB = (226, 168, 150)


def srgb_to_linear(srgb_255: ArrayLike) -> Array:
    """Convert sRGB values in [0, 255] to linear values in [0, 1] (IEC 61966-2-1)."""
    value = np.asarray(srgb_255, dtype=float) / 255
    return np.where(value <= 0.04045, value / 12.92, ((value + 0.055) / 1.055) ** 2.4)


def linear_to_srgb(value: Array) -> Array:
    """Convert linear values to sRGB in [0, 1]; values outside [0, 1] are clipped."""
    value = np.clip(value, 0, 1)
    return np.where(value <= 0.0031308, 12.92 * value, 1.055 * value ** (1 / 2.4) - 0.055)


def random_albedo(rng: np.random.Generator, maximum: float) -> Rgb:
    """Sample the linear color of an object, uniform in sRGB, clipped to [0.01, ``maximum``]."""
    red, green, blue = np.clip(srgb_to_linear(rng.integers(10, 250, 3)), 0.01, maximum).tolist()
    return red, green, blue


def tone_darkness(tone: float) -> float:
    """Map a skin tone to [0, 1]: 0 up to tone 3, then linear to 1 for the darkest tone."""
    return float(np.clip((tone - 3) / 6, 0, 1))


def tone_albedo(tone: float) -> Array:
    """Interpolate the albedo (3,) of a tone in [0, 9] between its neighbors in the palette."""
    i = min(int(tone), len(TONES_SRGB) - 2)
    return np.asarray(srgb_to_linear(TONES_SRGB[i]) * (1 - tone + i) + srgb_to_linear(TONES_SRGB[i + 1]) * (tone - i))


def palm_albedo(tone: float) -> Array:
    """Return the albedo (3,) of the palm, which differs less between people than the back of the hand."""
    darkness = tone_darkness(tone)
    mixed = tone_albedo(tone) * (0.75 - 0.45 * darkness)
    return np.asarray(mixed + srgb_to_linear(PALM_SRGB) * (0.25 + 0.45 * darkness) * (0.95 - 0.35 * darkness))
