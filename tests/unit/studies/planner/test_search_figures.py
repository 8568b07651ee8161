"""Figures of a search: drawn faces bound the occupied region, and the figures show obstacle and path."""

import numpy as np
import pytest
from PIL import Image

from deltasafe.planning import DistanceField, SearchTree, ToolBody
from deltasafe.scene import Sphere, grid_from_shapes
from deltasafe.studies.planner.search_figures import _faces, search_from_above, search_in_space


def tree_and_field():
    grid = grid_from_shapes([Sphere((0.2, 0.2, 0.1), 0.05)], 0.02, (0, 0, 0), (0.4, 0.4, 0.2), 0.01)
    nodes = np.array([(0.05, 0.05, 0.1, 0), (0.35, 0.35, 0.1, 0), (0.3, 0.1, 0.1, 0.4), (0.1, 0.3, 0.15, 0)])
    tree = SearchTree(nodes, np.array([-1, 2, 0, 0]), np.array([0.0, 0.6, 0.3, 0.3]), 5)
    return tree, DistanceField.build(grid, 0.05)


def test_faces_enclose_the_occupied_cells():
    grid = tree_and_field()[1].grid
    faces, normals = _faces(grid, 0.05)
    middle = faces.mean(axis=1)
    outward = middle - (0.2, 0.2, 0.1)
    assert (np.einsum("ni,ni->n", normals, outward) > 0.7 * np.linalg.norm(outward, axis=1)).all()
    # divergence theorem: the flux of x through the surface is three times the enclosed volume
    axis = np.ptp(faces, axis=1).argmin(axis=1)
    across = np.take_along_axis(outward, axis[:, None], axis=1)
    occupied_m3 = (grid.p_occupied > 0.05).sum() * grid.voxel_m**3
    assert np.abs(across).sum() * grid.voxel_m**2 / 3 == pytest.approx(occupied_m3)


@pytest.mark.parametrize("draw", [search_from_above, search_in_space])
def test_figures_show_obstacle_and_path(tmp_path, draw):
    tree, field = tree_and_field()
    draw(tree, field, ToolBody(), tmp_path / "with.png", "a search")
    unsolved = SearchTree(tree.nodes, np.array([-1, -1, 0, 0]), tree.cost, -1)
    draw(unsolved, field, ToolBody(), tmp_path / "without.png", "no path")
    pictures = []
    for name in ("with", "without"):
        with Image.open(tmp_path / f"{name}.png") as picture:
            pictures.append(np.asarray(picture.convert("RGB")).astype(int).reshape(-1, 3))

    def fraction(pixels, color):
        return (np.abs(pixels - color).max(axis=1) < 12).mean()

    path = (10, 125, 108)
    assert fraction(pictures[0], path) > 2 * fraction(pictures[1], path) + 1e-4
    red = [(pixels[:, 0] - pixels[:, 1] > 25).mean() for pixels in pictures]
    assert min(red) > 0.005
