"""Distance from the tool, or from points, to a triangle mesh, accurate to 0.1 mm.

The tool consists of convex solids, such as an elliptic and a circular cylinder; a triangle is convex too. Triangles
whose bounding sphere is near enough are tested by alternating projections between the two convex sets (Cheney and
Goldstein 1959), which converge to the distance from above.
"""

import itertools
import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from deltasafe.compute.numba_cache import compiled
from deltasafe.errors import SettingsError
from deltasafe.geometry import as_rows
from deltasafe.planning.body import ToolBody
from deltasafe.planning.parts import ToolPart

Array = NDArray[np.float64]

_MAX_PROJECTIONS = 400
_CELL_M = 0.015
_CELLS_PER_BLOCK = 4
_TOUCHING_M = 1e-5
_THIN_M = 1e-9


class _SphereTree(NamedTuple):
    """F triangles, in spatial cells, in blocks of cells; each with a bounding sphere.

    Attributes:
        corners: (F, 3, 3), in the order of the cells; centers: (F, 3); radii: (F,).
        cell_starts: (C + 1,) cell c holds the triangles from ``cell_starts[c]``; cell_centers: (C, 3);
            cell_radii: (C,).
        block_starts: (B + 1,) block b holds the cells from ``block_starts[b]``; block_centers: (B, 3);
            block_radii: (B,).
    """

    corners: Array
    centers: Array
    radii: Array
    cell_starts: NDArray[np.int64]
    cell_centers: Array
    cell_radii: Array
    block_starts: NDArray[np.int64]
    block_centers: Array
    block_radii: Array


class MeshDistance:
    """Distances to one mesh.

    Args:
        vertices_m: (V, 3) world frame.
        triangles: (F, 3) indices.

    Raises:
        SettingsError: wrong shapes, a vertex that is not finite, or an index without a vertex.
    """

    def __init__(self, vertices_m: NDArray[np.floating], triangles: NDArray[np.integer]) -> None:
        vertices = np.asarray(vertices_m, dtype=np.float64)
        faces = np.asarray(triangles, dtype=np.int64)
        if vertices.ndim != 2 or vertices.shape[1] != 3 or not np.isfinite(vertices).all():
            raise SettingsError(f"vertices_m must be finite with shape (V, 3), got {vertices.shape}")
        if faces.ndim != 2 or faces.shape[1] != 3 or len(faces) == 0:
            raise SettingsError(f"triangles must have shape (F, 3), F >= 1, got {faces.shape}")
        if faces.min() < 0 or faces.max() >= len(vertices):
            raise SettingsError(f"triangles index vertices 0 to {faces.max()}, there are {len(vertices)}")
        corners = vertices[faces]
        centers = corners.mean(axis=1)
        block = np.floor(centers / (_CELLS_PER_BLOCK * _CELL_M))
        keys, cell = np.unique(np.hstack([block, np.floor(centers / _CELL_M)]), axis=0, return_inverse=True)
        corners = np.ascontiguousarray(corners[np.argsort(cell.ravel(), kind="stable")])
        centers = corners.mean(axis=1)
        radii = np.linalg.norm(corners - centers[:, None], axis=2).max(axis=1)
        starts = np.concatenate([[0], np.cumsum(np.bincount(cell.ravel()))])
        _, cells_of_block = np.unique(keys[:, :3], axis=0, return_counts=True)
        cells = np.concatenate([[0], np.cumsum(cells_of_block)])
        in_cells, in_blocks = _bounding_spheres(corners, starts), _bounding_spheres(corners, starts[cells])
        self._tree = _SphereTree(corners, centers, radii, starts, *in_cells, cells, *in_blocks)
        self._box = corners.min(axis=(0, 1)), corners.max(axis=(0, 1))

    def to_points(self, points_m: Array, at_most_m: float = math.inf) -> float:
        """Return the distance in meters from the nearest of (P, 3) points to the mesh; infinite without points.

        Args:
            at_most_m: a known upper bound, which prunes the search.

        Raises:
            SettingsError: a point is not finite, or farther than 1000 m from 0.
        """
        return float(_points_distance(as_rows(points_m, 3, "points_m"), self._box, self._tree, at_most_m))

    def to_tool(self, body: ToolBody, position_m: Array, rotation: Array, at_most_m: float = math.inf) -> float:
        """Return the distance in meters from the tool to the mesh's surface, 0 where they touch or intersect.

        Args:
            body: the tool.
            position_m: (3,) center of the disc.
            rotation: (3, 3) world from tool.
            at_most_m: a known upper bound, which prunes the search.

        Raises:
            SettingsError: the pose has another shape, is not finite, or farther than 1000 m from 0.
        """
        position_m = as_rows([position_m], 3, "position_m")[0]
        rotation = as_rows(rotation, 3, "rotation")
        if len(rotation) != 3:
            raise SettingsError(f"rotation must have shape (3, 3), got {rotation.shape}")
        best = at_most_m
        for part in body.solids:
            solid, offset_m, turn = _solid_of(part)
            place = position_m + rotation @ offset_m
            core_m = _solid_distance(solid, self._tree, place, rotation @ turn, best + part.radius_m)
            best = min(best, core_m - part.radius_m)
        return best if best > _TOUCHING_M else 0.0


