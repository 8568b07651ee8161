"""Blending of polylines: a parabola in each corner, so that the direction is continuous (decision 24)."""

import dataclasses
import itertools
import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicHermiteSpline

Array = NDArray[np.float64]

MIN_TURN = 1e-6
"""Corners whose legs enclose a smaller angle, measured by 1 - cosine, reverse the direction and become stops."""


@dataclasses.dataclass(frozen=True)
class SmoothPath:
    """A path of poses by arc length l, where dl^2 = |dx|^2 + r dphi^2; C1 except at its ``stops``.

    Attributes:
        arc_length: (N,) increasing, from 0.
        poses: (N, 4) at these arc lengths, closely spaced.
        slope_before, slope_after: (N, 4) one-sided derivatives by l; they differ only at stops.
        bend: (N - 1, 2, 4) second derivatives by l at both ends of each cell.
        curvature: (N - 1,) largest |d2 pose / dl2| in each cell, in the metric of l.
        stops: indices where the motion must come to rest: both ends, and corners that cannot be blended.
    """

    arc_length: Array
    poses: Array
    slope_before: Array
    slope_after: Array
    bend: Array
    curvature: Array
    stops: tuple[int, ...]

    def at(self, arc_length: Array) -> tuple[Array, Array]:
        """Poses (M, 4) and their derivatives by l (M, 4) at arc lengths (M,)."""
        poses, slopes = np.empty((len(arc_length), 4)), np.empty((len(arc_length), 4))
        cell = np.searchsorted(self.arc_length, arc_length, "right") - 1
        part_of = np.clip(np.searchsorted(self.stops, cell, "right") - 1, 0, len(self.stops) - 2)
        for part, (first, last) in enumerate(itertools.pairwise(self.stops)):
            chosen = part_of == part
            if not chosen.any():
                continue
            slope = self.slope_after[first : last + 1].copy()
            slope[-1] = self.slope_before[last]
            spline = CubicHermiteSpline(self.arc_length[first : last + 1], self.poses[first : last + 1], slope)
            poses[chosen], slopes[chosen] = spline(arc_length[chosen]), spline(arc_length[chosen], 1)
        return poses, slopes


def blend_corners(
    poses: Array,
    rotation_weight_m2: float,
    reach_m: float,
    spacing_m: float,
    is_safe: Callable[[Array], bool],
    tolerance_m: float,
    min_reach_m: float = 0.0002,
) -> SmoothPath:
    """Replace each corner of a polyline (K, 4) by a parabola from ``reach_m`` before it to ``reach_m`` after it.

    Args:
        rotation_weight_m2: r of the arc length.
        spacing_m: largest distance between neighboring poses of the result.
        is_safe: test of an arc, given by poses (M, 4) along it. A refused parabola is halved and tested again.
        tolerance_m: a parabola is halved as well if it leaves the chords between these poses by more. Way-points so
            dense that their corners would be stops are dropped where the path changes by at most this much.
        min_reach_m: a corner that would need a shorter parabola becomes a stop.
    """
    scale = np.array([1.0, 1.0, 1.0, math.sqrt(rotation_weight_m2)])
    points = without_repeats(poses * scale)
    legs = np.linalg.norm(np.diff(points, axis=0), axis=1)
    if len(points) > 2 and legs.min() < 2 * min_reach_m:  # each corner of such a leg would be a stop
        points = _thinned(points, tolerance_m, lambda line: is_safe(line / scale))
        legs = np.linalg.norm(np.diff(points, axis=0), axis=1)
    reaches = [0.0]
    for n in range(1, len(points) - 1):
        back, ahead = (points[n - 1] - points[n]) / legs[n - 1], (points[n + 1] - points[n]) / legs[n]
        reach = min(reach_m, legs[n - 1] / 2, legs[n] / 2)
        if back @ ahead > 1 - MIN_TURN:
            reach = 0.0
        while reach >= min_reach_m:
            arc, _, _, curvature = _parabola(points[n] + reach * back, points[n], points[n] + reach * ahead, spacing_m)
            chord = np.linalg.norm(np.diff(arc, axis=0), axis=1)
            deviation = (np.maximum(curvature[1:], curvature[:-1]) * chord**2 / 8).max()
            if deviation <= tolerance_m and is_safe(arc / scale):
                break
            reach /= 2
        reaches.append(reach if reach >= min_reach_m else 0.0)
    return _assemble(points, legs, [*reaches, 0.0], spacing_m, scale)


