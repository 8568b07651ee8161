"""Figures of a search: its tree, the path it found, the field and the body; from above and in perspective."""

import itertools
import math
import pathlib

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.collections import LineCollection
from matplotlib.colors import Normalize, to_rgba
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from mpl_toolkits.mplot3d.art3d import Poly3DCollection  # type: ignore[import-untyped]
from numpy.typing import NDArray
from scipy import ndimage

from deltasafe.planning import DistanceField, SearchTree, ToolBody
from deltasafe.reporting.panels import new_figure, save_figure
from deltasafe.scene import OccupancyGrid
from deltasafe.trials.motion_figure import body_outlines

Array = NDArray[np.float64]
INK, PATH, UNSAFE, BODY, SOLID = "#1b1f24", "#0a7d6c", "#d1495b", "#2b6cb0", "#dd7f8b"
LARGEST_CELLS = 96
"""Largest number of cells along an edge of a field that is drawn in perspective."""


def search_from_above(
    tree: SearchTree, field: DistanceField, body: ToolBody, destination: str | pathlib.Path, title: str
) -> None:
    """Draw the plan view: largest P(occupied) of each column, edges of the tree by height, path and body outlines.

    Args:
        tree: result of the search.
        field: field of the search; its delta is drawn as a contour.
        body: the tool.
        destination: file, written atomically; the suffix selects the format.
        title: title of the figure.
    """
    grid = field.grid
    figure = new_figure(8.6, 7.6)
    ax = figure.add_subplot()
    worst = grid.p_occupied.max(axis=2).T
    extent = (grid.origin_m[0], grid.upper_m[0], grid.origin_m[1], grid.upper_m[1])
    veil = np.zeros((*worst.shape, 4))
    veil[..., :3], veil[..., 3] = to_rgba(UNSAFE)[:3], 0.4 * worst
    ax.imshow(veil, extent=extent, origin="lower", interpolation="bilinear", zorder=1)
    handles: list[Line2D | Patch] = []
    if worst.min() <= field.delta < worst.max():
        x, y = (grid.origin_m[i] + grid.voxel_m * (np.arange(worst.shape[1 - i]) + 0.5) for i in (0, 1))
        ax.contour(x, y, worst, levels=[field.delta], colors=[UNSAFE], linewidths=1.4, zorder=4)
        handles.append(Line2D([], [], color=UNSAFE, lw=1.6, label=f"P(occupied) = {field.delta:g} at some height"))
    edges = _edges(tree)
    edges = edges[np.argsort(edges[:, :, 2].mean(axis=1))]  # the highest edges on top
    ax.add_collection(
        LineCollection(list(edges[:, :, :2]), colors=_height_colors(edges, grid, 0.6), linewidths=0.6, zorder=3)
    )
    path = tree.path()
    if path is not None:
        for outline in body_outlines(_densified(path), body, apart_m=_span_m(grid) / 16):
            ax.fill(*outline[:, :2].T, facecolor=BODY, alpha=0.16, lw=0, zorder=5)
            ax.plot(*outline[:, :2].T, color=BODY, lw=0.9, zorder=5)
        ax.plot(*path[:, :2].T, color="white", lw=5.0, solid_capstyle="round", zorder=6)
        ax.plot(*path[:, :2].T, color=PATH, lw=2.6, solid_capstyle="round", marker="o", ms=3.5, zorder=7)
    for pose, marker in zip(tree.nodes[:2], "os", strict=True):
        ax.plot(*pose[:2], marker, ms=10, mfc="white", mec=INK, mew=1.8, zorder=8)
    ax.set(xlim=extent[:2], ylim=extent[2:], xlabel="x [m]", ylabel="y [m]", aspect="equal")
    ax.spines[["top", "right"]].set_visible(False)
    _finish(figure, ax, handles, tree, grid, title)
    save_figure(figure, destination)


def search_in_space(
    tree: SearchTree, field: DistanceField, body: ToolBody, destination: str | pathlib.Path, title: str
) -> None:
    """Draw the same in perspective: the region P(occupied) > delta, the tree, path, body outlines, and shadows.

    matplotlib sorts polygons by depth only within a collection, so that faces and tree share one collection.
    """
    grid = field.grid
    figure = new_figure(9.4, 7.0)
    ax = figure.add_subplot(projection="3d", computed_zorder=False)
    table_z_m = grid.origin_m[2]
    faces, normals = _faces(grid, field.delta)
    shadows = faces.copy()
    shadows[..., 2] = table_z_m
    ax.add_collection3d(Poly3DCollection(shadows, facecolors="#dee0e5", edgecolors="#dee0e5", zorder=0))
    edges = _split(_edges(tree), _span_m(grid) / 50)
    polygons = np.concatenate([faces, edges[:, [0, 1, 1, 0]]])  # an edge is a quadrilateral without area
    colors = np.concatenate([_shaded(normals), _height_colors(edges, grid, 0.3)])
    ax.add_collection3d(Poly3DCollection(polygons, facecolors=colors, edgecolors=colors, linewidths=0.5, zorder=1))
    path = tree.path()
    if path is not None:
        ax.plot(*path[:, :2].T, zs=table_z_m, color="#9ea5af", lw=3.0, zorder=0.5)
        outlines = body_outlines(_densified(path), body, apart_m=_span_m(grid) / 14)
        fill = (*to_rgba(BODY)[:3], 0.4)
        ax.add_collection3d(Poly3DCollection(outlines, facecolors=fill, edgecolors=BODY, linewidths=0.9, zorder=2))
        ax.plot(*path[:, :3].T, color="white", lw=5.0, zorder=3)
        ax.plot(*path[:, :3].T, color=PATH, lw=3.0, zorder=4)
    for pose, marker in zip(tree.nodes[:2], "os", strict=True):
        ax.plot(*pose[:3, None], marker, ms=9, mfc="white", mec=INK, mew=1.8, zorder=5)
    ax.set(xlabel="x [m]", ylabel="y [m]", zlabel="z [m]")
    ax.set(**{f"{axis}lim": limits for axis, *limits in zip("xyz", grid.origin_m, grid.upper_m, strict=True)})
    ax.set_box_aspect(grid.upper_m - grid.origin_m, zoom=1.1)
    ax.set_proj_type("persp", focal_length=2.0)
    ax.view_init(elev=34.0, azim=-62.0)
    _finish(figure, ax, [Patch(facecolor=SOLID, label=f"P(occupied) > {field.delta:g}")], tree, grid, title)
    save_figure(figure, destination)