def _solid_of(part: ToolPart) -> tuple[Array, Array, Array]:
    """The core of a part as (a, b, bottom, top, is box), its position and rotation in the tool's frame.

    The core of a capsule is a cylinder of almost no radius along its axis.
    """
    if not part.is_segment:
        cos, sin = math.cos(part.yaw_rad), math.sin(part.yaw_rad)
        half = part.half_z_m
        solid = (part.half_x_m, part.half_y_m, part.z_m - half, part.z_m + half, float(part.kind == "box"))
        turn = np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
        return np.array(solid), np.array([part.x_m, part.y_m, 0.0]), turn
    axis = np.array([part.half_x_m, part.half_y_m, part.half_z_m])
    length_m = float(np.linalg.norm(axis))
    along = axis / length_m if length_m > 0 else np.array([0.0, 0.0, 1.0])
    across = np.cross(along, np.eye(3)[int(np.abs(along).argmin())])
    across /= np.linalg.norm(across)
    solid = (_THIN_M, _THIN_M, -length_m, length_m, 0.0)
    turn = np.stack([across, np.cross(along, across), along], axis=1)
    return np.array(solid), np.array([part.x_m, part.y_m, part.z_m]), turn


def _bounding_spheres(corners: Array, starts: NDArray[np.int64]) -> tuple[Array, Array]:
    """Centers (n, 3) and radii (n,) of spheres around the triangles from ``starts[n]`` up to ``starts[n + 1]``."""
    parts = [corners[begin:end].reshape(-1, 3) for begin, end in itertools.pairwise(starts)]
    centers = np.array([part.mean(axis=0) for part in parts])
    radii = [np.linalg.norm(part - center, axis=1).max() for part, center in zip(parts, centers, strict=True)]
    return centers, np.array(radii)


@compiled
def _points_distance(points, box, tree, best):  # type: ignore[no-untyped-def]  # pragma: no cover
    """Smallest of ``best`` and the distances of (P, 3) points to the triangles."""
    for i in range(len(points)):
        p = (points[i, 0], points[i, 1], points[i, 2])
        if _to_box(p, box[0], box[1]) >= best:
            continue
        for block in range(len(tree.block_centers)):
            if _gap(p, tree.block_centers[block]) - tree.block_radii[block] >= best:
                continue
            for cell in range(tree.block_starts[block], tree.block_starts[block + 1]):
                if _gap(p, tree.cell_centers[cell]) - tree.cell_radii[cell] >= best:
                    continue
                for t in range(tree.cell_starts[cell], tree.cell_starts[cell + 1]):
                    if _gap(p, tree.centers[t]) - tree.radii[t] < best:
                        best = min(best, _gap(p, _on_triangle(p, tree.corners[t])))
    return best


