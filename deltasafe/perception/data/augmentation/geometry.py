"""The four geometric methods, as warps: maps from points of the new image to points of the old one.

The warps of one image are composed and the hand is sampled once. Repeated interpolation would blur it. The background
is drawn separately and is not warped. albumentations is not used here: it fills points outside the image, for example
by reflection, which makes a second hand. Here these points are kept, because the arm is continued there.
"""

import functools
from collections.abc import Callable
from typing import TypeAlias

import cv2
import numpy as np

Warp: TypeAlias = Callable[[np.ndarray], np.ndarray]
WarpDraw: TypeAlias = tuple[Warp, np.ndarray, dict[str, float | int | str]]
"""The warp, the new center of the hand, and the drawn parameters."""

SCALES = (0.45, 2.4)
"""Up to a hand that is larger than the image (decision 90)."""

GRID_CELLS = (3, 6)
GRID_SHIFT_CELLS = 0.24


def flip(rng: np.random.Generator, size: tuple[int, int], center: np.ndarray) -> WarpDraw:
    """Mirror left-right, top-bottom, or both, with equal probability.

    Args:
        rng: source of the draws.
        size: width and height of the canvas in pixels.
        center: ``(2,)`` center of the hand on the canvas.
    """
    axes = ("horizontal", "vertical", "both")[int(rng.integers(3))]
    sign = np.array([-1.0 if axes != "vertical" else 1.0, -1.0 if axes != "horizontal" else 1.0], np.float32)
    middle = np.array([(size[0] - 1) / 2, (size[1] - 1) / 2], np.float32)

    def warp(points: np.ndarray) -> np.ndarray:
        return (points - middle) * sign + middle

    return warp, warp(center), {"axes": axes}


def rotation(rng: np.random.Generator, size: tuple[int, int], center: np.ndarray) -> WarpDraw:
    """Rotate by any angle about the center of the hand, so that the hand stays in the image."""
    angle_rad = float(rng.uniform(-np.pi, np.pi))
    cos, sin = np.cos(angle_rad), np.sin(angle_rad)
    matrix = np.array([[cos, -sin], [sin, cos]], np.float32)
    pivot = np.asarray(center, np.float32)

    def warp(points: np.ndarray) -> np.ndarray:
        return (points - pivot) @ matrix.T + pivot

    return warp, center, {"angle_rad": angle_rad}


def grid_distortion(rng: np.random.Generator, size: tuple[int, int], center: np.ndarray) -> WarpDraw:
    """Shift the nodes of a grid of 3 to 6 cells per side by up to 0.24 of a cell, with bicubic interpolation."""
    n_cells = int(rng.integers(GRID_CELLS[0], GRID_CELLS[1] + 1))
    cell_px = np.array([size[0] / n_cells, size[1] / n_cells], np.float32)
    shifts = rng.uniform(-GRID_SHIFT_CELLS, GRID_SHIFT_CELLS, (n_cells + 1, n_cells + 1, 2)).astype(np.float32)
    shifts *= cell_px
    field = cv2.resize(shifts, size, interpolation=cv2.INTER_CUBIC)

    def warp(points: np.ndarray) -> np.ndarray:
        return points + sample(field, points, cv2.BORDER_REPLICATE)

    return warp, center, {"n_cells": n_cells, "largest_shift_px": float(np.abs(shifts).max())}


def draw_scale(rng: np.random.Generator) -> float:
    """Draw the scale of `cropping`: 0.45 to 2.4, log-uniform."""
    return float(np.exp(rng.uniform(*np.log(SCALES))))


def cropping(scale: float, rng: np.random.Generator, size: tuple[int, int], center: np.ndarray) -> WarpDraw:
    """Scale the hand and move ``center`` to a place near the middle of the image."""
    moved = rng.uniform(0.25, 0.75, 2) * size

    def warp(points: np.ndarray) -> np.ndarray:
        return ((points - moved.astype(np.float32)) / np.float32(scale) + center).astype(np.float32)

    return warp, moved, {"scale": scale, "x": float(moved[0] / size[0]), "y": float(moved[1] / size[1])}


def sample(image: np.ndarray, points: np.ndarray, border: int) -> np.ndarray:
    """Sample an image at points ``(H, W, 2)`` float32 by bilinear interpolation; a constant ``border`` is 0."""
    x, y = np.ascontiguousarray(points[..., 0]), np.ascontiguousarray(points[..., 1])
    return cv2.remap(image, x, y, cv2.INTER_LINEAR, borderMode=border)


def warps_of(scale: float) -> dict[str, Callable[[np.random.Generator, tuple[int, int], np.ndarray], WarpDraw]]:
    """Return the draws of the four methods by name, in order of application; ``scale`` is that of `cropping`."""
    return {
        "flip": flip,
        "rotation": rotation,
        "grid_distortion": grid_distortion,
        "cropping": functools.partial(cropping, scale),
    }
