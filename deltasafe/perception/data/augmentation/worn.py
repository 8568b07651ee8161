"""What people wear on arm and fingers: sleeves (not hand), straps and rings (counted as hand)."""

import cv2
import numpy as np

from deltasafe.perception.data.augmentation.cutout import Arm
from deltasafe.perception.data.augmentation.textures import any_color, smooth_noise

__all__ = ["add_rings", "add_sleeve", "add_strap"]

SLEEVE_SHARE = 0.35
STRAP_SHARE = 0.15
RING_SHARE = 0.2
LONGEST_BARE_ARM = 2.6


def add_sleeve(
    rng: np.random.Generator, arm: Arm, along: np.ndarray, across: np.ndarray, alpha: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray, dict[str, float]]:
    """Cover the arm from some place on: at random, and always where it would go on bare for too long.

    Args:
        rng: source of the draw.
        arm: of the cut-out.
        along: ``(H, W)`` of each pixel of the canvas in arm coordinates.
        across: as ``along``.
        alpha: ``(H, W)`` coverage of the hand.

    Returns:
        Color ``(H, W, 3)`` and coverage ``(H, W)`` of the sleeve (zero where there is none), coverage of
        what is left of
        the hand, and the drawn parameters.
    """
    height, width = alpha.shape
    wrist = arm.width * arm.narrowing
    visible = along[alpha > 0.5]
    too_long = visible.size > 0 and float(visible.max()) > LONGEST_BARE_ARM * wrist
    if not too_long and rng.random() >= SLEEVE_SHARE:
        return np.zeros((height, width, 3), np.float32), np.zeros_like(alpha), alpha, {}
    first = 0.1 if arm.narrowing < 0.98 else -0.35
    start = float(rng.uniform(first, LONGEST_BARE_ARM if too_long else 1.0)) * wrist
    wide, flare = float(rng.uniform(1.1, 1.5)), float(rng.uniform(0.0, 0.2))
    bow = float(rng.uniform(-0.15, 0.15))
    half = 0.5 * arm.width * arm.profile(np.maximum(along, 0.0)) * wide
    half = half * (1 + flare * np.clip((along - start) / wrist, 0, 3) + 0.04 * np.sin(along / wrist * 5))
    cuff = along - start - bow * across * across / wrist - 0.06 * wrist * smooth_noise(rng, width, height, 40, 40)
    soft = max(0.012 * wrist, 0.6)
    cover = np.clip((half - np.abs(across)) / soft + 0.5, 0, 1) * np.clip(cuff / soft + 0.5, 0, 1)
    round_off = np.sqrt(np.clip(1.02 - (across / np.maximum(half, 1e-3)) ** 2, 0.0, 1.0))
    cloth = (0.45 + 0.6 * round_off) * (1 + 0.18 * np.sin(along / wrist * rng.uniform(3, 9) + 2 * across / wrist))
    cloth = cloth * (1 + 0.15 * smooth_noise(rng, width, height, 14, 14))
    cloth = cloth * (1 - 0.35 * np.exp(-((cuff / (0.05 * wrist)) ** 2)))
    color = any_color(rng) * cloth[..., None]
    if rng.random() < 0.3:
        stripes = np.sin(along / wrist * rng.uniform(15, 40)) > 0.3
        color = np.where(stripes[..., None], any_color(rng) * cloth[..., None], color)
    hidden = np.clip(cuff / soft + 0.5, 0, 1) * (np.abs(across) < 2.0 * half)
    left = alpha * (1 - np.maximum(hidden, cover))
    return (
        np.clip(color, 0, 1).astype(np.float32),
        cover.astype(np.float32),
        left.astype(np.float32),
        {"start_widths": start / wrist, "wide": wide},
    )


def add_strap(
    rng: np.random.Generator, arm: Arm, along: np.ndarray, across: np.ndarray, rgb: np.ndarray
) -> dict[str, float]:
    """Now and then paint a watch or a bracelet around the arm into ``rgb``; the mask is unchanged."""
    if rng.random() >= STRAP_SHARE:
        return {}
    wrist = arm.width * arm.narrowing
    first = 0.5 if arm.narrowing < 0.98 else -0.2
    middle, broad = float(rng.uniform(first, first + 0.8)) * wrist, float(rng.uniform(0.06, 0.4)) * wrist
    edge = np.abs(along - middle - 0.1 * across * across / wrist)
    cover = np.clip((broad / 2 - edge) / 1.0 + 0.5, 0, 1) * (np.abs(across) < arm.width)
    round_off = np.sqrt(np.clip(1.05 - (across / (0.55 * wrist)) ** 2, 0.05, 1.0))
    paint = any_color(rng) * (0.5 + 0.6 * round_off)[..., None]
    if rng.random() < 0.5:  # a dial
        dial = np.hypot(along - middle, across - 0.1 * wrist) < 0.24 * wrist
        paint = np.where(dial[..., None], any_color(rng), paint)
        cover = np.maximum(cover, dial.astype(np.float32))
    rgb += (np.clip(paint, 0, 1) - rgb) * cover[..., None].astype(np.float32)
    return {"middle_widths": middle / wrist, "broad_widths": broad / wrist}


def add_rings(rng: np.random.Generator, rgb: np.ndarray, alpha: np.ndarray) -> int:
    """Now and then paint one to three rings across narrow parts of the hand; the mask is unchanged."""
    if rng.random() >= RING_SHARE:
        return 0
    depth = cv2.distanceTransform((alpha > 0.5).astype(np.uint8), cv2.DIST_L2, 5)
    ridge = (depth >= cv2.dilate(depth, np.ones((3, 3), np.uint8)) - 1e-3) & (depth > 0)
    ridge &= (depth > 0.04 * depth.max() + 2) & (depth < 0.45 * depth.max())
    ys, xs = np.nonzero(ridge)
    n_rings = min(int(rng.integers(1, 4)), xs.size)
    gold = cv2.cvtColor(np.array([[(rng.uniform(20, 55), rng.uniform(0, 0.7), 0.85)]], np.float32), cv2.COLOR_HSV2RGB)[
        0, 0
    ]
    for pick in rng.permutation(xs.size)[:n_rings]:
        x, y, radius = int(xs[pick]), int(ys[pick]), float(depth[ys[pick], xs[pick]])
        slope_x = float(depth[y, min(x + 2, depth.shape[1] - 1)] - depth[y, max(x - 2, 0)])
        slope_y = float(depth[min(y + 2, depth.shape[0] - 1), x] - depth[max(y - 2, 0), x])
        near = (np.abs(ys - y) <= radius) & (np.abs(xs - x) <= radius)
        if near.sum() > 2:  # the ridge's direction is the finger's; the ring runs across it
            offsets = np.stack([xs[near] - x, ys[near] - y])
            _, vectors = np.linalg.eigh(offsets @ offsets.T)
            slope_x, slope_y = float(vectors[0, 0]), float(vectors[1, 0])
        across = np.array([slope_x, slope_y]) / max(float(np.hypot(slope_x, slope_y)), 1e-6)
        start, end = (x, y) - 1.3 * radius * across, (x, y) + 1.3 * radius * across
        cover = np.zeros(alpha.shape, np.float32)
        thickness = max(1, round(float(rng.uniform(0.25, 0.6)) * radius))
        cv2.line(
            cover,
            tuple(np.rint(start).astype(int).tolist()),
            tuple(np.rint(end).astype(int).tolist()),
            1.0,
            thickness,
            cv2.LINE_AA,
        )
        shine = 0.7 + 0.5 * rng.random()
        rgb += (np.clip(gold * shine, 0, 1) - rgb) * cover[..., None]
    return n_rings
