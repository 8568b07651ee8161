"""Balls that cover the tool's disc: many of one size for a tight bound, a few of several sizes for a quick one.

Both are cached by the dimensions of the disc, since each plan creates a body of its own.
"""

import functools
import math

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

Array = NDArray[np.float64]

GRID = 300
"""The disc is measured on a grid of at most about 2 GRID by 2 GRID points, however slender or large it is."""

MAX_BALLS = 65


@functools.lru_cache(maxsize=256)
def disc_cover(semi_axis_x_m: float, semi_axis_y_m: float, thickness_m: float) -> tuple[Array, float]:
    """Cover the disc with balls of equal size: centers (n, 3) in the body's frame, and radius.

    The centers form layers, each with a ring along the rim and a hexagonal lattice inside. The radius is the largest
    distance of a point of the disc to its nearest center, measured on a grid and enlarged by the grid's resolution.
    """
    a, b = semi_axis_x_m, semi_axis_y_m
    layers = max(1, math.ceil(thickness_m / max(0.005, math.sqrt(a * b) / 30) - 1e-9))
    half_layer = thickness_m / (2 * layers)
    size = math.sqrt(a * b)
    inset = max(min(0.003, 0.4 * min(a, b) ** 2 / max(a, b)), 0.1 * min(a, b), size / 30)  # bounds the number of balls
    flat = _inset_ellipse(a, b, inset, 1.2 * inset)
    pitch = 1.5 * inset
    x, y = np.meshgrid(np.arange(-a, a + pitch, pitch), np.arange(-b, b + pitch, pitch * math.sqrt(3) / 2))
    x = x + np.where(np.arange(len(x)) % 2, pitch / 2, 0.0)[:, None]
    inner = np.column_stack([x.ravel(), y.ravel()])
    inner_a, inner_b = a - inset - 0.5 * pitch, b - inset - 0.5 * pitch
    if min(inner_a, inner_b) > 0:
        inner = inner[(inner[:, 0] / inner_a) ** 2 + (inner[:, 1] / inner_b) ** 2 <= 1]
        flat = np.concatenate([flat, inner])
    step = max(inset / 20, size / GRID)
    radius = cKDTree(flat).query(_grid_on_ellipse(a, b, step, step))[0].max() + step / math.sqrt(2)
    heights = (np.arange(layers) * 2 + 1 - layers) * half_layer
    centers = np.concatenate([np.column_stack([flat, np.full(len(flat), height)]) for height in heights])
    # outermost first: these balls are the most likely to be unsafe
    centers = centers[np.argsort(-np.hypot(centers[:, 0], centers[:, 1]), kind="stable")]
    centers.setflags(write=False)
    return centers, math.hypot(radius, half_layer)


@functools.lru_cache(maxsize=256)
def bounding_balls(semi_axis_x_m: float, semi_axis_y_m: float, thickness_m: float) -> Array:
    """Cover the disc with a few balls, tight in its plane: (m, 4) centers in the body's frame, and radii.

    Centers lie on the medial axis of the ellipse, the segment between the centers of curvature of its tips. Each
    point of the disc is assigned to the ball that it protrudes from least; a ball reaches its farthest point, measured
    on a grid as in ``disc_cover``.
    """
    major, minor = max(semi_axis_x_m, semi_axis_y_m), min(semi_axis_x_m, semi_axis_y_m)
    half = major - minor**2 / major
    count = 1 if half < 1e-6 else min(2 * math.ceil(2.5 * half / minor) + 1, MAX_BALLS)
    along = half * np.sin(np.linspace(-math.pi / 2, math.pi / 2, count)) if count > 1 else np.zeros(1)
    inscribed = minor * np.sqrt(np.clip(1 - along**2 / max(major**2 - minor**2, 1e-12), 0, 1))
    step = max(minor / 100, math.sqrt(major * minor) / GRID)
    disc = _grid_on_ellipse(major, minor, 0.0, step)
    distance = np.hypot(disc[:, :1] - along, disc[:, 1:])
    owner = (distance - inscribed).argmin(axis=1)
    radius = np.array([distance[owner == n, n].max(initial=minor**2 / major) for n in range(count)])
    radius = np.hypot(radius + step / math.sqrt(2), thickness_m / 2)
    flat = np.column_stack([along, np.zeros(count)])
    if semi_axis_y_m > semi_axis_x_m:
        flat = flat[:, ::-1]
    balls = np.column_stack([flat, np.zeros(count), radius])
    balls.setflags(write=False)
    return balls


def distance_to_ellipse(points_m: Array, a_m: float, b_m: float) -> Array:
    """Distance (N,) of points (N, 2) to the ellipse with semi-axes a, b along x, y; 0 inside.

    The nearest point is (a^2 x / (t + a^2), b^2 y / (t + b^2)), where t >= 0 is the root of a decreasing function,
    found by bisection.
    """
    x, y = np.abs(np.asarray(points_m, dtype=np.float64)).T
    distance_m = np.zeros(len(x))
    outside = (x / a_m) ** 2 + (y / b_m) ** 2 > 1
    x, y = x[outside], y[outside]
    low, high = np.zeros(len(x)), np.hypot(a_m * x, b_m * y)
    for _ in range(60):
        middle = (low + high) / 2
        beyond = (a_m * x / (middle + a_m**2)) ** 2 + (b_m * y / (middle + b_m**2)) ** 2 > 1
        low, high = np.where(beyond, middle, low), np.where(beyond, high, middle)
    distance_m[outside] = np.hypot(x * high / (high + a_m**2), y * high / (high + b_m**2))
    return distance_m


def _grid_on_ellipse(a_m: float, b_m: float, padding_m: float, step_m: float) -> Array:
    """Points (N, 2) of a square grid that lie on the ellipse, or at most one step beside it."""
    x, y = np.meshgrid(
        np.arange(-a_m - padding_m, a_m + step_m, step_m), np.arange(-b_m - padding_m, b_m + step_m, step_m)
    )
    points = np.column_stack([x.ravel(), y.ravel()])
    return points[distance_to_ellipse(points, a_m, b_m) <= step_m]


def _inset_ellipse(a_m: float, b_m: float, inset_m: float, spacing_m: float) -> Array:
    """Points (N, 2) on the inner parallel curve of an ellipse, ``spacing_m`` apart."""
    angle = np.linspace(0, 2 * math.pi, 4000, endpoint=False)
    normal = np.column_stack([np.cos(angle) / a_m, np.sin(angle) / b_m])
    normal /= np.linalg.norm(normal, axis=1)[:, None]
    curve = np.column_stack([a_m * np.cos(angle), b_m * np.sin(angle)]) - inset_m * normal
    steps = np.linalg.norm(np.diff(curve, axis=0, append=curve[:1]), axis=1)
    arc_length = np.concatenate([[0.0], np.cumsum(steps)[:-1]])
    count = math.ceil(steps.sum() / spacing_m)
    return np.asarray(curve[np.searchsorted(arc_length, steps.sum() * np.arange(count) / count)])
