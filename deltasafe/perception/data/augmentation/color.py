"""Color modification: color and lighting of the object, then the camera's color processing of the whole image."""

import numpy as np

from deltasafe.perception.data.augmentation.skin import N_TONES, mean_lab, recolor, tone_lab
from deltasafe.perception.data.augmentation.textures import light_gradient, smooth_noise

P_UNEVEN_LIGHT = 0.3
P_STRONG_CAST = 0.2


def recolor_hand(
    rng: np.random.Generator, rgb: np.ndarray, alpha: np.ndarray
) -> tuple[np.ndarray, dict[str, float | int]]:
    """Give the hand another skin tone (one of 20, from dark to light), light from one side, and its own exposure.

    Args:
        rng: source of the draws.
        rgb: ``(H, W, 3)`` float32 in [0, 1], the hand alone.
        alpha: ``(H, W)`` coverage of the hand.
    """
    tone = int(rng.integers(N_TONES))
    lab = tone_lab(tone) + rng.normal(0.0, (1.5, 2.0, 3.0)).astype(np.float32)
    rgb = recolor(rgb, alpha, lab, contrast=float(rng.uniform(0.8, 1.5)), chroma=float(rng.uniform(0.5, 1.4)))
    rgb, drawn = _relight(rng, rgb)
    return rgb, {"tone": tone, **drawn}


def recolor_object(
    rng: np.random.Generator, rgb: np.ndarray, alpha: np.ndarray
) -> tuple[np.ndarray, dict[str, float | int]]:
    """Shift the color of an object that is no hand a little, light it from one side, and give it its own exposure.

    Args:
        rng: source of the draws.
        rgb: ``(H, W, 3)`` float32 in [0, 1], the object alone.
        alpha: ``(H, W)`` coverage of the object.
    """
    lightness, a, b = rng.normal(0.0, (8.0, 4.0, 4.0)).tolist()
    contrast, chroma = rng.uniform((0.8, 0.7), (1.3, 1.3)).tolist()
    lab = mean_lab(rgb, alpha) + np.array([lightness, a, b], np.float32)
    rgb, drawn = _relight(rng, recolor(rgb, alpha, lab, contrast, chroma))
    return rgb, {"lightness": lightness, **drawn}


def _relight(rng: np.random.Generator, rgb: np.ndarray) -> tuple[np.ndarray, dict[str, float | int]]:
    drawn: dict[str, float | int] = {}
    height, width = rgb.shape[:2]
    if rng.random() < 0.5:
        drawn["side_light"] = float(rng.uniform(0.1, 0.5))
        rgb = rgb * light_gradient(rng, width, height, drawn["side_light"])
    if rng.random() < P_UNEVEN_LIGHT:  # shade of fingers and of things beside the object
        cell_px = float(np.exp(rng.uniform(*np.log((0.12, 0.6))))) * width
        drawn["uneven_light"] = float(rng.uniform(0.1, 0.6))
        noise = smooth_noise(rng, width, height, cell_px, cell_px)[..., None]
        rgb = rgb * (1 + np.float32(drawn["uneven_light"]) * noise)
    if rng.random() < 0.25:  # backlight, or a spotlight on the object
        drawn["own_exposure_stops"] = float(rng.uniform(-0.8, 0.4))
        rgb = rgb * np.float32(2.0 ** drawn["own_exposure_stops"])
    return np.clip(rgb, 0.0, 1.0).astype(np.float32), drawn


def simulate_camera(rng: np.random.Generator, rgb: np.ndarray) -> tuple[np.ndarray, dict[str, float]]:
    """Change white balance, exposure, gamma, saturation and vignetting of the image ``(H, W, 3)`` float32.

    One image in five has a strong cast, as photographs in lamplight do.
    """
    height, width = rgb.shape[:2]
    warm_sd, green_sd = (0.25, 0.08) if rng.random() < P_STRONG_CAST else (0.13, 0.05)
    drawn = {
        "warm": float(rng.normal(0, warm_sd)),
        "green": float(rng.normal(0, green_sd)),
        "exposure_stops": float(rng.uniform(-0.6, 0.6)),
        "gamma": float(np.exp(rng.uniform(-0.3, 0.3))),
        "saturation": float(rng.uniform(0.55, 1.4)),
        "vignette": float(rng.uniform(0.0, 0.35)),
    }
    warm, green, stops, gamma, saturation, vignette = drawn.values()
    gains = np.exp(np.array([warm, green, -warm])).astype(np.float32) * np.float32(2.0**stops)
    rgb = np.clip(rgb, 0.0, 1.0) ** np.float32(gamma) * gains
    gray = rgb @ np.array([0.299, 0.587, 0.114], np.float32)
    rgb = gray[..., None] + (rgb - gray[..., None]) * np.float32(saturation)
    x, y = np.linspace(-1, 1, width, dtype=np.float32), np.linspace(-1, 1, height, dtype=np.float32)
    rgb = rgb * (1 - np.float32(vignette) * 0.5 * (x[None, :, None] ** 2 + y[:, None, None] ** 2))
    shoulder = np.float32(0.85)  # highlights are compressed above this value before they clip
    over = np.maximum(rgb - shoulder, 0)
    rgb = np.minimum(rgb, shoulder) + (1 - shoulder) * (1 - np.exp(-over / (1 - shoulder)))
    return np.clip(rgb, 0.0, 1.0).astype(np.float32), drawn
