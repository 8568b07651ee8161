"""Refinement against closed forms and invariants; the arm as a surface."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from generator.arm import ArmModel
from generator.surface_mesh import boundary_edges, catmull_clark, closed_triangles, triangles_of, unit, vertex_normals

CUBE = np.array([(x, y, z) for x in (-1.0, 1) for y in (-1.0, 1) for z in (-1.0, 1)])
CUBE_FACES = np.array([(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)])


def volume(vertices, triangles):
    """By the divergence theorem; positive if normals point outwards."""
    a, b, c = (vertices[triangles[:, i]] for i in range(3))
    return float((a * np.cross(b, c)).sum() / 6)


def is_watertight(triangles):
    edges = {tuple(edge) for t in triangles.tolist() for edge in zip(t, t[1:] + t[:1], strict=True)}
    return len(edges) == 3 * len(triangles) and all((b, a) in edges for a, b in edges)


def test_one_step_on_a_cube_is_what_catmull_and_clark_say():
    step = catmull_clark(CUBE_FACES, 8)
    refined = step.matrix @ CUBE
    assert np.allclose(refined[:8], CUBE * 5 / 9)  # (F + 2 R + (3 - 3) P) / 3
    assert np.allclose(np.sort(np.abs(refined[8:20]), axis=1), [0, 0.75, 0.75])  # (A + B + C + D) / 4 of an edge
    assert np.allclose(np.sort(np.abs(refined[20:]), axis=1), [0, 0, 1])
    assert len(step.quads) == 24
    assert volume(refined, triangles_of(step.quads)) > 0


def test_an_open_boundary_becomes_a_b_spline_of_its_own_vertices():
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


def test_normals_of_a_cube_point_along_its_diagonals():
    assert np.allclose(vertex_normals(CUBE, CUBE_FACES), unit(CUBE))


def test_an_open_box_is_closed_by_a_fan():
    vertices, triangles = closed_triangles(CUBE, CUBE_FACES[:-1])
    assert is_watertight(triangles)
    assert volume(vertices, triangles) == pytest.approx(8)


def test_the_arm_has_one_boundary_and_weights_that_sum_to_one():
    arm = ArmModel.load()
    assert np.allclose(arm.weights.sum(axis=1), 1)
    assert arm.weights.min() >= 0
    assert np.allclose(arm.refine(arm.weights).sum(axis=1), 1)
    edges = boundary_edges(arm.quads)
    after = dict(edges.tolist())
    place, seen = edges[0, 0], set()
    while place not in seen:
        seen.add(place)
        place = after[place]
    assert len(seen) == len(edges), "the boundary is not a single loop"
    vertices, triangles = closed_triangles(arm.points_dm[: arm.n_vertices], arm.quads)
    assert is_watertight(triangles)
    assert 0.8 < volume(vertices, triangles) < 4, "litres of an arm from the middle of the upper arm on"
