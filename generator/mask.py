"""The true mask from exact coverage, and the outline that a mesh should have in the picture: one checks the other."""

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw

from deltasafe.scene import Camera

__all__ = ["iou", "mask_of", "silhouette"]

HALF = 0.5
OVERSAMPLING = 4  # Pillow fills a little beyond the edge


def mask_of(coverage: NDArray[np.float64]) -> NDArray[np.uint8]:
    """(H, W) 255 where at least half of a pixel shows hand, else 0."""
    return np.where(coverage >= HALF, 255, 0).astype(np.uint8)


def silhouette(camera: Camera, vertices_m: NDArray[np.float32], triangles: NDArray[np.int32]) -> NDArray[np.bool_]:
    """Pixels (H, W) that triangles (F, 3) of vertices (V, 3) cover in the picture; none if behind the camera."""
    uv, depth_m = camera.project(np.asarray(vertices_m, dtype=float))
    canvas = Image.new("1", (camera.width * OVERSAMPLING, camera.height * OVERSAMPLING))
    draw = ImageDraw.Draw(canvas)
    corners = uv * OVERSAMPLING - 0.5  # Pillow's coordinates are those of pixel centres
    for a, b, c in triangles[(depth_m[triangles] > 0).all(axis=1)].tolist():
        draw.polygon([tuple(corners[a]), tuple(corners[b]), tuple(corners[c])], fill=1)
    fine = np.array(canvas, dtype=float).reshape(camera.height, OVERSAMPLING, camera.width, OVERSAMPLING)
    return np.asarray(fine.mean(axis=(1, 3)) >= HALF)


def iou(one: NDArray[np.bool_], other: NDArray[np.bool_]) -> float:
    """Intersection over union of two masks (H, W); 1 if both are empty."""
    union = np.logical_or(one, other).sum()
    return float(np.logical_and(one, other).sum() / union) if union else 1.0
