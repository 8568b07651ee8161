"""Obstacles of the compared methods: ellipsoids at Gaussian positions, fitted to the predicted p_occupied.

These methods cannot use an arbitrary field, so the hand is approximated by a fixed rule:

1. The hand is the set of pixels with p_occupied >= 0.5. K-means of their positions on the table gives n pieces.
2. A piece extends along the camera's rays from the table to the height of the hand. An ellipse with the axes of its
   covariance contains its cross sections at both heights. The smallest ellipsoid around the upright elliptic cylinder
   over this ellipse has its horizontal axes times sqrt(3/2) and half its height times sqrt(3).
3. Around a piece, p_occupied falls from 0.5 to 0.05 over a mean distance d: the area of that band divided by the length
   of the hand's border there. "95 %" equals 2 sigma (decision 21), so that sigma = d / 2.

If p_occupied is below 0.5 everywhere, no obstacle is fitted.
"""

import math

import numpy as np
from numpy.typing import NDArray
from scipy.cluster.vq import kmeans2
from scipy.spatial import cKDTree

from deltasafe.scene import Camera
from deltasafe.studies.baselines import GaussianObstacle
from deltasafe.studies.baselines.obstacles import isotropic_covariance

Array = NDArray[np.float64]
MIN_SIGMA_M = 0.001
"""Lower limit of sigma, the resolution of the camera: 1.5 pixels, half a meter above the table."""

INSIDE, BORDER = 0.5, 0.05
STRIDE = 2


def fit_obstacles(
    p_occupied: NDArray[np.float32],
    camera: Camera,
    table_z_m: float,
    hand_height_m: float,
    n_obstacles: int,
    seed: int,
) -> list[GaussianObstacle]:
    """Fit at most ``n_obstacles`` ellipsoids to an image (H, W) of p_occupied.

    Args:
        hand_height_m: height of the hand above the table.
        seed: seed of the initial centers of k-means.
    """
    hand = p_occupied >= INSIDE
    if not hand.any():
        return []
    pixels = _centers(hand, STRIDE) if hand.sum() > 16 * STRIDE**2 * n_obstacles else _centers(hand, 1)
    top_z_m = table_z_m + hand_height_m
    low, high = (camera.pixel_to_plane(pixels, z_m)[:, :2] for z_m in (table_z_m, top_z_m))
    n_pieces = min(n_obstacles, len(low))
    centers, piece = kmeans2(low, n_pieces, minit="++", seed=np.random.default_rng(seed))
    sigmas_m = _sigmas(p_occupied, hand, camera, table_z_m, centers)
    obstacles = []
    for n in range(n_pieces):
        covered = np.concatenate([low[piece == n], high[piece == n]])
        if len(covered) < 6:
            continue
        middle, axes, yaw_rad = _ellipse(covered)
        mean = (float(middle[0]), float(middle[1]), table_z_m + hand_height_m / 2)
        a, b = (float(axis) * math.sqrt(1.5) for axis in axes)
        semi_axes = (a, b, hand_height_m / 2 * math.sqrt(3))
        obstacles.append(GaussianObstacle(mean, semi_axes, isotropic_covariance(float(sigmas_m[n])), yaw_rad))
    return obstacles


def _centers(mask: NDArray[np.bool_], stride: int) -> Array:
    """Return the centers (N, 2) of every ``stride``-th pixel of a mask, as (u, v)."""
    rows, columns = np.nonzero(mask[::stride, ::stride])
    return np.column_stack([columns * stride + 0.5, rows * stride + 0.5])


def _ellipse(points_m: Array) -> tuple[Array, Array, float]:
    """Return center, semi-axes and yaw of the smallest ellipse around points (N, 2) with their principal axes."""
    middle = points_m.mean(axis=0)
    values, vectors = np.linalg.eigh(np.cov((points_m - middle).T) + 1e-8 * np.eye(2))
    farthest = float(np.sqrt((((points_m - middle) @ vectors) ** 2 / values).sum(axis=1).max()))
    return middle, farthest * np.sqrt(values), math.atan2(vectors[1, 0], vectors[0, 0])


def _sigmas(
    p_occupied: NDArray[np.float32], hand: NDArray[np.bool_], camera: Camera, table_z_m: float, centers: Array
) -> Array:
    """Return sigma = d / 2 (n,) of each piece: half the area of the band around it over the length of its border."""
    import cv2

    inner = cv2.erode(hand.astype(np.uint8), np.ones((3, 3), np.uint8), borderValue=1).astype(bool)
    nearest = cKDTree(centers)
    counts = [
        np.bincount(
            nearest.query(camera.pixel_to_plane(_centers(mask, 1), table_z_m)[:, :2])[1], minlength=len(centers)
        )
        for mask in (~hand & (p_occupied > BORDER), hand & ~inner)
    ]
    pixel_m = (camera.position_m[2] - table_z_m) / camera.fx
    return np.maximum(counts[0] / np.maximum(counts[1], 1) * pixel_m / 2, MIN_SIGMA_M)
