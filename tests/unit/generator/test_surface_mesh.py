"""Subdivision against closed forms and invariants; the arm as a closed surface."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from generator.arm import ArmModel
from generator.surface_mesh import (
    boundary_edges,
    catmull_clark,
    closed_triangles,
    normalized,
    triangulate,
    vertex_normals,
)
from tests.unit.generator.oracles import is_watertight, volume

CUBE = np.array([(x, y, z) for x in (-1.0, 1) for y in (-1.0, 1) for z in (-1.0, 1)])
CUBE_FACES = np.array([(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)])


def test_step_on_cube_matches_catmull_clark_formulas():
    step = catmull_clark(CUBE_FACES, 8)
    refined = step.matrix @ CUBE
    assert np.allclose(refined[:8], CUBE * 5 / 9)  # (F + 2 R + (3 - 3) P) / 3
    assert np.allclose(np.sort(np.abs(refined[8:20]), axis=1), [0, 0.75, 0.75])  # (A + B + C + D) / 4 of an edge
    assert np.allclose(np.sort(np.abs(refined[20:]), axis=1), [0, 0, 1])
    assert len(step.quads) == 24
    assert volume(refined, triangulate(step.quads)) > 0


def test_open_boundary_becomes_b_spline_of_its_vertices():
    square = np.array([(0.0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)])
    refined = catmull_clark(np.array([[0, 1, 2, 3]]), 4).matrix @ square
    assert np.allclose(refined[0], 0.75 * square[0] + 0.125 * (square[1] + square[3]))
    assert np.allclose(refined[4:8].mean(axis=0), (0.5, 0.5, 0))


@given(st.integers(0, 2**32 - 1))
def test_refinement_commutes_with_affine_maps(seed):
    rng = np.random.default_rng(seed)
    linear, offset = rng.normal(size=(3, 3)), rng.normal(size=3)
    matrix = catmull_clark(CUBE_FACES, 8).matrix
    assert np.allclose(matrix @ (CUBE @ linear + offset), (matrix @ CUBE) @ linear + offset)


def test_vertex_normals_of_cube_are_its_diagonals():
    assert np.allclose(vertex_normals(CUBE, CUBE_FACES), normalized(CUBE))


def test_open_box_is_closed_with_full_volume():
    vertices, triangles = closed_triangles(CUBE, CUBE_FACES[:-1])
    assert is_watertight(triangles)
    assert volume(vertices, triangles) == pytest.approx(8)


def test_arm_has_one_boundary_loop_and_normalized_weights():
    arm = ArmModel.load()
    assert np.allclose(arm.weights.sum(axis=1), 1)
    assert arm.weights.min() >= 0
    assert np.allclose(arm.refine(arm.weights).sum(axis=1), 1)
    successor = dict(boundary_edges(arm.quads).tolist())
    vertex, visited = next(iter(successor)), set()
    while vertex not in visited:
        visited.add(vertex)
        vertex = successor[vertex]
    assert len(visited) == len(successor), "the boundary is not a single loop"
    vertices, triangles = closed_triangles(arm.points_dm[: arm.n_vertices], arm.quads)
    assert is_watertight(triangles)
    assert 0.8 < volume(vertices, triangles) < 4, "liters (cubic decimeters) of hand, forearm and half of the upper arm"