@compiled
def _solid_distance(solid, tree, position, rotation, best):  # type: ignore[no-untyped-def]  # pragma: no cover
    """Smallest of ``best`` and the distance of a solid (a, b, bottom, top, is box) to the triangles."""
    bounds = np.empty(len(tree.block_centers))
    for block in range(len(bounds)):
        bounds[block] = _to_solid(solid, tree.block_centers[block], position, rotation) - tree.block_radii[block]
    for block in np.argsort(bounds):
        if bounds[block] >= best:
            break
        for cell in range(tree.block_starts[block], tree.block_starts[block + 1]):
            if _to_solid(solid, tree.cell_centers[cell], position, rotation) - tree.cell_radii[cell] >= best:
                continue
            for t in range(tree.cell_starts[cell], tree.cell_starts[cell + 1]):
                triangle = tree.corners[t], tree.centers[t], tree.radii[t]
                best = _to_triangle(solid, triangle, position, rotation, best)
    return best


@compiled
def _to_solid(solid, point, position, rotation):  # type: ignore[no-untyped-def]  # pragma: no cover
    x, y, z = _to_frame(point, position, rotation)
    return _gap(_in_solid(x, y, z, solid), (x, y, z))


@compiled
def _to_triangle(solid, triangle, position, rotation, best):  # type: ignore[no-untyped-def]  # pragma: no cover
    """Smallest of ``best`` and the distance of the cylinder to one triangle (corners, center, radius)."""
    corners, center, radius = triangle
    bottom, top = solid[2], solid[3]
    x, y, z = _to_frame(center, position, rotation)
    reach = math.sqrt(solid[0] * solid[0] + solid[1] * solid[1]) if solid[4] > 0.0 else max(solid[0], solid[1])
    radial = max(math.sqrt(x * x + y * y) - reach, 0.0)
    vertical = max(z - top, bottom - z, 0.0)
    if math.sqrt(radial * radial + vertical * vertical) - radius >= best:  # cheaper than the test below
        return best
    if _gap(_in_solid(x, y, z, solid), (x, y, z)) - radius >= best:
        return best
    local = np.empty((3, 3))
    for corner in range(3):
        local[corner] = _to_frame(corners[corner], position, rotation)
    last = np.inf
    gap = np.inf
    for _ in range(_MAX_PROJECTIONS):
        inside = _in_solid(x, y, z, solid)
        x, y, z = _on_triangle(inside, local)
        gap = _gap(inside, (x, y, z))
        if gap < _TOUCHING_M or last - gap < 1e-8:
            break
        last = gap
    return min(best, gap)


@compiled
def _to_box(p, lowest, highest):  # type: ignore[no-untyped-def]  # pragma: no cover
    x = max(lowest[0] - p[0], p[0] - highest[0], 0.0)
    y = max(lowest[1] - p[1], p[1] - highest[1], 0.0)
    z = max(lowest[2] - p[2], p[2] - highest[2], 0.0)
    return math.sqrt(x * x + y * y + z * z)


@compiled
def _to_frame(point, position, rotation):  # type: ignore[no-untyped-def]  # pragma: no cover
    x, y, z = point[0] - position[0], point[1] - position[1], point[2] - position[2]
    return (
        rotation[0, 0] * x + rotation[1, 0] * y + rotation[2, 0] * z,
        rotation[0, 1] * x + rotation[1, 1] * y + rotation[2, 1] * z,
        rotation[0, 2] * x + rotation[1, 2] * y + rotation[2, 2] * z,
    )


@compiled
def _gap(p, q):  # type: ignore[no-untyped-def]  # pragma: no cover
    return math.sqrt((p[0] - q[0]) ** 2 + (p[1] - q[1]) ** 2 + (p[2] - q[2]) ** 2)