def _finish(
    figure: Figure, ax: Axes, handles: list[Line2D | Patch], tree: SearchTree, grid: OccupancyGrid, title: str
) -> None:
    """Add title, color bar and legend."""
    if tree.path() is not None:
        handles += [
            Line2D([], [], color=PATH, lw=2.6, label="path"),
            Patch(facecolor=(*to_rgba(BODY)[:3], 0.16), edgecolor=BODY, label="body along the path"),
        ]
    for label, marker in (("start", "o"), ("goal", "s")):
        handles.append(Line2D([], [], marker=marker, ms=8, mfc="white", mec=INK, mew=1.6, ls="none", label=label))
    figure.legend(handles=handles, loc="outside lower center", ncols=5, fontsize=9, frameon=False)
    ax.set_title(title, fontsize=11, loc="left")
    scale = ScalarMappable(Normalize(grid.origin_m[2], grid.upper_m[2]), "viridis")
    figure.colorbar(scale, ax=ax, shrink=0.6, pad=0.02, aspect=32).set_label("height of the tree's edges [m]")


def _edges(tree: SearchTree) -> Array:
    """Edges (n, 2, 3) of the tree, from parent to child."""
    children = np.flatnonzero(tree.parent >= 0)
    return np.stack([tree.nodes[tree.parent[children], :3], tree.nodes[children, :3]], axis=1)


def _height_colors(edges: Array, grid: OccupancyGrid, alpha: float) -> Array:
    """Colors (n, 4) of edges by their height between the lower and the upper face of the grid."""
    height = (edges[:, :, 2].mean(axis=1) - grid.origin_m[2]) / (grid.upper_m[2] - grid.origin_m[2])
    colors = np.asarray(colormaps["viridis"](np.clip(height, 0, 1)))
    colors[:, 3] = alpha
    return colors


def _faces(grid: OccupancyGrid, delta: float) -> tuple[Array, Array]:
    """Cell faces (n, 4, 3) that bound the region P(occupied) > delta, and its outward normals (n, 3) there."""
    stride = max(1, math.ceil(max(grid.p_occupied.shape) / LARGEST_CELLS))
    p = np.pad(grid.p_occupied, [(0, -count % stride) for count in grid.p_occupied.shape])
    nx, ny, nz = (count // stride for count in p.shape)
    p = np.pad(p.reshape(nx, stride, ny, stride, nz, stride).max(axis=(1, 3, 5)).astype(np.float64), 1)
    slopes = np.gradient(ndimage.gaussian_filter(p, 1.5))
    faces, normals = [], []
    for axis, order in enumerate(((0, 1, 2), (1, 0, 2), (2, 1, 0))):
        inside = np.swapaxes(p > delta, 0, axis)
        cells = np.argwhere(inside[1:] != inside[:-1])
        corners = cells[:, None, :] + np.array([(1, 0, 0), (1, 1, 0), (1, 1, 1), (1, 0, 1)])
        faces.append(corners[..., order].astype(np.float64))
        middle = faces[-1].mean(axis=1).T - 0.5
        normals.append(-np.stack([ndimage.map_coordinates(slope, middle, order=1) for slope in slopes], axis=1))
    normal = np.concatenate(normals)
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-12)
    return grid.origin_m + (np.concatenate(faces) - 1) * stride * grid.voxel_m, normal


def _shaded(normals: Array) -> Array:
    """Colors (n, 4) of faces, lit from above and from the left of the camera."""
    lambert = np.clip(normals @ (-0.11, -0.53, 0.84), 0.0, 1.0)
    return np.column_stack([np.outer(0.42 + 0.58 * lambert, to_rgba(SOLID)[:3]), np.ones(len(normals))])


def _split(edges: Array, longest_m: float) -> Array:
    """Split edges (n, 2, 3) into pieces no longer than ``longest_m``, so that sorting them by depth is correct."""
    lines = [_densified(edge, longest_m) for edge in edges]
    return np.concatenate([np.stack([points[:-1], points[1:]], axis=1) for points in lines])


def _span_m(grid: OccupancyGrid) -> float:
    return float((grid.upper_m - grid.origin_m).max())


def _densified(poses: Array, apart_m: float = 0.005) -> Array:
    """Poses at most ``apart_m`` apart on the polyline (K, 4)."""
    pieces = [poses[:1]]
    for a, b in itertools.pairwise(poses):
        count = max(1, math.ceil(float(np.linalg.norm((b - a)[:3])) / apart_m))
        pieces.append(a + np.arange(1, count + 1)[:, None] / count * (b - a))
    return np.concatenate(pieces)
