"""Clothing and jewelry: sleeves (not hand in the mask), watch straps and rings (hand in the mask)."""

import cv2
import numpy as np

from deltasafe.perception.data.augmentation.arm import Arm
from deltasafe.perception.data.augmentation.textures import hsv_to_rgb, random_color, smooth_noise

P_SLEEVE = 0.35
P_STRAP = 0.15
P_RINGS = 0.2
LONGEST_BARE_ARM = 2.6
"""In widths of the wrist."""


def add_sleeve(
    rng: np.random.Generator, arm: Arm, along: np.ndarray, across: np.ndarray, alpha: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray, dict[str, float]]:
    """Cover the outer part of the arm: with a probability of 0.35, and always if too much of it would be bare.

    Args:
        rng: source of the draws.
        arm: of the cut-out.
        along: ``(H, W)`` arm coordinate of each canvas pixel.
        across: as ``along``.
        alpha: ``(H, W)`` coverage of the hand.

    Returns:
        Color ``(H, W, 3)`` and coverage ``(H, W)`` of the sleeve (zero if there is none), the remaining coverage of
        the hand, and the drawn parameters.
    """
    height, width = alpha.shape
    wrist_px = arm.width_px * arm.narrowing
    visible = along[alpha > 0.5]
    too_long = visible.size > 0 and float(visible.max()) > LONGEST_BARE_ARM * wrist_px
    if not too_long and rng.random() >= P_SLEEVE:
        return np.zeros((height, width, 3), np.float32), np.zeros_like(alpha), alpha, {}
    nearest = 0.1 if arm.narrowing < 0.98 else -0.35
    start = float(rng.uniform(nearest, LONGEST_BARE_ARM if too_long else 1.0)) * wrist_px
    wide, flare = float(rng.uniform(1.1, 1.5)), float(rng.uniform(0.0, 0.2))
    bow = float(rng.uniform(-0.15, 0.15))
    half = 0.5 * arm.width_px * arm.profile(np.maximum(along, 0.0)) * wide
    half = half * (1 + flare * np.clip((along - start) / wrist_px, 0, 3) + 0.04 * np.sin(along / wrist_px * 5))
    wrinkles = 0.06 * wrist_px * smooth_noise(rng, width, height, 40, 40)
    from_cuff = along - start - bow * across * across / wrist_px - wrinkles
    edge_px = max(0.012 * wrist_px, 0.6)
    behind_cuff = np.clip(from_cuff / edge_px + 0.5, 0, 1)
    coverage = np.clip((half - np.abs(across)) / edge_px + 0.5, 0, 1) * behind_cuff
    roundness = np.sqrt(np.clip(1.02 - (across / np.maximum(half, 1e-3)) ** 2, 0.0, 1.0))
    folds = np.sin(along / wrist_px * rng.uniform(3, 9) + 2 * across / wrist_px)
    shading = (0.45 + 0.6 * roundness) * (1 + 0.18 * folds)
    shading = shading * (1 + 0.15 * smooth_noise(rng, width, height, 14, 14))
    shading = shading * (1 - 0.35 * np.exp(-((from_cuff / (0.05 * wrist_px)) ** 2)))
    color = random_color(rng) * shading[..., None]
    if rng.random() < 0.3:
        stripes = np.sin(along / wrist_px * rng.uniform(15, 40)) > 0.3
        color = np.where(stripes[..., None], random_color(rng) * shading[..., None], color)
    hidden = behind_cuff * (np.abs(across) < 2.0 * half)
    remaining = alpha * (1 - np.maximum(hidden, coverage))
    sleeve = np.clip(color, 0, 1).astype(np.float32)
    drawn = {"start_widths": start / wrist_px, "wide": wide}
    return sleeve, coverage.astype(np.float32), remaining.astype(np.float32), drawn


