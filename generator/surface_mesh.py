"""Meshes of quadrilaterals: normals, Catmull-Clark refinement as a matrix, triangles, and the closing of open ends."""

import dataclasses

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

__all__ = [
    "Refinement",
    "boundary_edges",
    "catmull_clark",
    "closed_triangles",
    "triangles_of",
    "unit",
    "vertex_normals",
]

Array = NDArray[np.float64]
Quads = NDArray[np.int64]


def unit(vectors: Array) -> Array:
    """Vectors (..., 3) scaled to length 1; zero stays zero."""
    return np.asarray(vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-12))


def vertex_normals(vertices: Array, quads: Quads) -> Array:
    """Unit normals (V, 3): sums of the area-weighted normals of the faces (F, 4) around each vertex (V, 3)."""
    corner = vertices[quads]
    area = np.cross(corner[:, 2] - corner[:, 0], corner[:, 3] - corner[:, 1])
    sums = [np.bincount(quads.ravel(), np.repeat(area[:, axis], 4), len(vertices)) for axis in range(3)]
    return unit(np.stack(sums, axis=1))


def triangles_of(quads: Quads) -> Quads:
    """(2F, 3) triangles of (F, 4) quadrilaterals, of the same orientation."""
    return np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])


def boundary_edges(quads: Quads) -> Quads:
    """(E, 2) directed edges that belong to one face only."""
    edges = np.stack([quads, np.roll(quads, -1, axis=1)], axis=2).reshape(-1, 2)
    known = set(map(tuple, edges.tolist()))
    return np.array([(a, b) for a, b in edges.tolist() if (b, a) not in known], dtype=np.int64).reshape(-1, 2)


def closed_triangles(vertices: Array, quads: Quads) -> tuple[Array, Quads]:
    """The mesh as triangles, its single open boundary closed by a fan: watertight.

    A simulator that asks whether a point is inside needs a closed surface.
    """
    edges = boundary_edges(quads)
    apex = vertices[edges[:, 0]].mean(axis=0)
    fan = np.column_stack([edges[:, 1], edges[:, 0], np.full(len(edges), len(vertices))])
    return np.vstack([vertices, apex]), np.concatenate([triangles_of(quads), fan])


@dataclasses.dataclass(frozen=True)
class Refinement:
    """One step of Catmull-Clark: new values are ``matrix @ values`` for any attribute of the vertices.

    Attributes:
        matrix: (V', V) sparse, rows sum to one.
        quads: (4F, 4) faces of the refined mesh.
    """

    matrix: sparse.csr_matrix
    quads: Quads


def catmull_clark(quads: Quads, n_vertices: int) -> Refinement:
    """One step of Catmull and Clark (1978); open boundaries become cubic B-splines of their own vertices."""
    n_faces = len(quads)
    edges = np.sort(np.stack([quads, np.roll(quads, -1, axis=1)], axis=2).reshape(-1, 2), axis=1)
    edges, edge_of_corner, sides = np.unique(edges, axis=0, return_inverse=True, return_counts=True)
    edge_of_corner = edge_of_corner.reshape(-1)
    n_edges, boundary = len(edges), sides == 1
    face_of_corner, corner = np.repeat(np.arange(n_faces), 4), quads.reshape(-1)
    edge_of_end, end = np.repeat(np.arange(n_edges), 2), edges.reshape(-1)

    face_points = _incidence(face_of_corner, corner, (n_faces, n_vertices)) * 0.25
    middles = _incidence(edge_of_end, end, (n_edges, n_vertices)) * 0.5
    beside = _incidence(edge_of_corner, face_of_corner, (n_edges, n_faces))
    edge_points = _rows(np.where(boundary, 1.0, 0.5)) @ middles + _rows(np.where(boundary, 0, 0.25)) @ (
        beside @ face_points
    )

    faces_around = _incidence(corner, face_of_corner, (n_vertices, n_faces))
    edges_around = _incidence(end, edge_of_end, (n_vertices, n_edges))
    valence = np.maximum(np.asarray(faces_around.sum(axis=1)).ravel(), 1)
    edge_valence = np.maximum(np.asarray(edges_around.sum(axis=1)).ravel(), 1)
    identity = sparse.identity(n_vertices)
    inner = (
        _rows(1 / valence**2) @ faces_around @ face_points
        + _rows(2 / valence / edge_valence) @ edges_around @ middles
        + _rows((valence - 3) / valence) @ identity
    )
    on_boundary = np.zeros(n_vertices)
    on_boundary[edges[boundary].reshape(-1)] = 1
    outer = 0.25 * edges_around @ _rows(boundary.astype(float)) @ middles + 0.5 * identity
    vertex_points = _rows(1 - on_boundary) @ inner + _rows(on_boundary) @ outer

    on_edge = n_vertices + edge_of_corner.reshape(n_faces, 4)
    on_face = n_vertices + n_edges + np.arange(n_faces)
    refined = [np.stack([quads[:, i], on_edge[:, i], on_face, on_edge[:, i - 1]], axis=1) for i in range(4)]
    matrix = sparse.vstack([vertex_points, edge_points, face_points]).tocsr()
    return Refinement(matrix, np.stack(refined, axis=1).reshape(-1, 4))


def _incidence(rows: Quads, columns: Quads, shape: tuple[int, int]) -> sparse.csr_matrix:
    return sparse.csr_matrix((np.ones(len(rows)), (rows, columns)), shape)


def _rows(factors: Array) -> sparse.dia_matrix:
    return sparse.diags(factors)
