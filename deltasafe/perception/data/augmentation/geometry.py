"""The four geometric methods: each says where a point of the new picture comes from.

A warp maps points of the new canvas to points of the old one. The warps of one image are chained and the hand
is sampled once, as a cut-out: no border is reflected into ghost hands, and nothing is blurred by repeated
interpolation. The background is put in afterwards and needs no warp, being drawn at random itself.
albumentations fills what comes from outside a picture; here points outside are wanted: the arm goes on there.
"""

from collections.abc import Callable

import cv2
import numpy as np

__all__ = ["Warp", "cropping", "flip", "grid_distortion", "rotation"]

Warp = Callable[[np.ndarray], np.ndarray]
Drawn = tuple[Warp, np.ndarray, dict[str, float | int | str]]

SCALES = (0.45, 1.4)
GRID_CELLS = (3, 6)
GRID_SHIFT = 0.24


def flip(rng: np.random.Generator, size: tuple[int, int], center: np.ndarray) -> Drawn:
    """Mirror left-right, top-bottom, or both, equally likely.

    Args:
        rng: source of the draw.
        size: width and height of the canvas in pixels.
        center: ``(2,)`` middle of the hand on the canvas.

    Returns:
        The warp, the hand's new middle, and the drawn parameters (as for all methods of this module).
    """
    axes = ("horizontal", "vertical", "both")[int(rng.integers(3))]
    sign = np.array([-1.0 if axes != "vertical" else 1.0, -1.0 if axes != "horizontal" else 1.0], np.float32)
    middle = np.array([(size[0] - 1) / 2, (size[1] - 1) / 2], np.float32)

    def warp(points: np.ndarray) -> np.ndarray:
        return (points - middle) * sign + middle

    return warp, warp(center), {"axes": axes}


def rotation(rng: np.random.Generator, size: tuple[int, int], center: np.ndarray) -> Drawn:
    """Turn by any angle about the middle of the hand, so that it stays in the picture."""
    angle_rad = float(rng.uniform(-np.pi, np.pi))
    cos, sin = np.cos(angle_rad), np.sin(angle_rad)
    matrix = np.array([[cos, -sin], [sin, cos]], np.float32)
    pivot = np.asarray(center, np.float32)

    def warp(points: np.ndarray) -> np.ndarray:
        return (points - pivot) @ matrix.T + pivot

    return warp, center, {"angle_rad": angle_rad}


def grid_distortion(rng: np.random.Generator, size: tuple[int, int], center: np.ndarray) -> Drawn:
    """Shift the nodes of a grid of 3 to 6 cells a side by up to 0.24 of a cell, smoothly in between."""
    n_cells = int(rng.integers(GRID_CELLS[0], GRID_CELLS[1] + 1))
    cell = np.array([size[0] / n_cells, size[1] / n_cells], np.float32)
    shifts = rng.uniform(-GRID_SHIFT, GRID_SHIFT, (n_cells + 1, n_cells + 1, 2)).astype(np.float32) * cell
    field = cv2.resize(shifts, size, interpolation=cv2.INTER_CUBIC)

    def warp(points: np.ndarray) -> np.ndarray:
        x, y = np.ascontiguousarray(points[..., 0]), np.ascontiguousarray(points[..., 1])
        return points + cv2.remap(field, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)

    return warp, center, {"n_cells": n_cells, "largest_shift_px": float(np.abs(shifts).max())}


def cropping(rng: np.random.Generator, size: tuple[int, int], center: np.ndarray) -> Drawn:
    """Another section of the scene: hand 0.45 to 1.4 times as large (log-uniform), near the middle."""
    scale = float(np.exp(rng.uniform(*np.log(SCALES))))
    moved = rng.uniform(0.25, 0.75, 2) * size

    def warp(points: np.ndarray) -> np.ndarray:
        return ((points - moved.astype(np.float32)) / np.float32(scale) + center).astype(np.float32)

    return warp, moved, {"scale": scale, "x": float(moved[0] / size[0]), "y": float(moved[1] / size[1])}