def add_strap(
    rng: np.random.Generator, arm: Arm, along: np.ndarray, across: np.ndarray, rgb: np.ndarray
) -> dict[str, float]:
    """Paint a watch or a bracelet around the arm into ``rgb``, with a probability of 0.15; returns its parameters."""
    if rng.random() >= P_STRAP:
        return {}
    wrist_px = arm.width_px * arm.narrowing
    nearest = 0.5 if arm.narrowing < 0.98 else -0.2
    middle = float(rng.uniform(nearest, nearest + 0.8)) * wrist_px
    broad = float(rng.uniform(0.06, 0.4)) * wrist_px
    from_middle = np.abs(along - middle - 0.1 * across * across / wrist_px)
    coverage = np.clip((broad / 2 - from_middle) / 1.0 + 0.5, 0, 1) * (np.abs(across) < arm.width_px)
    roundness = np.sqrt(np.clip(1.05 - (across / (0.55 * wrist_px)) ** 2, 0.05, 1.0))
    paint = random_color(rng) * (0.5 + 0.6 * roundness)[..., None]
    if rng.random() < 0.5:  # a watch
        dial = np.hypot(along - middle, across - 0.1 * wrist_px) < 0.24 * wrist_px
        paint = np.where(dial[..., None], random_color(rng), paint)
        coverage = np.maximum(coverage, dial.astype(np.float32))
    rgb += (np.clip(paint, 0, 1) - rgb) * coverage[..., None].astype(np.float32)
    return {"middle_widths": middle / wrist_px, "broad_widths": broad / wrist_px}


def add_rings(rng: np.random.Generator, rgb: np.ndarray, alpha: np.ndarray) -> int:
    """Paint one to three rings across narrow parts of the hand, with a probability of 0.2; returns how many."""
    if rng.random() >= P_RINGS:
        return 0
    depth = cv2.distanceTransform((alpha > 0.5).astype(np.uint8), cv2.DIST_L2, 5)
    ridge = (depth >= cv2.dilate(depth, np.ones((3, 3), np.uint8)) - 1e-3) & (depth > 0)
    ridge &= (depth > 0.04 * depth.max() + 2) & (depth < 0.45 * depth.max())
    ys, xs = np.nonzero(ridge)
    n_rings = min(int(rng.integers(1, 4)), xs.size)
    metal = hsv_to_rgb(rng.uniform(20, 55), rng.uniform(0, 0.7), 0.85)
    for pick in rng.permutation(xs.size)[:n_rings]:
        x, y, radius = int(xs[pick]), int(ys[pick]), float(depth[ys[pick], xs[pick]])
        near = (np.abs(ys - y) <= radius) & (np.abs(xs - x) <= radius)
        offsets = np.stack([xs[near] - x, ys[near] - y])
        across = _across_finger(depth, x, y, offsets)
        ends = [np.rint((x, y) + side * radius * across).astype(int).tolist() for side in (-1.3, 1.3)]
        coverage = np.zeros(alpha.shape, np.float32)
        thickness = max(1, round(float(rng.uniform(0.25, 0.6)) * radius))
        cv2.line(coverage, ends[0], ends[1], 1.0, thickness, cv2.LINE_AA)
        shine = 0.7 + 0.5 * rng.random()
        rgb += (np.clip(metal * shine, 0, 1) - rgb) * coverage[..., None]
    return n_rings


def _across_finger(depth: np.ndarray, x: int, y: int, offsets: np.ndarray) -> np.ndarray:
    """Unit vector across the finger at (x, y), from ``offsets`` (2, n) of near points on its center line."""
    if offsets.shape[1] > 2:  # the eigenvector of the smaller eigenvalue is perpendicular to the center line
        across = np.linalg.eigh(offsets @ offsets.T)[1][:, 0]
    else:  # the gradient of the depth
        height, width = depth.shape
        across = np.array(
            [
                float(depth[y, min(x + 2, width - 1)] - depth[y, max(x - 2, 0)]),
                float(depth[min(y + 2, height - 1), x] - depth[max(y - 2, 0), x]),
            ]
        )
    return across / max(float(np.hypot(*across)), 1e-6)
