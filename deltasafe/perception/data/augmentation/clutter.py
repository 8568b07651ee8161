"""Things that lie about: paper, boxes, pens, balls, and now and then something of the color of skin."""

import cv2
import numpy as np

from deltasafe.perception.data.augmentation.skin import skin_color
from deltasafe.perception.data.augmentation.textures import any_color, smooth_noise

__all__ = ["add_clutter"]

SKIN_SHARE = 0.15


def add_clutter(rng: np.random.Generator, picture: np.ndarray, n_objects: int) -> list[str]:
    """Draw ``n_objects`` with their shadows into ``picture`` ``(H, W, 3)`` float32, and say what they are."""
    height, width = picture.shape[:2]
    kinds = []
    for _ in range(n_objects):
        kind = ("sheet", "box", "bar", "ball")[int(rng.integers(4))]
        if rng.random() < SKIN_SHARE:
            kind = "skin_colored"
        cover: np.ndarray = np.zeros((height, width), np.float32)
        at = rng.uniform(-0.05, 1.05, 2) * (width, height)
        long = rng.uniform(0.12, 0.5) * width
        slim = {"sheet": rng.uniform(0.5, 0.9), "box": rng.uniform(0.3, 1.0), "bar": rng.uniform(0.04, 0.2)}
        angle = float(rng.uniform(0, 360))
        if kind in slim:
            corners = cv2.boxPoints(((float(at[0]), float(at[1])), (long, long * slim[kind]), angle))
            cv2.fillConvexPoly(cover, np.round(corners * 16).astype(np.int32), 1.0, cv2.LINE_AA, 4)
        else:
            axes = (long * 0.25, long * 0.25 * (1.0 if kind == "ball" else rng.uniform(0.5, 1.0)))
            cv2.ellipse(cover, ((float(at[0]), float(at[1])), (2 * axes[0], 2 * axes[1]), angle), 1.0, -1)
        cover = cv2.GaussianBlur(cover, (0, 0), rng.uniform(0.5, 1.5))
        _shade(rng, picture, cover, width)
        color = skin_color(rng) if kind == "skin_colored" else any_color(rng)
        paint = np.ones_like(picture) * color
        if kind == "sheet":
            paint = _printed(rng, height, width)
        elif kind in ("ball", "skin_colored", "bar"):
            paint = paint * _rounded(cover, rng)
        paint *= 1 + 0.06 * smooth_noise(rng, width, height, 12, 12)[..., None]
        picture += (paint - picture) * cover[..., None]
        kinds.append(kind)
    return kinds


def _shade(rng: np.random.Generator, picture: np.ndarray, cover: np.ndarray, width: int) -> None:
    x, y = rng.uniform(-0.04, 0.04, 2) * width
    shift = np.array([[1, 0, x], [0, 1, y]], np.float32)
    shadow = cv2.warpAffine(cover, shift, (cover.shape[1], cover.shape[0]))
    shadow = cv2.GaussianBlur(shadow, (0, 0), rng.uniform(0.003, 0.03) * width)
    picture *= 1 - rng.uniform(0.1, 0.6) * shadow[..., None]


def _rounded(cover: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    depth = cv2.distanceTransform((cover > 0.5).astype(np.uint8), cv2.DIST_L2, 3)
    depth = np.sqrt(depth / max(float(depth.max()), 1.0))
    return (rng.uniform(0.35, 0.7) + 0.55 * depth)[..., None].astype(np.float32)


def _printed(rng: np.random.Generator, height: int, width: int) -> np.ndarray:
    sheet = np.full((height, width, 3), rng.uniform(0.7, 1.0), np.float32)
    if rng.random() < 0.6:
        pitch, ink = int(rng.integers(5, 12)), rng.uniform(0.1, 0.6)
        words = cv2.resize(
            (rng.random((height // pitch + 1, width // 4 + 1)) < 0.75).astype(np.float32),
            (width, height),
            interpolation=0,
        )
        lines = ((np.arange(height) % pitch) < pitch * 0.4)[:, None] * words
        sheet *= 1 - (1 - ink) * lines[..., None].astype(np.float32)
    return sheet
