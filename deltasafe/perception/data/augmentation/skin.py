"""Human skin tones, from dark to light, in CIE Lab."""

import cv2
import numpy as np

N_TONES = 20
_LIGHTNESS = np.linspace(19.0, 84.0, N_TONES)
# a* (green to red) and b* (blue to yellow) at these values of L*
_KNOTS = (19.0, 27.0, 38.0, 50.0, 62.0, 72.0, 84.0)
_A = np.interp(_LIGHTNESS, _KNOTS, (6.0, 10.0, 14.0, 16.0, 15.0, 13.0, 9.0))
_B = np.interp(_LIGHTNESS, _KNOTS, (5.0, 10.0, 17.0, 21.0, 21.0, 19.0, 13.0))


def tone_lab(tone: int) -> np.ndarray:
    """Mean color ``(3,)`` in Lab of one of the 20 tones; 0 is the darkest."""
    return np.array([_LIGHTNESS[tone], _A[tone], _B[tone]], np.float32)


def random_skin_color(rng: np.random.Generator) -> np.ndarray:
    """Draw a skin color ``(3,)``, RGB in [0, 1]."""
    lab = tone_lab(int(rng.integers(N_TONES))) + rng.normal(0, (2, 2, 3)).astype(np.float32)
    return cv2.cvtColor(lab[None, None].astype(np.float32), cv2.COLOR_LAB2RGB)[0, 0]


def mean_lab(rgb: np.ndarray, alpha: np.ndarray) -> np.ndarray:
    """Mean color ``(3,)`` in Lab of the pixels of ``rgb`` (H, W, 3) with ``alpha`` > 0.5; black without any."""
    covered = alpha > 0.5
    if not covered.any():
        return np.zeros(3, np.float32)
    return cv2.cvtColor(np.ascontiguousarray(rgb, np.float32), cv2.COLOR_RGB2LAB)[covered].mean(axis=0)


def recolor(rgb: np.ndarray, alpha: np.ndarray, lab: np.ndarray, contrast: float, chroma: float) -> np.ndarray:
    """Change the mean color of the skin in ``rgb`` and keep its shading.

    Args:
        rgb: ``(H, W, 3)`` float32 in [0, 1]. The old mean is that of the pixels with ``alpha`` > 0.5.
        alpha: ``(H, W)`` coverage of the hand.
        lab: ``(3,)`` the new mean in Lab.
        contrast: factor on deviations of the lightness from its mean.
        chroma: factor on deviations of a* and b* from their means.

    Returns:
        ``(H, W, 3)`` float32 in [0, 1].
    """
    skin = alpha > 0.5
    if not skin.any():
        return rgb
    values = cv2.cvtColor(np.ascontiguousarray(rgb, np.float32), cv2.COLOR_RGB2LAB)
    mean = values[skin].mean(axis=0)
    # shading is roughly a factor on luminance: the same light makes smaller differences on dark skin
    shading = contrast * float(np.clip((lab[0] / max(float(mean[0]), 5.0)) ** 0.5, 0.5, 1.3))
    moved = lab + (values - mean) * np.array([shading, chroma, chroma], np.float32)
    moved[..., 0] = np.clip(moved[..., 0], 0.0, 100.0)
    return np.clip(cv2.cvtColor(moved.astype(np.float32), cv2.COLOR_LAB2RGB), 0.0, 1.0)
