"""Quadrilateral meshes: vertex normals, Catmull-Clark subdivision as a matrix, triangulation, closing of a boundary."""

import dataclasses

import numpy as np
from scipy import sparse

from generator.aliases import Array, Quads


def normalized(vectors: Array) -> Array:
    """Scale vectors (..., 3) to length 1; a zero vector stays zero."""
    return np.asarray(vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-12))


def vertex_normals(vertices: Array, quads: Quads) -> Array:
    """Return unit normals (V, 3): the sum of the area-weighted normals of the adjacent faces (F, 4)."""
    corners = vertices[quads]
    area = np.cross(corners[:, 2] - corners[:, 0], corners[:, 3] - corners[:, 1])
    sums = [np.bincount(quads.ravel(), np.repeat(area[:, axis], 4), len(vertices)) for axis in range(3)]
    return normalized(np.stack(sums, axis=1))


def triangulate(quads: Quads) -> Quads:
    """Split quadrilaterals (F, 4) into triangles (2F, 3) with the same orientation."""
    return np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])


def boundary_edges(quads: Quads) -> Quads:
    """Return the directed edges (E, 2) that belong to one face only."""
    edges = list(map(tuple, _directed_edges(quads).tolist()))
    known = set(edges)
    return np.array([(a, b) for a, b in edges if (b, a) not in known], dtype=np.int64).reshape(-1, 2)


def closed_triangles(vertices: Array, quads: Quads) -> tuple[Array, Quads]:
    """Triangulate a mesh and close its single boundary with a fan, because point-in-mesh tests need a closed surface.

    Returns:
        Vertices (V + 1, 3) and triangles (T, 3) of a watertight mesh.
    """
    edges = boundary_edges(quads)
    apex = vertices[edges[:, 0]].mean(axis=0)
    fan = np.column_stack([edges[:, 1], edges[:, 0], np.full(len(edges), len(vertices))])
    return np.vstack([vertices, apex]), np.concatenate([triangulate(quads), fan])


@dataclasses.dataclass(frozen=True)
class Refinement:
    """One Catmull-Clark step; ``matrix @ values`` gives the refined values of any vertex attribute.

    Attributes:
        matrix: (V', V) sparse; rows sum to one.
        quads: (4F, 4) faces of the refined mesh.
    """

    matrix: sparse.csr_matrix
    quads: Quads


def catmull_clark(quads: Quads, n_vertices: int) -> Refinement:
    """Build one subdivision step of Catmull and Clark (1978).

    A boundary becomes the cubic B-spline of its own vertices.
    """
    n_faces = len(quads)
    edges = np.sort(_directed_edges(quads), axis=1)
    edges, edge_of_corner, sides = np.unique(edges, axis=0, return_inverse=True, return_counts=True)
    edge_of_corner = edge_of_corner.reshape(-1)
    n_edges, boundary = len(edges), sides == 1
    face_of_corner, corner = np.repeat(np.arange(n_faces), 4), quads.reshape(-1)
    edge_of_end, end = np.repeat(np.arange(n_edges), 2), edges.reshape(-1)

    face_points = _incidence(face_of_corner, corner, (n_faces, n_vertices)) * 0.25
    midpoints = _incidence(edge_of_end, end, (n_edges, n_vertices)) * 0.5
    faces_of_edge = _incidence(edge_of_corner, face_of_corner, (n_edges, n_faces))
    edge_points = sparse.diags(np.where(boundary, 1.0, 0.5)) @ midpoints
    edge_points += sparse.diags(np.where(boundary, 0, 0.25)) @ (faces_of_edge @ face_points)

    faces_around = _incidence(corner, face_of_corner, (n_vertices, n_faces))
    edges_around = _incidence(end, edge_of_end, (n_vertices, n_edges))
    valence = np.maximum(np.asarray(faces_around.sum(axis=1)).ravel(), 1)
    edge_valence = np.maximum(np.asarray(edges_around.sum(axis=1)).ravel(), 1)
    identity = sparse.identity(n_vertices)
    inner = (
        sparse.diags(1 / valence**2) @ faces_around @ face_points
        + sparse.diags(2 / valence / edge_valence) @ edges_around @ midpoints
        + sparse.diags((valence - 3) / valence) @ identity
    )
    on_boundary = np.zeros(n_vertices)
    on_boundary[edges[boundary].reshape(-1)] = 1
    outer = 0.25 * edges_around @ sparse.diags(boundary.astype(float)) @ midpoints + 0.5 * identity
    vertex_points = sparse.diags(1 - on_boundary) @ inner + sparse.diags(on_boundary) @ outer

    edge_vertex = n_vertices + edge_of_corner.reshape(n_faces, 4)
    face_vertex = n_vertices + n_edges + np.arange(n_faces)
    refined = [np.stack([quads[:, i], edge_vertex[:, i], face_vertex, edge_vertex[:, i - 1]], axis=1) for i in range(4)]
    matrix = sparse.vstack([vertex_points, edge_points, face_points]).tocsr()
    return Refinement(matrix, np.stack(refined, axis=1).reshape(-1, 4))


def _directed_edges(quads: Quads) -> Quads:
    return np.stack([quads, np.roll(quads, -1, axis=1)], axis=2).reshape(-1, 2)


def _incidence(rows: Quads, columns: Quads, shape: tuple[int, int]) -> sparse.csr_matrix:
    return sparse.csr_matrix((np.ones(len(rows)), (rows, columns)), shape)
