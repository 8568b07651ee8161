import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import minimize
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from deltasafe.errors import SettingsError
from deltasafe.execution.distance import MeshDistance
from deltasafe.planning.audit import body_points
from deltasafe.planning.body import ToolBody
from deltasafe.planning.parts import ToolPart
from tests.unit.execution.conftest import ball

BODY = ToolBody()
MESH = ball((0, 0, 0), 0.05, rings=16)
DENSE = body_points(BODY, 0.002)


def dense_mesh(vertices, triangles, n):
    a, b, c = (np.asarray(vertices, dtype=float)[triangles[:, k]] for k in range(3))
    points = [a + (i / n) * (b - a) + (j / n) * (c - a) for i in range(n + 1) for j in range(n + 1 - i)]
    return np.concatenate(points)


TREE = cKDTree(dense_mesh(*MESH, 12))


@settings(max_examples=15, deadline=None)
@given(st.integers(0, 2**32 - 1), st.floats(0.0, 0.15))
def test_tool_distance_agrees_with_brute_force(seed, height):
    rng = np.random.default_rng(seed)
    direction = rng.standard_normal(3)
    position = direction / np.linalg.norm(direction) * (0.06 + height)
    rotation = Rotation.random(rng=rng).as_matrix()
    distance = MeshDistance(*MESH).to_tool(BODY, position, rotation)
    brute = TREE.query(DENSE @ rotation.T + position)[0].min()
    # the points of the brute force are at most 2 mm apart: it is never below, and above by the lateral offset at most
    assert distance <= brute + 1e-6
    assert brute <= math.hypot(distance, 0.002) + 3e-4


PARTS = [
    ToolPart("sphere", 0.01, 0, 0.02, radius_m=0.02),
    ToolPart("capsule", 0, 0.01, 0, 0.02, 0.03, -0.01, 0.005),
    ToolPart("box", 0, -0.01, 0.01, 0.04, 0.01, 0.02, yaw_rad=0.7),
    ToolPart("disc", 0.01, 0, 0, 0.03, 0.01, 0.004, 0.003, 0.5),
]


@pytest.mark.parametrize("part", PARTS, ids=lambda part: part.kind)
def test_distance_of_parts_to_a_small_mesh_is_that_of_its_points(part):
    """Of a triangle of 2 um, the distance is that of a point, which the part computes by another formula."""
    body = ToolBody(shaft_length_m=0.0, parts=(part,))
    mesh = MeshDistance(1e-6 * np.eye(3), np.array([[0, 1, 2]]))
    rng = np.random.default_rng(2)
    for _ in range(30):
        position, rotation = rng.normal(size=3) * 0.06, Rotation.random(rng=rng).as_matrix()
        expected = part.distance_m((-position @ rotation)[None])[0]
        assert mesh.to_tool(body, position, rotation) == pytest.approx(expected if expected > 1e-5 else 0.0, abs=1.2e-5)


def test_distance_to_a_triangle_in_closed_form():
    mesh = MeshDistance(np.array([[-1, -1, 0], [2, -1, 0], [-1, 2, 0]], dtype=float), np.array([[0, 1, 2]]))
    flat = mesh.to_tool(BODY, np.array([0, 0, 0.1]), np.eye(3))
    assert flat == pytest.approx(0.1 - BODY.thickness_m / 2, abs=1e-7)
    upright = mesh.to_tool(BODY, np.array([0, 0, 0.1]), Rotation.from_euler("y", 90, degrees=True).as_matrix())
    assert upright == pytest.approx(0.1 - BODY.semi_axis_x_m, abs=1e-6)
    beside = mesh.to_tool(BODY, np.array([-1.2, 0, 0]), np.eye(3))
    assert beside == pytest.approx(0.2 - BODY.semi_axis_x_m, abs=1e-7)
    assert mesh.to_tool(BODY, np.array([0, 0, 0.004]), np.eye(3)) == 0.0
    assert mesh.to_tool(BODY, np.array([0, 0, -0.2]), np.eye(3)) == 0.0  # the shaft goes through


def test_the_inside_of_a_large_triangle_counts():
    """Its corners and its center are far from the tool."""
    corners = np.array([[-0.5, -0.03, 0.0], [0.5, -0.03, 0.0], [0.0, -1.0, 0.0]])
    mesh = MeshDistance(corners, np.array([[0, 1, 2]]))
    assert mesh.to_tool(BODY, np.array([0.3, 0.02, 0.0]), np.eye(3)) == pytest.approx(0.05 - 0.015, abs=1e-6)


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_tool_distance_agrees_with_slsqp(seed):
    """Distance of one triangle to the disc, minimized over points of both."""
    rng = np.random.default_rng(seed)
    corners = rng.uniform(-0.1, 0.1, (3, 3)) + np.array([0.2, 0.0, -0.2])
    distance = MeshDistance(corners, np.array([[0, 1, 2]])).to_tool(BODY, np.zeros(3), np.eye(3))

    def gap(u):
        return float(((np.array([0.03 * u[0], 0.015 * u[1], u[2]]) - u[3:] @ corners) ** 2).sum() * 1e3)

    found = minimize(
        gap,
        [0, 0, 0, 1 / 3, 1 / 3, 1 / 3],
        method="SLSQP",
        bounds=[(-1, 1), (-1, 1), (-0.005, 0.005), (0, 1), (0, 1), (0, 1)],
        constraints=[
            {"type": "eq", "fun": lambda u: u[3:].sum() - 1},
            {"type": "ineq", "fun": lambda u: 1 - u[0] ** 2 - u[1] ** 2},
        ],
        options={"ftol": 1e-14, "maxiter": 500},
    )
    assert distance == pytest.approx(math.sqrt(found.fun / 1e3), abs=2e-4)


def test_distance_of_points():
    mesh = MeshDistance(*ball((0, 0, 0), 0.05, rings=60))
    points = np.array([[0.3, 0, 0], [0, 0.11, 0], [0, 0, 0.2]])
    assert mesh.to_points(points) == pytest.approx(0.06, abs=1e-4)
    assert mesh.to_points(np.zeros((0, 3))) == math.inf


def test_invalid_meshes_are_refused():
    with pytest.raises(SettingsError, match="vertices_m"):
        MeshDistance(np.full((3, 3), np.nan), np.array([[0, 1, 2]]))
    with pytest.raises(SettingsError, match="index"):
        MeshDistance(np.zeros((3, 3)), np.array([[0, 1, 3]]))
    with pytest.raises(SettingsError, match="triangles"):
        MeshDistance(np.zeros((3, 3)), np.zeros((0, 3), dtype=int))


@pytest.mark.parametrize("value", [np.nan, np.inf, 1e300])
def test_nonfinite_poses_and_points_are_refused(value):
    """Every comparison with NaN is false: the distance would be infinite."""
    mesh = MeshDistance(*MESH)
    for axis in range(3):
        place = np.zeros(3)
        place[axis] = value
        with pytest.raises(SettingsError, match="position_m"):
            mesh.to_tool(BODY, place, np.eye(3))
        with pytest.raises(SettingsError, match="points_m"):
            mesh.to_points(place[None])
    with pytest.raises(SettingsError, match="rotation"):
        mesh.to_tool(BODY, np.zeros(3), np.full((3, 3), value))
    for wrong in (np.zeros(2), np.zeros((1, 3)), 0.0):
        with pytest.raises(SettingsError, match="position_m"):
            mesh.to_tool(BODY, wrong, np.eye(3))
