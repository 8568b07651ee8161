"""Objects on the background: paper, boxes, bars, balls, and sometimes an object with the color of skin."""

import cv2
import numpy as np

from deltasafe.perception.data.augmentation.skin import random_skin_color
from deltasafe.perception.data.augmentation.textures import random_color, smooth_noise

P_SKIN_COLORED = 0.15


def add_clutter(rng: np.random.Generator, background: np.ndarray, n_objects: int) -> list[str]:
    """Draw ``n_objects`` with their shadows into ``background`` ``(H, W, 3)`` float32; returns their kinds."""
    height, width = background.shape[:2]
    kinds = []
    for _ in range(n_objects):
        kind = ("sheet", "box", "bar", "ball")[int(rng.integers(4))]
        if rng.random() < P_SKIN_COLORED:
            kind = "skin_colored"
        coverage = _object_coverage(rng, kind, width, height)
        _cast_shadow(rng, background, coverage)
        color = random_skin_color(rng) if kind == "skin_colored" else random_color(rng)
        paint = np.ones_like(background) * color
        if kind == "sheet":
            paint = _printed_sheet(rng, height, width)
        elif kind in ("ball", "skin_colored", "bar"):
            paint = paint * _round_shading(rng, coverage)
        paint *= 1 + 0.06 * smooth_noise(rng, width, height, 12, 12)[..., None]
        background += (paint - background) * coverage[..., None]
        kinds.append(kind)
    return kinds


def _object_coverage(rng: np.random.Generator, kind: str, width: int, height: int) -> np.ndarray:
    coverage: np.ndarray = np.zeros((height, width), np.float32)
    x, y = (rng.uniform(-0.05, 1.05, 2) * (width, height)).tolist()
    length = rng.uniform(0.12, 0.5) * width
    # all three are drawn for every kind: the random stream of the stored sets depends on it
    aspects = {"sheet": rng.uniform(0.5, 0.9), "box": rng.uniform(0.3, 1.0), "bar": rng.uniform(0.04, 0.2)}
    angle_deg = float(rng.uniform(0, 360))
    if kind in aspects:
        corners = cv2.boxPoints(((x, y), (length, length * aspects[kind]), angle_deg))
        cv2.fillConvexPoly(coverage, np.round(corners * 16).astype(np.int32), 1.0, cv2.LINE_AA, 4)
    else:
        axes = (length * 0.25, length * 0.25 * (1.0 if kind == "ball" else rng.uniform(0.5, 1.0)))
        cv2.ellipse(coverage, ((x, y), (2 * axes[0], 2 * axes[1]), angle_deg), 1.0, -1)
    return cv2.GaussianBlur(coverage, (0, 0), rng.uniform(0.5, 1.5))


def _cast_shadow(rng: np.random.Generator, background: np.ndarray, coverage: np.ndarray) -> None:
    height, width = coverage.shape
    x, y = rng.uniform(-0.04, 0.04, 2) * width
    shadow = cv2.warpAffine(coverage, np.array([[1, 0, x], [0, 1, y]], np.float32), (width, height))
    shadow = cv2.GaussianBlur(shadow, (0, 0), rng.uniform(0.003, 0.03) * width)
    background *= 1 - rng.uniform(0.1, 0.6) * shadow[..., None]


def _round_shading(rng: np.random.Generator, coverage: np.ndarray) -> np.ndarray:
    depth = cv2.distanceTransform((coverage > 0.5).astype(np.uint8), cv2.DIST_L2, 3)
    depth = np.sqrt(depth / max(float(depth.max()), 1.0))
    return (rng.uniform(0.35, 0.7) + 0.55 * depth)[..., None].astype(np.float32)


def _printed_sheet(rng: np.random.Generator, height: int, width: int) -> np.ndarray:
    sheet = np.full((height, width, 3), rng.uniform(0.7, 1.0), np.float32)
    if rng.random() < 0.6:
        pitch, ink = int(rng.integers(5, 12)), rng.uniform(0.1, 0.6)
        letters = (rng.random((height // pitch + 1, width // 4 + 1)) < 0.75).astype(np.float32)
        words = cv2.resize(letters, (width, height), interpolation=cv2.INTER_NEAREST)
        lines = ((np.arange(height) % pitch) < pitch * 0.4)[:, None] * words
        sheet *= 1 - (1 - ink) * lines[..., None].astype(np.float32)
    return sheet
