"""What the compared methods are told of a hand: ellipsoids at Gaussian positions, fitted to the same picture.

They cannot be told more: they have no place for an arbitrary field. The rule is this.

1. The hand is where p_occupied >= 0.5. Its pixels are parted into n pieces by k-means of where they meet the table.
2. A piece stands from the table to the height of the hand, along the camera's rays. An ellipse with the axes of its
   covariance contains all that it covers at both heights; the upright elliptic cylinder above it is enclosed by the
   least ellipsoid: its horizontal axes times the root of 3/2, its half height times the root of 3.
3. Around a piece, p_occupied falls from 0.5 to 0.05 over a mean distance d (the area of that band by the length of the
   hand's border there). As everywhere in this project (decision 21) "95 %" is set equal to 2 sigma: sigma = d / 2.

Where the picture shows less than 0.5 everywhere, there is nothing to fit, however suspicious it looks.
"""

import math

import numpy as np
from numpy.typing import NDArray
from scipy.cluster.vq import kmeans2
from scipy.spatial import cKDTree

from deltasafe.scene import Camera
from deltasafe.studies.baselines import GaussianObstacle
from deltasafe.studies.baselines.obstacles import isotropic_covariance

__all__ = ["LEAST_SIGMA_M", "fit_obstacles"]

Array = NDArray[np.float64]
LEAST_SIGMA_M = 0.001
"""Sharper borders than this no camera has: 1.5 pixels half a meter above the table."""

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
    """At most ``n_obstacles`` ellipsoids for a picture (H, W) of p_occupied; none where nothing reaches 0.5.

    Args:
        hand_height_m: above the table.
        seed: of the first centers of k-means.
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
    """Pixel coordinates (N, 2) as (u, v) of the middles of every ``stride``-th pixel of a mask."""
    rows, columns = np.nonzero(mask[::stride, ::stride])
    return np.column_stack([columns * stride + 0.5, rows * stride + 0.5])


def _ellipse(points_m: Array) -> tuple[Array, Array, float]:
    """Center, semi-axes and yaw of the ellipse with the points' (N, 2) own axes that just contains them."""
    middle = points_m.mean(axis=0)
    values, vectors = np.linalg.eigh(np.cov((points_m - middle).T) + 1e-8 * np.eye(2))
    farthest = float(np.sqrt((((points_m - middle) @ vectors) ** 2 / values).sum(axis=1).max()))
    return middle, farthest * np.sqrt(values), math.atan2(vectors[1, 0], vectors[0, 0])


def _sigmas(
    p_occupied: NDArray[np.float32], hand: NDArray[np.bool_], camera: Camera, table_z_m: float, centers: Array
) -> Array:
    """(n,) d / 2 for each piece: area of the band around it by the length of the hand's border there."""
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
    return np.maximum(counts[0] / np.maximum(counts[1], 1) * pixel_m / 2, LEAST_SIGMA_M)
