"""Pictures of a search: its tree, the path it found, the field and the body; from above, and in space."""

import itertools
import math
import pathlib

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.cm import ScalarMappable
from matplotlib.collections import LineCollection
from matplotlib.colors import Normalize, to_rgba
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from numpy.typing import NDArray
from scipy import ndimage

from deltasafe.errors import SettingsError
from deltasafe.io.storage import atomic_file
from deltasafe.planning import DistanceField, SearchTree, ToolBody
from deltasafe.scene import OccupancyGrid
from deltasafe.studies.planner.isosurface import isosurface
from deltasafe.studies.planner.painter import Painter, View, shaded
from deltasafe.trials.motion_figure import body_outlines

__all__ = ["search_from_above", "search_in_space"]

Array = NDArray[np.float64]
INK, PATH, UNSAFE, BODY, SOLID = "#1b1f24", "#0a7d6c", "#d1495b", "#2b6cb0", "#dd7f8b"
FINEST_CELLS = 96
"""Cells along the longest edge of a field when it is drawn in space."""


def search_from_above(
    tree: SearchTree,
    field: DistanceField,
    body: ToolBody,
    destination: str | pathlib.Path,
    path: Array | None = None,
    title: str = "",
) -> None:
    """Plan view: P(occupied) of each column at its worst, edges of the tree by height, path, outlines of the body.

    Args:
        tree: what the search grew.
        field: the field of the search; its level delta is drawn as a contour.
        body: the tool.
        destination: file to write, atomically; the suffix chooses the format.
        path: (K, 4) poses; by default the tree's own, which a refinement may have shortened.
        title: above the picture.
    """
    grid = field.grid
    figure = Figure(figsize=(8.6, 7.6), dpi=130, facecolor="white", layout="constrained")
    FigureCanvasAgg(figure)
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
    _draw_edges(figure, ax, tree, grid)
    found = tree.path() if path is None else path
    if found is not None:
        for outline in body_outlines(_dense(found), body, apart_m=_span(grid) / 16):
            ax.fill(*outline[:, :2].T, facecolor=BODY, alpha=0.16, lw=0, zorder=5)
            ax.plot(*outline[:, :2].T, color=BODY, lw=0.9, zorder=5)
        ax.plot(*found[:, :2].T, color="white", lw=5.0, solid_capstyle="round", zorder=6)
        ax.plot(*found[:, :2].T, color=PATH, lw=2.6, solid_capstyle="round", marker="o", ms=3.5, zorder=7)
        handles += [
            Line2D([], [], color=PATH, lw=2.6, marker="o", ms=4, label="path"),
            Patch(facecolor=(*to_rgba(BODY)[:3], 0.16), edgecolor=BODY, label="body along the path"),
        ]
    for label, pose, marker in (("start", tree.nodes[0], "o"), ("goal", tree.nodes[1], "s")):
        ax.plot(*pose[:2], marker, ms=10, mfc="white", mec=INK, mew=1.8, zorder=8)
        handles.append(Line2D([], [], marker=marker, ms=8, mfc="white", mec=INK, mew=1.6, ls="none", label=label))
    ax.set(xlim=extent[:2], ylim=extent[2:], xlabel="x [m]", ylabel="y [m]", aspect="equal")
    ax.spines[["top", "right"]].set_visible(False)
    figure.legend(handles=handles, loc="outside lower center", ncols=5, fontsize=9, frameon=False)
    ax.set_title(title or f"{len(tree.nodes)} nodes", fontsize=11, loc="left")
    with atomic_file(destination) as temporary:
        figure.savefig(temporary)


