"""Solids, lines and discs in space on one canvas, drawn from the back to the front: matplotlib sorts no further."""

import dataclasses
import math

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from matplotlib.colors import to_rgba
from numpy.typing import ArrayLike, NDArray

__all__ = ["Painter", "View"]

Array = NDArray[np.float64]


@dataclasses.dataclass(frozen=True)
class View:
    """From where one looks: at ``center_m``, from ``distance_m`` away, by azimuth and elevation."""

    center_m: Array
    distance_m: float
    azimuth_rad: float = math.radians(-60)
    elevation_rad: float = math.radians(32)

    def project(self, points_m: ArrayLike) -> Array:
        """(..., 3) points in the world to (..., 3): right, up, and nearness to the eye."""
        points = np.asarray(points_m, dtype=np.float64) - self.center_m
        a, e = self.azimuth_rad, self.elevation_rad
        toward = np.array([math.cos(e) * math.cos(a), math.cos(e) * math.sin(a), math.sin(e)])
        right = np.array([-math.sin(a), math.cos(a), 0.0])
        seen = points @ np.stack([right, np.cross(toward, right), toward], axis=1)
        seen[..., :2] *= (self.distance_m / (self.distance_m - seen[..., 2]))[..., None]
        return np.asarray(seen)


class Painter:
    """Collects what is to be seen, then draws all of it into axes, the farthest first."""

    def __init__(self, view: View) -> None:
        self.view = view
        self._shapes: list[Array] = []
        self._depths: list[Array] = []
        self._colors: list[Array] = []

    def polygons(self, corners_m: Array, colors: ArrayLike, nearer_m: float = 0.0) -> None:
        """Polygons (n, m, 3) with colors (4,) or (n, 4), sorted as if nearer to the eye by ``nearer_m``."""
        if not len(corners_m):
            return
        seen = self.view.project(corners_m)
        self._shapes.extend(seen[..., :2])
        self._depths.append(seen[..., 2].mean(axis=1) + nearer_m)
        self._colors.append(np.broadcast_to(np.asarray(colors, dtype=np.float64), (len(corners_m), 4)))

    def lines(self, segments_m: Array, colors: ArrayLike, width_m: float, nearer_m: float = 0.0) -> None:
        """Straight lines (n, 2, 3) as ribbons that face the eye, cut so short that sorting them is right."""
        if not len(segments_m):
            return
        color = np.broadcast_to(np.asarray(colors, dtype=np.float64), (len(segments_m), 4))
        length_m = np.linalg.norm(segments_m[:, 1] - segments_m[:, 0], axis=1)
        count = np.maximum(1, np.ceil(length_m / 0.02)).astype(int)
        which = np.repeat(np.arange(len(segments_m)), count)
        part = np.arange(len(which)) - np.repeat(np.cumsum(count) - count, count)
        start, way = segments_m[which, 0], (segments_m[which, 1] - segments_m[which, 0])
        ends = np.stack(
            [start + (part / count[which])[:, None] * way, start + ((part + 1) / count[which])[:, None] * way], axis=1
        )
        seen = self.view.project(ends)
        along = seen[:, 1, :2] - seen[:, 0, :2]
        along /= np.maximum(np.linalg.norm(along, axis=1, keepdims=True), 1e-12)
        scale = self.view.distance_m / (self.view.distance_m - seen[:, :1, 2])
        side = np.stack([-along[:, 1], along[:, 0]], axis=1) * width_m / 2 * scale
        reach = along * width_m / 2 * scale * 0.5  # ribbons of one line overlap at their ends
        a, b = seen[:, 0, :2] - reach, seen[:, 1, :2] + reach
        self._shapes.extend(np.stack([a - side, b - side, b + side, a + side], axis=1))
        self._depths.append(seen[..., 2].mean(axis=1) + nearer_m)
        self._colors.append(color[which])

    def draw(self, ax: Axes) -> None:
        """Fill all shapes, the farthest first; the axes get equal scales and no frame."""
        order = np.argsort(np.concatenate(self._depths), kind="stable")
        colors = np.concatenate(self._colors)[order]
        shapes = [self._shapes[n] for n in order]
        # a hairline of the same color closes the gaps that smoothing of edges leaves between neighbors
        edges = np.where(colors[:, 3:] >= 1, colors, 0.0)
        ax.add_collection(PolyCollection(shapes, facecolors=colors, edgecolors=edges, linewidths=0.35))
        ax.set_aspect("equal")
        ax.autoscale_view()
        ax.set_axis_off()


def shaded(normals: Array, color: str, view: View) -> Array:
    """(n, 4) colors of faces with outward ``normals`` (n, 3): light from above, behind the left shoulder."""
    a = view.azimuth_rad - math.radians(40)
    light = np.array([0.55 * math.cos(a), 0.55 * math.sin(a), 0.84])
    lambert = np.clip(normals @ light, 0.0, 1.0)
    base = np.array(to_rgba(color))
    shade = (0.42 + 0.58 * lambert)[:, None]
    rgb = np.clip(base[:3] * shade + 0.16 * np.clip(lambert - 0.55, 0, 1)[:, None], 0.0, 1.0)
    return np.column_stack([rgb, np.ones(len(rgb))])
