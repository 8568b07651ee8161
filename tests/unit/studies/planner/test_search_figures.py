"""Pictures of a search: the surface is the sphere's, what is nearer covers what is farther, files are written."""

import math

import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from PIL import Image

from deltasafe.errors import SettingsError
from deltasafe.planning import DistanceField, SearchTree, ToolBody
from deltasafe.scene import Sphere, grid_from_shapes
from deltasafe.studies.planner.isosurface import isosurface
from deltasafe.studies.planner.painter import Painter, View
from deltasafe.studies.planner.search_figures import search_from_above, search_in_space


def test_the_surface_of_a_ball_is_its_sphere_and_closed():
    axes = np.meshgrid(*[np.arange(31.0)] * 3, indexing="ij")
    distance = np.sqrt(sum((axis - 15.0) ** 2 for axis in axes))
    triangles = isosurface(-distance, -10.3)
    assert (
        np.abs(np.linalg.norm(triangles.reshape(-1, 3) - 15.0, axis=1) - 10.3).max() < 0.05
    )  # the distance bends within a cell
    crossed = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    area = np.linalg.norm(crossed, axis=1).sum() / 2
    assert area == pytest.approx(4 * math.pi * 10.3**2, rel=0.01)
    # closed: each edge belongs to two triangles
    corner = np.round(triangles, 6)
    kept = corner[np.linalg.norm(crossed, axis=1) > 1e-9]
    edges = np.concatenate([kept[:, [0, 1]], kept[:, [1, 2]], kept[:, [2, 0]]])
    keys = [tuple(sorted(map(tuple, edge.tolist()))) for edge in edges]
    counts = np.unique([hash(key) for key in keys], return_counts=True)[1]
    assert (counts % 2 == 0).all()


@pytest.mark.parametrize("level", [-1.0, 2.0])
def test_no_surface_where_nothing_crosses_the_level(level):
    assert isosurface(np.ones((4, 4, 4)), level).shape == (0, 3, 3)


def test_up_is_up_and_nearer_is_larger():
    view = View(np.zeros(3), 5.0, math.radians(-90), math.radians(20))
    assert view.project((0, 0, 1))[1] > 0 > view.project((0, 0, -1))[1]
    assert view.project((1, 0, 0))[0] > 0  # looking along +y, x is to the right
    near, far = (view.project([(0, y, 0), (0.1, y, 0)]) for y in (-1, 1))
    assert np.ptp(near[:, 0]) > np.ptp(far[:, 0])
    assert near[0, 2] > far[0, 2]


@pytest.mark.parametrize("reverse", [False, True])
def test_what_is_nearer_covers_what_is_farther_in_whatever_order_it_comes(reverse):
    view = View(np.zeros(3), 5.0, math.radians(-90), 0.0)
    painter = Painter(view)
    square = np.array([(-1, 0, -1), (1, 0, -1), (1, 0, 1), (-1, 0, 1)], dtype=float)
    step = np.array([0, 0.5, 0])
    jobs = [(square - step, (1, 0, 0, 1)), (square + step, (0, 0, 1, 1))]
    for polygon, color in jobs[:: -1 if reverse else 1]:
        painter.polygons(polygon[None], color)
    figure = Figure(figsize=(1, 1), dpi=50)
    canvas = FigureCanvasAgg(figure)
    painter.draw(figure.add_axes((0, 0, 1, 1)))
    canvas.draw()
    pixels = np.asarray(canvas.buffer_rgba())
    assert tuple(pixels[25, 25, :3]) == (255, 0, 0)


def tree_and_field():
    grid = grid_from_shapes([Sphere((0.2, 0.2, 0.1), 0.05)], 0.02, (0, 0, 0), (0.4, 0.4, 0.2), 0.01)
    nodes = np.array([(0.05, 0.05, 0.1, 0), (0.35, 0.35, 0.1, 0), (0.3, 0.1, 0.1, 0.4), (0.1, 0.3, 0.15, 0)])
    tree = SearchTree(nodes, np.array([-1, 2, 0, 0]), np.array([0.0, 0.6, 0.3, 0.3]), 5)
    return tree, DistanceField.build(grid, 0.05)


@pytest.mark.parametrize("draw", [search_from_above, search_in_space])
def test_pictures_show_obstacle_and_path(tmp_path, draw):
    tree, field = tree_and_field()
    draw(tree, field, ToolBody(), tmp_path / "with.png", title="a search")
    lonely = SearchTree(tree.nodes, np.array([-1, -1, 0, 0]), tree.cost, -1)
    draw(lonely, field, ToolBody(), tmp_path / "without.png")
    pictures = []
    for name in ("with", "without"):
        with Image.open(tmp_path / f"{name}.png") as picture:
            pictures.append(np.asarray(picture.convert("RGB")).astype(int).reshape(-1, 3))

    def share(pixels, color):
        return (np.abs(pixels - color).max(axis=1) < 12).mean()

    path = (10, 125, 108)
    assert share(pictures[0], path) > 2 * share(pictures[1], path) + 1e-4
    rose = [(pixels[:, 0] - pixels[:, 1] > 25).mean() for pixels in pictures]
    assert min(rose) > 0.005


def test_the_eye_stays_above_the_table(tmp_path):
    tree, field = tree_and_field()
    with pytest.raises(SettingsError, match="elevation_deg"):
        search_in_space(tree, field, ToolBody(), tmp_path / "no.png", elevation_deg=-10)
    assert not (tmp_path / "no.png").exists()
