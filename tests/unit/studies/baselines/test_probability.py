"""P(collision) and its bounds: golden vectors, Monte Carlo, and invariants."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import integrate
from scipy.optimize import minimize_scalar
from scipy.special import ndtr
from scipy.stats import ncx2

from deltasafe.errors import SettingsError
from deltasafe.scene import Cuboid, Sphere
from deltasafe.studies.baselines.obstacles import GaussianObstacle, enclosing_obstacle, obstacle_arrays
from deltasafe.studies.baselines.probability import METHODS, collision_probability_of_ball, risk

BOUNDS = ("chance_constraint", "max_probability")


def one(obstacle, point, method, robot_radius_m=0.0, numeric_search=False):
    """P(collision) by a method for a robot at a point."""
    arrays = obstacle_arrays([obstacle], robot_radius_m, 0.0)
    w = arrays.map[0] @ (np.asarray(point) - arrays.mean_m[0])
    return risk(METHODS.index(method), numeric_search, tuple(w), tuple(arrays.spread[0]))


def random_case(rng):
    """Draw an obstacle of random shape, yaw and covariance, a position of the robot, and the robot's radius."""
    root = rng.normal(size=(3, 3)) * rng.uniform(0.005, 0.05, 3)
    covariance = tuple(map(tuple, root @ root.T + 1e-6 * np.eye(3)))
    axes = tuple(rng.uniform(0.02, 0.2, 3)) if rng.random() < 0.7 else (rng.uniform(0.02, 0.2),) * 3
    direction = rng.normal(size=3)
    point = direction / np.linalg.norm(direction) * rng.uniform(0.0, 0.4)
    obstacle = GaussianObstacle((0.0, 0.0, 0.0), axes, covariance, rng.uniform(-3, 3))
    return obstacle, point, rng.uniform(0.0, 0.05)


def test_golden_vector_of_the_published_example():
    """methods.md: point robot beside an upright ellipsoid; Monte Carlo 0.01094, linearized 0.01712."""
    diagonal = ((0.04, 0.0, 0.0), (0.0, 0.04, 0.0), (0.0, 0.0, 0.01))
    obstacle = GaussianObstacle((0.0, 0.0, 0.0), (0.6, 0.6, 2.2), diagonal)
    place = (0.7, 0.7, 0.8)
    assert one(obstacle, place, "exact") == pytest.approx(0.01094, abs=1e-3)
    assert one(obstacle, place, "chance_constraint") == pytest.approx(0.01712, abs=1e-5)


@pytest.mark.parametrize(
    ("method", "expected"),
    [
        ("exact", (0.0780, 0.00925, 0.000464)),
        ("chance_constraint", (0.1587, 0.02275, 0.00135)),
        ("max_probability", (1.0, 0.288, 0.0236)),
    ],
)
@pytest.mark.parametrize("numeric_search", [False, True])
def test_golden_vectors_of_a_ball(method, expected, numeric_search):
    obstacle = GaussianObstacle.ball((0.0, 0.0, 0.0), 0.1, 0.05)
    for distance, p in zip((0.15, 0.20, 0.25), expected, strict=True):
        found = one(obstacle, (0.0, distance, 0.0), method, numeric_search=numeric_search)
        assert found == pytest.approx(p, rel=2e-3)  # printed with three digits


def test_bounds_are_at_least_the_monte_carlo_value():
    rng = np.random.default_rng(2024)
    draws = rng.standard_normal((20_000, 3))
    for _ in range(1000):
        obstacle, point, radius = random_case(rng)
        centers = draws @ np.linalg.cholesky(np.asarray(obstacle.covariance_m2)).T
        cos, sin = math.cos(obstacle.yaw_rad), math.sin(obstacle.yaw_rad)
        local = (point - centers) @ np.array([[cos, -sin, 0], [sin, cos, 0], [0, 0, 1]])
        hits = ((local / (np.asarray(obstacle.semi_axes_m) + radius)) ** 2).sum(axis=1) <= 1
        sampled = hits.mean()
        exact = one(obstacle, point, "exact", radius)
        deviation = math.sqrt(max(exact * (1 - exact), 1e-9) / len(draws))
        assert abs(sampled - exact) <= 5 * deviation + 3 / len(draws)
        for method in BOUNDS:
            bound = one(obstacle, point, method, radius)
            assert bound >= exact * (1 - 1e-9)
            assert bound >= sampled - 5 * deviation - 3 / len(draws)