def search_in_space(
    tree: SearchTree,
    field: DistanceField,
    body: ToolBody,
    destination: str | pathlib.Path,
    path: Array | None = None,
    title: str = "",
    azimuth_deg: float = -62.0,
    elevation_deg: float = 34.0,
) -> None:
    """The same in space: the surface P(occupied) = delta, the tree before and behind it, path, body, and shadows.

    Args:
        azimuth_deg, elevation_deg: direction of the eye from the middle of the field.

    Raises:
        SettingsError: the eye is below the table or straight above.
    """
    if not 0 <= elevation_deg < 90:
        raise SettingsError(f"elevation_deg must be in [0, 90), got {elevation_deg}")
    grid = field.grid
    center_m = np.append((grid.origin_m + grid.upper_m)[:2] / 2, grid.origin_m[2])
    view = View(center_m, 4.0 * _span(grid), math.radians(azimuth_deg), math.radians(elevation_deg))
    painter, thin = Painter(view), 0.0014 * _span(grid)
    floor_z_m = grid.origin_m[2]
    triangles, normals = _surface(grid, field.delta)
    found = tree.path() if path is None else path
    shadows, floor = Painter(view), Painter(view)
    _draw_floor(floor, grid, thin)
    shadows.polygons(_on(triangles, floor_z_m), (0.87, 0.88, 0.9, 1.0))
    painter.polygons(triangles, shaded(normals, SOLID, view))
    children = np.flatnonzero(tree.parent >= 0)
    edges = np.stack([tree.nodes[tree.parent[children], :3], tree.nodes[children, :3]], axis=1)
    painter.lines(edges, _by_height(edges[:, :, 2].mean(axis=1), grid, 0.45), thin)
    if found is not None:
        dense = _dense(found)
        pieces = np.stack([dense[:-1, :3], dense[1:, :3]], axis=1)
        shadows.lines(_on(pieces, floor_z_m), (0.62, 0.65, 0.69, 1.0), 5 * thin, nearer_m=_span(grid))
        painter.lines(pieces, (1.0, 1.0, 1.0, 1.0), 9 * thin, nearer_m=10 * thin)
        painter.lines(pieces, to_rgba(PATH), 5.5 * thin, nearer_m=22 * thin)
        outlines = np.stack(body_outlines(dense, body, apart_m=_span(grid) / 14))
        painter.polygons(outlines, (*to_rgba(BODY)[:3], 0.5))
        rims = np.stack([outlines[:, :-1], outlines[:, 1:]], axis=2).reshape(-1, 2, 3)
        painter.lines(rims, to_rgba(BODY), 1.6 * thin, nearer_m=thin)
    figure = Figure(figsize=(9.4, 7.0), dpi=130, facecolor="white", layout="constrained")
    FigureCanvasAgg(figure)
    ax = figure.add_subplot()
    for layer in (floor, shadows, painter):
        layer.draw(ax)
    _label_box(ax, view, grid)
    if found is not None:  # what is hidden of it
        ax.plot(*view.project(_dense(found)[:, :3])[:, :2].T, color="white", lw=1.4, ls=(0, (2, 2.5)), alpha=0.95)
    for pose, marker in ((tree.nodes[0], "o"), (tree.nodes[1], "s")):
        ax.plot(*view.project(pose[:3])[:2], marker, ms=9, mfc="white", mec=INK, mew=1.8)
    handles: list[Line2D | Patch] = [
        Patch(facecolor=SOLID, label=f"P(occupied) > {field.delta:g}"),
        Line2D(
            [], [], color=_by_height(np.array([grid.upper_m[2] / 2]), grid, 1.0)[0], lw=1.4, label="tree, by height"
        ),
    ]
    if found is not None:
        handles += [
            Line2D([], [], color=PATH, lw=3, label="path"),
            Patch(facecolor=(*to_rgba(BODY)[:3], 0.5), edgecolor=BODY, label="body along the path"),
        ]
    handles += [
        Line2D([], [], marker=marker, ms=8, mfc="white", mec=INK, mew=1.6, ls="none", label=label)
        for marker, label in (("o", "start"), ("s", "goal"))
    ]
    figure.legend(handles=handles, loc="outside lower center", ncols=6, fontsize=9, frameon=False)
    ax.set_title(title or f"{len(tree.nodes)} nodes", fontsize=11, loc="left")
    with atomic_file(destination) as temporary:
        figure.savefig(temporary)


def _draw_edges(figure: Figure, ax: Axes, tree: SearchTree, grid: OccupancyGrid) -> None:
    children = np.flatnonzero(tree.parent >= 0)
    edges = np.stack([tree.nodes[tree.parent[children], :3], tree.nodes[children, :3]], axis=1)
    height = edges[:, :, 2].mean(axis=1)
    order = np.argsort(height)  # the highest on top
    ax.add_collection(
        LineCollection(list(edges[order, :, :2]), colors=_by_height(height[order], grid, 0.6), linewidths=0.6, zorder=3)
    )
    scale = ScalarMappable(Normalize(grid.origin_m[2], grid.upper_m[2]), "viridis")
    figure.colorbar(scale, ax=ax, shrink=0.6, pad=0.02, aspect=32).set_label("height of the tree's edges [m]")


def _by_height(height_m: Array, grid: OccupancyGrid, alpha: float) -> Array:
    """(n, 4) colors of heights between table and upper face."""
    from matplotlib import colormaps

    share = (height_m - grid.origin_m[2]) / (grid.upper_m[2] - grid.origin_m[2])
    colors = np.asarray(colormaps["viridis"](np.clip(share, 0, 1)))
    colors[:, 3] = alpha
    return colors


