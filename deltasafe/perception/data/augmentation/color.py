"""Color modification: another skin, another light, another camera."""

import numpy as np

from deltasafe.perception.data.augmentation.skin import N_TONES, recolor, tone_lab
from deltasafe.perception.data.augmentation.textures import light_falloff

__all__ = ["color_hand", "color_picture"]


def color_hand(
    rng: np.random.Generator, rgb: np.ndarray, alpha: np.ndarray
) -> tuple[np.ndarray, dict[str, float | int]]:
    """Another skin tone (one of 20, evenly from dark to light) and light from another side on the hand alone.

    Args:
        rgb: the hand's layer ``(H, W, 3)`` float32 in [0, 1].
        alpha: ``(H, W)`` its coverage.
    """
    height, width = alpha.shape
    tone = int(rng.integers(N_TONES))
    lab = tone_lab(tone) + rng.normal(0.0, (1.5, 2.0, 3.0)).astype(np.float32)
    rgb = recolor(rgb, alpha, lab, float(rng.uniform(0.8, 1.5)), float(rng.uniform(0.5, 1.4)))
    drawn: dict[str, float | int] = {"tone": tone}
    if rng.random() < 0.5:
        drawn["side_light"] = float(rng.uniform(0.1, 0.5))
        rgb = rgb * light_falloff(rng, width, height, drawn["side_light"])
    if rng.random() < 0.25:  # against the light, or in a lamp's cone
        drawn["own_exposure_stops"] = float(rng.uniform(-0.8, 0.4))
        rgb = rgb * np.float32(2.0 ** drawn["own_exposure_stops"])
    return np.clip(rgb, 0.0, 1.0).astype(np.float32), drawn


def color_picture(rng: np.random.Generator, picture: np.ndarray) -> tuple[np.ndarray, dict[str, float | int]]:
    """Another camera for the whole picture ``(H, W, 3)`` float32, from white balance to vignette."""
    height, width = picture.shape[:2]
    warm, green = float(rng.normal(0, 0.13)), float(rng.normal(0, 0.05))
    stops, gamma = float(rng.uniform(-0.6, 0.6)), float(np.exp(rng.uniform(-0.3, 0.3)))
    saturation, vignette = float(rng.uniform(0.55, 1.4)), float(rng.uniform(0.0, 0.35))
    gains = np.exp(np.array([warm, green, -warm])).astype(np.float32) * np.float32(2.0**stops)
    picture = np.clip(picture, 0.0, 1.0) ** np.float32(gamma) * gains
    gray = picture @ np.array([0.299, 0.587, 0.114], np.float32)
    picture = gray[..., None] + (picture - gray[..., None]) * np.float32(saturation)
    x, y = np.linspace(-1, 1, width, dtype=np.float32), np.linspace(-1, 1, height, dtype=np.float32)
    picture = picture * (1 - np.float32(vignette) * 0.5 * (x[None, :, None] ** 2 + y[:, None, None] ** 2))
    shoulder = np.float32(0.85)  # highlights roll off before they clip
    over = np.maximum(picture - shoulder, 0)
    picture = np.minimum(picture, shoulder) + (1 - shoulder) * (1 - np.exp(-over / (1 - shoulder)))
    return np.clip(picture, 0.0, 1.0).astype(np.float32), {
        "warm": warm,
        "green": green,
        "exposure_stops": stops,
        "gamma": gamma,
        "saturation": saturation,
        "vignette": vignette,
    }
