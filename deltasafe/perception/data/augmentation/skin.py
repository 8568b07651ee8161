"""The range of human skin, from dark to light, as colors in CIE Lab."""

import cv2
import numpy as np

__all__ = ["N_TONES", "recolor", "skin_color", "tone_lab"]

N_TONES = 20
# lightness, and the green-red and blue-yellow coordinates that go with it
_LIGHTNESS = np.linspace(19.0, 84.0, N_TONES)
_KNOTS = (19.0, 27.0, 38.0, 50.0, 62.0, 72.0, 84.0)
_RED = np.interp(_LIGHTNESS, _KNOTS, (6.0, 10.0, 14.0, 16.0, 15.0, 13.0, 9.0))
_YELLOW = np.interp(_LIGHTNESS, _KNOTS, (5.0, 10.0, 17.0, 21.0, 21.0, 19.0, 13.0))


def tone_lab(tone: int) -> np.ndarray:
    """Mean color ``(3,)`` in Lab of one of the 20 tones, 0 the darkest."""
    return np.array([_LIGHTNESS[tone], _RED[tone], _YELLOW[tone]], np.float32)


def skin_color(rng: np.random.Generator) -> np.ndarray:
    """The color ``(3,)`` in RGB, [0, 1], of some skin."""
    lab = tone_lab(int(rng.integers(N_TONES))) + rng.normal(0, (2, 2, 3)).astype(np.float32)
    return cv2.cvtColor(lab[None, None].astype(np.float32), cv2.COLOR_LAB2RGB)[0, 0]


def recolor(rgb: np.ndarray, alpha: np.ndarray, lab: np.ndarray, contrast: float, chroma: float) -> np.ndarray:
    """Give the skin in ``rgb`` another mean color, keeping its relief.

    Args:
        rgb: ``(H, W, 3)`` float32 in [0, 1], of which only the pixels with ``alpha`` > 0.5 count for the
            mean.
        alpha: ``(H, W)`` coverage of the hand.
        lab: ``(3,)`` the new mean in Lab.
        contrast: factor on deviations of lightness from the mean.
        chroma: factor on deviations of color from the mean.

    Returns:
        ``(H, W, 3)`` float32 in [0, 1].
    """
    skin = alpha > 0.5
    if not skin.any():
        return rgb
    values = cv2.cvtColor(np.ascontiguousarray(rgb, np.float32), cv2.COLOR_RGB2LAB)
    mean = values[skin].mean(axis=0)
    # relief is roughly a factor in luminance: on dark skin the same light makes smaller steps
    relief = contrast * float(np.clip((lab[0] / max(float(mean[0]), 5.0)) ** 0.5, 0.5, 1.3))
    moved = lab + (values - mean) * np.array([relief, chroma, chroma], np.float32)
    moved[..., 0] = np.clip(moved[..., 0], 0.0, 100.0)
    return np.clip(cv2.cvtColor(moved.astype(np.float32), cv2.COLOR_LAB2RGB), 0.0, 1.0)