def _assemble(points: Array, legs: Array, reaches: list[float], spacing_m: float, scale: Array) -> SmoothPath:
    """Join straight pieces and parabolas; ``points`` are poses in the metric of the arc length."""
    pieces, slopes, bends, curvatures, stops = [points[:1]], [], [], [], [0]
    here = points[0]
    count = 1
    for n in range(1, len(points)):
        direction = (points[n] - points[n - 1]) / legs[n - 1]
        end = points[n] - reaches[n] * direction
        gap = float(np.linalg.norm(end - here))
        if gap > 1e-12:
            cells = max(2, math.ceil(gap / spacing_m))  # two stops need a place between them where the speed is not 0
            pieces.append(here + np.arange(1, cells + 1)[:, None] / cells * (end - here))
            slopes.append(np.repeat(direction[None, None], cells, 0).repeat(2, 1))
            bends.append(np.zeros((cells, 2, 4)))
            curvatures.append(np.zeros(cells))
            count += cells
        here = end
        if n == len(points) - 1 or reaches[n] == 0.0:
            stops.append(count - 1)
            continue
        ahead = (points[n + 1] - points[n]) / legs[n]
        arc, tangent, bend, curvature = _parabola(end, points[n], points[n] + reaches[n] * ahead, spacing_m)
        pieces.append(arc[1:])
        slopes.append(np.stack([tangent[:-1], tangent[1:]], axis=1))
        bends.append(np.stack([bend[:-1], bend[1:]], axis=1))
        curvatures.append(np.maximum(curvature[:-1], curvature[1:]))
        count += len(arc) - 1
        here = arc[-1]
    path, slope, curvature = np.concatenate(pieces), np.concatenate(slopes), np.concatenate(curvatures)
    cells_m = np.linalg.norm(np.diff(path, axis=0), axis=1)
    # the chord of a cell is shorter than the arc by a factor 1 - (curvature * chord)^2 / 24
    cells_m *= 1 + (curvature * cells_m) ** 2 / 24
    return SmoothPath(
        arc_length=np.concatenate([[0.0], np.cumsum(cells_m)]),
        poses=path / scale,
        slope_before=np.concatenate([slope[:1, 0], slope[:, 1]]) / scale,
        slope_after=np.concatenate([slope[:, 0], slope[-1:, 1]]) / scale,
        bend=np.concatenate(bends) / scale,
        curvature=curvature,
        stops=tuple(stops),
    )


def _parabola(a: Array, corner: Array, b: Array, spacing_m: float) -> tuple[Array, Array, Array, Array]:
    """Points, unit tangents and their derivatives (M, 4), and curvatures (M,) of the quadratic Bezier curve."""
    cells = max(8, math.ceil(float(np.linalg.norm(corner - a) + np.linalg.norm(b - corner)) / spacing_m))
    t = np.linspace(0.0, 1.0, cells + 1)[:, None]
    points = (1 - t) ** 2 * a + 2 * t * (1 - t) * corner + t**2 * b
    first = 2 * (1 - t) * (corner - a) + 2 * t * (b - corner)
    second = 2 * (a - 2 * corner + b)
    speed = np.linalg.norm(first, axis=1)
    tangent = first / speed[:, None]
    normal = second - (tangent @ second)[:, None] * tangent
    # curvature is largest in the middle; the ends of a cell bound it within the cell to second order
    return points, tangent, normal / speed[:, None] ** 2, np.linalg.norm(normal, axis=1) / speed**2


def _thinned(points: Array, tolerance_m: float, is_safe: Callable[[Array], bool]) -> Array:
    """Drop points of a polyline that lie within ``tolerance_m`` of a straight safe line, in the order of travel."""
    kept, end = [0], len(points) - 1
    while kept[-1] < end:
        first, last, step = kept[-1], kept[-1] + 1, 1
        while step > 0:
            ahead = min(last + step, end)
            if (
                ahead > last
                and _is_straight(points[first : ahead + 1], tolerance_m)
                and is_safe(points[[first, ahead]])
            ):
                last, step = ahead, 2 * step
            else:
                step //= 2
        kept.append(last)
    return points[kept]


def _is_straight(points: Array, tolerance_m: float) -> bool:
    offsets, whole = points - points[0], points[-1] - points[0]
    length = float(np.linalg.norm(whole))
    if length < tolerance_m:
        return False
    along = offsets @ whole / length
    beside = np.linalg.norm(offsets - along[:, None] * (whole / length), axis=1)
    return bool(beside.max() <= tolerance_m and (np.diff(along) >= 0).all())


def without_repeats(points: Array) -> Array:
    """Remove points that repeat their predecessor; the last point is kept exactly."""
    distinct = points[np.append(True, np.linalg.norm(np.diff(points, axis=0), axis=1) > 1e-9)]
    if len(distinct) > 1:
        distinct[-1] = points[-1]
    return distinct
