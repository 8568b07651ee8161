"""Faces, roughly: skin that is no hand. People who reach over a table are often in the picture themselves."""

import numpy as np

from deltasafe.perception.augmentation.skin import skin_colour
from deltasafe.perception.augmentation.textures import any_colour, smooth_noise

__all__ = ["draw_face"]

HAIR_SHARE = 0.85
BEARD_SHARE = 0.2
GLASSES_SHARE = 0.2


def draw_face(rng: np.random.Generator, middle: np.ndarray, radius: float, size: tuple[int, int]) -> np.ndarray:
    """A head with features, hair, neck and clothes, turned by any angle.

    Args:
        rng: source of the draw.
        middle: ``(2,)`` x and y of the face in pixels of the picture.
        radius: half the height of the face in pixels.
        size: width and height of the picture.

    Returns:
        ``(H, W, 4)`` float32 in [0, 1]: colour and coverage.
    """
    width, height = size
    turn = float(rng.uniform(-0.6, 0.6)) if rng.random() < 0.7 else float(rng.uniform(-np.pi, np.pi))
    x, y = np.meshgrid(np.arange(width, dtype=np.float32), np.arange(height, dtype=np.float32))
    dx, dy = (x - middle[0]) / radius, (y - middle[1]) / radius
    across, down = dx * np.cos(turn) + dy * np.sin(turn), dy * np.cos(turn) - dx * np.sin(turn)
    soft = max(1.2 / radius, 0.03)
    skin, dark = skin_colour(rng), any_colour(rng) * float(rng.uniform(0.1, 0.6))
    broad, jaw = float(rng.uniform(0.68, 0.82)), float(rng.uniform(0.1, 0.3))

    half = broad * np.sqrt(np.clip(1 - down**2, 0, 1)) * (1 - jaw * np.clip(down, 0, 1))
    head = _soft(half - np.abs(across), soft) * (half > 0)
    shade = 0.62 + 0.45 * np.sqrt(np.clip(1 - (across / (broad + 0.02)) ** 2 - 0.3 * down**2, 0, 1))
    shade = shade * (1 + rng.uniform(-0.25, 0.25) * across) * (1 + 0.05 * smooth_noise(rng, width, height, 9, 9))
    looks_aside = float(rng.normal(0, 0.15))
    face = _features(rng, skin * shade[..., None], skin, dark, across - looks_aside, down)

    neck = _soft(0.55 * broad - np.abs(across), soft) * _soft(down - 0.6, 0.05)
    colour = skin * (0.45 + 0.2 * np.sqrt(np.clip(1 - (across / 0.5) ** 2, 0, 1)))[..., None]
    clothes = any_colour(rng) * (0.7 + 0.12 * smooth_noise(rng, width, height, 16, 16))[..., None]
    body = _soft(down - 1.0 - 0.35 * across**2, soft) * _soft(1.9 - np.abs(across), soft)
    for paint, cover in ((clothes, body), (face, head)):
        colour = _over(colour, paint, cover)
    covered = np.maximum(np.maximum(head, neck), body)
    if rng.random() < HAIR_SHARE:
        line, length = float(rng.uniform(-0.75, -0.4)), float(rng.uniform(-0.6, 1.0))
        front = _soft(line - down + 0.5 * (across - 0.4 * looks_aside) ** 2, 0.06)
        beside = _soft(np.abs(across) - 0.8 * half, 0.05) * _soft(length - down, 0.1) * (half > 0)
        crown = _soft(1 - np.hypot(across / (broad + 0.12), (down + 0.08) / 1.12), soft)
        hair = crown * np.maximum(front, beside)
        colour = _over(colour, dark * (0.8 + 0.35 * smooth_noise(rng, width, height, 3, 14))[..., None], hair)
        covered = np.maximum(covered, hair)
    return np.dstack([np.clip(colour, 0, 1), covered]).astype(np.float32)


def _features(
    rng: np.random.Generator,
    colour: np.ndarray,
    skin: np.ndarray,
    dark: np.ndarray,
    across: np.ndarray,
    down: np.ndarray,
) -> np.ndarray:
    """Eyes, brows, nose and mouth, now and then glasses and a beard, painted over ``colour`` ``(H, W, 3)``."""
    for eye in (across - 0.32, across + 0.32):
        height = down + 0.12
        brow = _soft(0.06 - 2 * np.abs(down + 0.3 + 0.3 * eye**2), 0.06) * _soft(0.2 - np.abs(eye), 0.03)
        colour = _over(colour, 0.85, _soft(1 - eye**2 / 0.022 - height**2 / 0.006, 0.5))
        colour = _over(colour, 0.15, _soft(0.075 - np.hypot(eye, height), 0.03))
        colour = _over(colour, dark, 0.6 * brow)
    nose = _soft(0.06 - np.abs(across - 0.06), 0.05) * _soft(0.2 - np.abs(down - 0.12), 0.1)
    nostrils = _soft(0.13 - np.abs(across), 0.05) * _soft(0.03 - np.abs(down - 0.32), 0.03)
    mouth = _soft(1 - across**2 / 0.07 - (down - 0.55) ** 2 / 0.006, 0.4)
    colour = _over(_over(colour, 0.1, 0.25 * nose), 0.1, 0.5 * nostrils)
    colour = _over(colour, skin * np.array([0.9, 0.55, 0.55], np.float32), 0.8 * mouth)
    if rng.random() < GLASSES_SHARE:
        rings = [np.abs(np.hypot(eye, 1.2 * (down + 0.12)) - 0.22) for eye in (across - 0.32, across + 0.32)]
        colour = _over(colour, 0.1, _soft(0.03 - np.minimum(*rings), 0.02))
    if rng.random() < BEARD_SHARE:
        colour = _over(colour, dark, 0.85 * _soft(down - 0.1 - 0.2 * np.abs(across), 0.15) * (1 - mouth))
    return colour


def _over(below: np.ndarray, paint: np.ndarray | float, cover: np.ndarray) -> np.ndarray:
    return np.asarray(below + (paint - below) * cover[..., None])


def _soft(inside: np.ndarray, softness: float) -> np.ndarray:
    """1 where ``inside`` is positive, 0 where it is negative, with an edge of some width."""
    return np.clip(inside / softness + 0.5, 0.0, 1.0)