def _surface(grid: OccupancyGrid, delta: float) -> tuple[Array, Array]:
    """Triangles (n, 3, 3) in the world where P(occupied) = delta, and outward normals (n, 3)."""
    stride = max(1, math.ceil(max(grid.p_occupied.shape) / FINEST_CELLS))
    p = np.pad(grid.p_occupied, [(0, -count % stride) for count in grid.p_occupied.shape])
    nx, ny, nz = (count // stride for count in p.shape)
    p = p.reshape(nx, stride, ny, stride, nz, stride).max(axis=(1, 3, 5)).astype(np.float64)
    p = np.pad(ndimage.gaussian_filter(p, 0.6), 1)
    triangles = isosurface(p, delta)
    middle = triangles.mean(axis=1).T
    slopes = np.gradient(ndimage.gaussian_filter(p, 1.0))
    normals = -np.stack([ndimage.map_coordinates(slope, middle, order=1) for slope in slopes], axis=1)
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
    cell_m = stride * grid.voxel_m
    return grid.origin_m + (triangles - 0.5) * cell_m, normals


def _draw_floor(painter: Painter, grid: OccupancyGrid, thin: float) -> None:
    (x0, y0, z), (x1, y1, _) = grid.origin_m, grid.upper_m
    painter.polygons(np.array([[(x0, y0, z), (x1, y0, z), (x1, y1, z), (x0, y1, z)]]), (0.955, 0.96, 0.968, 1.0))
    rules = [((x, y0, z), (x, y1, z)) for x in _ticks(x0, x1)] + [((x0, y, z), (x1, y, z)) for y in _ticks(y0, y1)]
    painter.lines(np.array(rules), (1.0, 1.0, 1.0, 1.0), 2 * thin, nearer_m=_span(grid))


def _label_box(ax: Axes, view: View, grid: OccupancyGrid) -> None:
    (x0, y0, z), (x1, y1, _) = grid.origin_m, grid.upper_m
    away = 0.035 * _span(grid)
    toward = np.array([math.cos(view.azimuth_rad), math.sin(view.azimuth_rad)])
    y_near, y_out = (y1, away) if toward[1] > 0 else (y0, -away)
    x_near, x_out = (x1, away) if toward[0] > 0 else (x0, -away)

    def label(x: float, y: float, z: float, text: str) -> None:
        u, v = view.project((x, y, z))[:2]
        ax.text(u, v, text, fontsize=8, color="#6a717b", ha="center", va="center")

    for x in _ticks(x0, x1):
        label(x, y_near + y_out, z, f"{x:g}")
    for y in _ticks(y0, y1):
        label(x_near + x_out, y, z, f"{y:g}")
    x_far, y_far = (x0, y_near) if x_near == x1 else (x1, y_near)  # the post stands at the outermost corner
    ends = view.project([(x_far, y_far, z), (x_far, y_far, grid.upper_m[2])])[:, :2]
    ax.plot(*ends.T, color="#c4c9d0", lw=1.2, zorder=0)
    for height in _ticks(z, grid.upper_m[2])[1:]:
        label(x_far - x_out, y_far, height, f"{height:g}")
    label(x_far - x_out, y_far, grid.upper_m[2] + away, "z [m]")
    label((x0 + x1) / 2, y_near + 2.6 * y_out, z, "x [m]")
    label(x_near + 2.6 * x_out, (y0 + y1) / 2, z, "y [m]")


def _ticks(low: float, high: float) -> list[float]:
    """Round numbers within, four to nine of them."""
    step = 10.0 ** math.floor(math.log10((high - low) / 2))
    while (high - low) / step < 4:
        step /= 2
    return [round(n * step, 9) for n in range(math.ceil(low / step - 1e-9), math.floor(high / step + 1e-9) + 1)]


def _span(grid: OccupancyGrid) -> float:
    return float((grid.upper_m - grid.origin_m).max())


def _on(points_m: Array, z_m: float) -> Array:
    """The same points on a horizontal plane."""
    below = points_m.copy()
    below[..., 2] = z_m
    return below


def _dense(poses: Array, apart_m: float = 0.005) -> Array:
    """The polyline (K, 4) with poses at most ``apart_m`` apart."""
    pieces = [poses[:1]]
    for a, b in itertools.pairwise(poses):
        count = max(1, math.ceil(float(np.linalg.norm((b - a)[:3])) / apart_m))
        pieces.append(a + np.arange(1, count + 1)[:, None] / count * (b - a))
    return np.concatenate(pieces)