@pytest.mark.parametrize("distance", [0.0, 1e-7, 0.01, 0.1, 0.2, 0.4])
def test_closed_form_equals_the_non_central_chi_square(distance):
    expected = ncx2.cdf((0.1 / 0.05) ** 2, 3, (distance / 0.05) ** 2)
    assert collision_probability_of_ball(distance, 0.1, 0.05) == pytest.approx(expected, rel=1e-7)


def test_quadrature_agrees_with_scipy_and_with_the_closed_form():
    mean, sigma = np.array([1.1, 0.3, 0.4]), np.array([0.3, 0.12, 0.05])

    def integrand(y, x):
        half = math.sqrt(max(1 - x * x - y * y, 0.0))
        across = ndtr((half - mean[0]) / sigma[0]) - ndtr((-half - mean[0]) / sigma[0])
        z = ((y - mean[1]) / sigma[1]) ** 2 + ((x - mean[2]) / sigma[2]) ** 2
        return across * math.exp(-z / 2) / (2 * math.pi * sigma[1] * sigma[2])

    expected, _ = integrate.dblquad(
        integrand, 0.0, 0.8, lambda x: -math.sqrt(1 - x * x), lambda x: math.sqrt(1 - x * x), epsabs=1e-10
    )
    covariance = tuple(map(tuple, np.diag(sigma**2)))
    assert one(GaussianObstacle((0, 0, 0), (1, 1, 1), covariance), mean, "exact") == pytest.approx(expected, abs=1e-8)
    almost = tuple(map(tuple, np.diag([0.01, 0.01, 0.01 * (1 + 1e-6)])))
    skewed = one(GaussianObstacle((0, 0, 0), (1, 1, 1), almost), (1.1, 0.1, 0.2), "exact")
    assert skewed == pytest.approx(one(GaussianObstacle.ball((0, 0, 0), 1, 0.1), (1.1, 0.1, 0.2), "exact"), rel=1e-4)


def test_multiplier_search_finds_the_largest_density_in_the_ball():
    """Compared with a grid over the sphere, for covariances without symmetry."""
    rng = np.random.default_rng(7)
    polar, around = np.meshgrid(np.linspace(0, np.pi, 400), np.linspace(0, 2 * np.pi, 800))
    sphere = np.stack([np.sin(polar) * np.cos(around), np.sin(polar) * np.sin(around), np.cos(polar)], -1).reshape(
        -1, 3
    )
    for _ in range(20):
        root = rng.normal(size=(3, 3)) * 0.3
        covariance = root @ root.T + 0.01 * np.eye(3)
        direction = rng.normal(size=3)
        point = direction / np.linalg.norm(direction) * rng.uniform(1.3, 3.0)
        away = point - sphere
        least = np.einsum("ni,ij,nj->n", away, np.linalg.inv(covariance), away).min()
        density = math.exp(-least / 2) / math.sqrt((2 * math.pi) ** 3 * np.linalg.det(covariance))
        expected = min(4 / 3 * math.pi * density, 1.0)
        found = one(GaussianObstacle((0, 0, 0), (1, 1, 1), tuple(map(tuple, covariance))), point, "max_probability")
        assert expected * (1 - 1e-9) <= found <= expected * 1.01 + 1e-12


def test_linearized_bound_is_the_tightest_half_space_for_a_ball():
    """Among half spaces that contain a ball, the one facing the mean has the smallest probability."""
    obstacle = GaussianObstacle.ball((0.0, 0.0, 0.0), 0.1, 0.04)
    point = np.array([0.12, 0.09, 0.0])

    def half_space(angle):
        normal = np.array([math.cos(angle), math.sin(angle), 0.0])
        return float(ndtr((0.1 - normal @ point) / 0.04))

    best = minimize_scalar(half_space, bounds=(0.0, 1.5), method="bounded").fun
    assert one(obstacle, point, "chance_constraint") == pytest.approx(best, rel=1e-6)


