"""A polyline made smooth: parabolas in its corners, so that the direction never jumps (decision 24)."""

import dataclasses
import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicHermiteSpline

__all__ = ["SmoothPath", "blend_corners"]

Array = NDArray[np.float64]


@dataclasses.dataclass(frozen=True)
class SmoothPath:
    """A path of poses over its length l, where dl^2 = |dx|^2 + r dphi^2; C1 but for its ``stops``.

    Attributes:
        length: (N,) increasing, from 0.
        poses: (N, 4) at these places; neighbors are close (``spacing``).
        before, after: (N, 4) derivatives by l on either side; they differ at stops alone.
        bend: (N - 1,) largest |d2 pose / dl2| in each cell, in the same metric.
        stops: indices of the places where the motion must come to rest: both ends, corners that cannot be blended.
    """

    length: Array
    poses: Array
    before: Array
    after: Array
    bend: Array
    stops: tuple[int, ...]

    def at(self, length: Array) -> tuple[Array, Array]:
        """Poses (M, 4) and their derivatives by l (M, 4) at lengths (M,)."""
        poses, slopes = np.empty((len(length), 4)), np.empty((len(length), 4))
        which = np.clip(
            np.searchsorted(self.stops, np.searchsorted(self.length, length, "right") - 1, "right") - 1,
            0,
            len(self.stops) - 2,
        )
        for part, (first, last) in enumerate(zip(self.stops[:-1], self.stops[1:], strict=True)):
            chosen = which == part
            if not chosen.any():
                continue
            slope = self.after[first : last + 1].copy()
            slope[-1] = self.before[last]
            spline = CubicHermiteSpline(self.length[first : last + 1], self.poses[first : last + 1], slope)
            poses[chosen], slopes[chosen] = spline(length[chosen]), spline(length[chosen], 1)
        return poses, slopes


def blend_corners(
    poses: Array,
    rotation_weight_m2: float,
    reach_m: float,
    spacing_m: float,
    is_safe: Callable[[Array], bool],
    tolerance_m: float,
    least_reach_m: float = 0.0002,
) -> SmoothPath:
    """Replace each corner of a polyline (K, 4) by a parabola from ``reach_m`` before it to as much after it.

    A parabola that ``is_safe`` refuses (it is given poses (M, 4) along it), or that leaves the chords between
    these poses by more than ``tolerance_m``, is halved until it is accepted; below ``least_reach_m`` the corner
    stays and becomes a stop.
    """
    scale = np.array([1.0, 1.0, 1.0, math.sqrt(rotation_weight_m2)])
    points = _without_repeats(poses * scale)
    legs = np.linalg.norm(np.diff(points, axis=0), axis=1)
    reaches = [0.0]
    for n in range(1, len(points) - 1):
        back, ahead = points[n - 1] - points[n], points[n + 1] - points[n]
        back, ahead = back / legs[n - 1], ahead / legs[n]
        reach = min(reach_m, legs[n - 1] / 2, legs[n] / 2)
        if back @ ahead > 1 - 1e-6:  # it turns back on itself
            reach = 0.0
        while reach >= least_reach_m:
            arc, _, bend = _parabola(points[n] + reach * back, points[n], points[n] + reach * ahead, spacing_m)
            chord = np.linalg.norm(np.diff(arc, axis=0), axis=1)
            if (np.maximum(bend[1:], bend[:-1]) * chord**2 / 8).max() <= tolerance_m and is_safe(arc / scale):
                break
            reach /= 2
        reaches.append(reach if reach >= least_reach_m else 0.0)
    reaches.append(0.0)
    return _assemble(points, legs, reaches, spacing_m, scale)


def _assemble(points: Array, legs: Array, reaches: list[float], spacing_m: float, scale: Array) -> SmoothPath:
    placed, slopes, bends, stops = [points[:1]], [], [], [0]
    here = points[0]
    count = 1
    for n in range(1, len(points)):
        direction = (points[n] - points[n - 1]) / legs[n - 1]
        end = points[n] - reaches[n] * direction
        gap = float(np.linalg.norm(end - here))
        if gap > 1e-12:
            cells = max(2, math.ceil(gap / spacing_m))  # between two stops there must be room to move
            placed.append(here + np.arange(1, cells + 1)[:, None] / cells * (end - here))
            slopes.append(np.repeat(direction[None, None], cells, 0).repeat(2, 1))
            bends.append(np.zeros(cells))
            count += cells
        here = end
        if n == len(points) - 1 or reaches[n] == 0.0:
            stops.append(count - 1)
            continue
        ahead = (points[n + 1] - points[n]) / legs[n]
        arc, tangent, bend = _parabola(end, points[n], points[n] + reaches[n] * ahead, spacing_m)
        placed.append(arc[1:])
        slopes.append(np.stack([tangent[:-1], tangent[1:]], axis=1))
        bends.append(np.maximum(bend[:-1], bend[1:]))
        count += len(arc) - 1
        here = arc[-1]
    path, slope, bend = np.concatenate(placed), np.concatenate(slopes), np.concatenate(bends)
    cells_m = np.linalg.norm(np.diff(path, axis=0), axis=1)
    # the chord of a cell is shorter than the curve by a factor 1 - (bend * chord)^2 / 24
    cells_m *= 1 + (bend * cells_m) ** 2 / 24
    return SmoothPath(
        length=np.concatenate([[0.0], np.cumsum(cells_m)]),
        poses=path / scale,
        before=np.concatenate([slope[:1, 0], slope[:, 1]]) / scale,
        after=np.concatenate([slope[:, 0], slope[-1:, 1]]) / scale,
        bend=bend,
        stops=tuple(stops),
    )


def _parabola(a: Array, corner: Array, b: Array, spacing_m: float) -> tuple[Array, Array, Array]:
    """Points (M, 4), unit tangents (M, 4) and curvatures (M,) of the quadratic Bezier curve."""
    cells = max(8, math.ceil(float(np.linalg.norm(corner - a) + np.linalg.norm(b - corner)) / spacing_m))
    t = np.linspace(0.0, 1.0, cells + 1)[:, None]
    points = (1 - t) ** 2 * a + 2 * t * (1 - t) * corner + t**2 * b
    first = 2 * (1 - t) * (corner - a) + 2 * t * (b - corner)
    second = 2 * (a - 2 * corner + b)
    speed = np.linalg.norm(first, axis=1)
    tangent = first / speed[:, None]
    normal = second - (tangent @ second)[:, None] * tangent
    # the middle of a symmetric parabola bends most; a cell's ends bound its inside to second order
    return points, tangent, np.linalg.norm(normal, axis=1) / speed**2


def _without_repeats(points: Array) -> Array:
    keep = np.append(True, np.linalg.norm(np.diff(points, axis=0), axis=1) > 1e-9)
    kept = points[keep]
    if len(kept) > 1:
        kept[-1] = points[-1]
    return kept
