"""Independent checks of meshes and masks that several tests use."""

import numpy as np
from PIL import Image, ImageDraw

OVERSAMPLING = 4  # Pillow fills slightly beyond the edge of a polygon


def volume(vertices, triangles):
    """By the divergence theorem; positive if the normals point outwards."""
    a, b, c = (vertices[triangles[:, i]] for i in range(3))
    return float((a * np.cross(b, c)).sum() / 6)


def is_watertight(triangles):
    edges = {tuple(edge) for t in triangles.tolist() for edge in zip(t, t[1:] + t[:1], strict=True)}
    return len(edges) == 3 * len(triangles) and all((b, a) in edges for a, b in edges)


def silhouette(camera, vertices_m, triangles):
    """Mask (H, W) of the triangles (F, 3) in front of the camera, by 2D rasterization."""
    uv, depth_m = camera.project(np.asarray(vertices_m, dtype=float))
    canvas = Image.new("1", (camera.width * OVERSAMPLING, camera.height * OVERSAMPLING))
    draw = ImageDraw.Draw(canvas)
    corners = uv * OVERSAMPLING - 0.5  # Pillow puts integer coordinates at pixel centers
    for triangle in triangles[(depth_m[triangles] > 0).all(axis=1)]:
        draw.polygon([tuple(corner) for corner in corners[triangle]], fill=1)
    fine = np.array(canvas, dtype=float).reshape(camera.height, OVERSAMPLING, camera.width, OVERSAMPLING)
    return fine.mean(axis=(1, 3)) >= 0.5


def iou(a, b):
    return (a & b).sum() / (a | b).sum()