@settings(deadline=None, max_examples=150)
@given(st.integers(0, 10**6), st.sampled_from(("exact", *BOUNDS)))
def test_probabilities_are_invariant_to_rigid_motions(seed, method):
    rng = np.random.default_rng(seed)
    obstacle, point, radius = random_case(rng)
    p = one(obstacle, point, method, radius)
    assert 0 <= p <= 1
    turn = rng.uniform(-3, 3)
    rotation = np.array([[math.cos(turn), -math.sin(turn), 0], [math.sin(turn), math.cos(turn), 0], [0, 0, 1]])
    covariance = rotation @ np.asarray(obstacle.covariance_m2) @ rotation.T
    shift = rng.uniform(-1, 1, 3)
    moved = GaussianObstacle(tuple(shift), obstacle.semi_axes_m, tuple(map(tuple, covariance)), obstacle.yaw_rad + turn)
    assert one(moved, rotation @ point + shift, method, radius) == pytest.approx(p, rel=1e-6, abs=1e-12)


@settings(deadline=None, max_examples=150)
@given(st.floats(0.01, 0.2), st.floats(0.001, 0.05), st.floats(0.0, 0.3), st.floats(0.0, 0.1), st.sampled_from(BOUNDS))
def test_probability_never_grows_with_distance(radius, sigma, distance, step, method):
    obstacle = GaussianObstacle.ball((0.0, 0.0, 0.0), radius, sigma)
    near, far = (one(obstacle, (x, 0.0, 0.0), method) for x in (distance, distance + step))
    assert far <= near + 1e-15


def test_bounds_are_one_inside_the_mean_shape():
    obstacle = GaussianObstacle.ball((0.0, 0.0, 0.0), 0.1, 1.0)
    assert one(obstacle, (0.0, 0.0, 0.099), "exact") < 0.01
    for method in BOUNDS:
        assert one(obstacle, (0.0, 0.0, 0.099), method) == 1.0


def test_corners_of_a_cuboid_touch_its_enclosing_ellipsoid():
    cuboid = Cuboid((0.3, 0.1, 0.2), (0.05, 0.08, 0.02), 0.7)
    obstacle = enclosing_obstacle(cuboid, 0.01)
    cos, sin = math.cos(0.7), math.sin(0.7)
    signs = np.stack(np.meshgrid(*[[-1, 1]] * 3), -1).reshape(-1, 3)
    corners = signs * cuboid.half_extents_m @ np.array([[cos, sin, 0], [-sin, cos, 0], [0, 0, 1]]) + cuboid.center_m
    assert (cuboid.distance_m(corners) < 1e-12).all()
    local = (corners - obstacle.mean_m) @ np.array([[cos, -sin, 0], [sin, cos, 0], [0, 0, 1]])
    assert ((local / obstacle.semi_axes_m) ** 2).sum(axis=1) == pytest.approx(np.ones(8))
    assert enclosing_obstacle(Sphere((0, 0, 1), 0.2), 0.01).semi_axes_m == (0.2, 0.2, 0.2)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"semi_axes_m": (0.1, 0.0, 0.1)}, "semi_axes_m"),
        ({"covariance_m2": ((1.0, 0, 0), (0, 0.0, 0), (0, 0, 1.0))}, "positive definite"),
        ({"covariance_m2": ((1.0, 0.5, 0), (0, 1.0, 0), (0, 0, 1.0))}, "symmetric"),
        ({"mean_m": (0.0, math.nan, 0.0)}, "finite"),
        ({"covariance_m2": ((1.0,),)}, "3 x 3"),
    ],
)
def test_impossible_obstacles_are_refused(change, message):
    usual = {"mean_m": (0.0, 0.0, 0.0), "semi_axes_m": (0.1,) * 3, "covariance_m2": tuple(map(tuple, np.eye(3)))}
    with pytest.raises(SettingsError, match=message):
        GaussianObstacle(**{**usual, **change})