@compiled
def _in_solid(x, y, z, solid):  # type: ignore[no-untyped-def]  # pragma: no cover
    """Nearest point of the solid elliptic cylinder or box."""
    a, b = solid[0], solid[1]
    z = min(max(z, solid[2]), solid[3])
    if solid[4] > 0.0:
        return min(max(x, -a), a), min(max(y, -b), b), z
    if (x / a) ** 2 + (y / b) ** 2 <= 1.0:
        return x, y, z
    # Newton from the left on (a x / (t + a^2))^2 + (b y / (t + b^2))^2 = 1, convex and decreasing in the multiplier t
    t = max(a * abs(x) - a * a, b * abs(y) - b * b, 0.0)
    for _ in range(50):
        p, q = a * x / (t + a * a), b * y / (t + b * b)
        step = (p * p + q * q - 1.0) / (2.0 * (p * p / (t + a * a) + q * q / (t + b * b)))
        t += step
        if abs(step) < 1e-13:
            break
    return a * a * x / (t + a * a), b * b * y / (t + b * b), z


@compiled
def _on_triangle(p, t):  # type: ignore[no-untyped-def]  # pragma: no cover
    """Nearest point of a triangle, by the region of the plane that p projects to (Ericson 2004, section 5.1.5)."""
    ab0, ab1, ab2 = t[1, 0] - t[0, 0], t[1, 1] - t[0, 1], t[1, 2] - t[0, 2]
    ac0, ac1, ac2 = t[2, 0] - t[0, 0], t[2, 1] - t[0, 1], t[2, 2] - t[0, 2]
    d1 = ab0 * (p[0] - t[0, 0]) + ab1 * (p[1] - t[0, 1]) + ab2 * (p[2] - t[0, 2])
    d2 = ac0 * (p[0] - t[0, 0]) + ac1 * (p[1] - t[0, 1]) + ac2 * (p[2] - t[0, 2])
    d3 = ab0 * (p[0] - t[1, 0]) + ab1 * (p[1] - t[1, 1]) + ab2 * (p[2] - t[1, 2])
    d4 = ac0 * (p[0] - t[1, 0]) + ac1 * (p[1] - t[1, 1]) + ac2 * (p[2] - t[1, 2])
    d5 = ab0 * (p[0] - t[2, 0]) + ab1 * (p[1] - t[2, 1]) + ab2 * (p[2] - t[2, 2])
    d6 = ac0 * (p[0] - t[2, 0]) + ac1 * (p[1] - t[2, 1]) + ac2 * (p[2] - t[2, 2])
    va, vb, vc = d3 * d6 - d5 * d4, d5 * d2 - d1 * d6, d1 * d4 - d3 * d2
    if d1 <= 0.0 and d2 <= 0.0:
        v, w = 0.0, 0.0
    elif d3 >= 0.0 and d4 <= d3:
        v, w = 1.0, 0.0
    elif d6 >= 0.0 and d5 <= d6:
        v, w = 0.0, 1.0
    elif vc <= 0.0 and d1 >= 0.0 and d3 <= 0.0:
        v, w = d1 / (d1 - d3), 0.0
    elif vb <= 0.0 and d2 >= 0.0 and d6 <= 0.0:
        v, w = 0.0, d2 / (d2 - d6)
    elif va <= 0.0 and d4 - d3 >= 0.0 and d5 - d6 >= 0.0:
        w = (d4 - d3) / ((d4 - d3) + (d5 - d6))
        v = 1.0 - w
    else:
        v, w = vb / (va + vb + vc), vc / (va + vb + vc)
    return (
        t[0, 0] + v * ab0 + w * ac0,
        t[0, 1] + v * ab1 + w * ac1,
        t[0, 2] + v * ab2 + w * ac2,
    )
