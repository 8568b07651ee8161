"""The compared methods as segment tests: compared with their probabilities pose by pose, and invariants."""

import itertools
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from deltasafe.errors import SettingsError
from deltasafe.planning import grow_tree, line_cost, search_problem
from deltasafe.planning.collision.segment_query import segment_passes
from deltasafe.studies.baselines import GaussianCheckSettings, GaussianObstacle, gaussian_test
from deltasafe.studies.baselines.obstacles import obstacle_arrays
from deltasafe.studies.baselines.probability import JOINT_RISKS, METHODS, risk

ROBOT_M, STEP_M = 0.03, 0.01


def obstacles_of(seed, count=4, isotropic=False):
    rng = np.random.default_rng(seed)
    found = []
    for _ in range(count):
        mean = tuple(rng.uniform(-0.2, 0.2, 3))
        if isotropic:
            found.append(GaussianObstacle.ball(mean, rng.uniform(0.02, 0.08), rng.uniform(0.002, 0.02)))
            continue
        root = rng.normal(size=(3, 3)) * 0.012
        covariance = tuple(map(tuple, root @ root.T + 1e-6 * np.eye(3)))
        found.append(GaussianObstacle(mean, tuple(rng.uniform(0.02, 0.08, 3)), covariance, rng.uniform(-3, 3)))
    return found


def segments_of(seed, count=40):
    rng = np.random.default_rng(seed)
    for _ in range(count):
        start = rng.uniform(-0.3, 0.3, 4)
        yield start, start + rng.normal(size=4) * rng.choice([0.0, 0.02, 0.08])


def keep_out_m(obstacle, robot_m, options):
    """Distance to the mean of a ball at which its risk is delta; the step size is not part of the robot."""
    return gaussian_test([obstacle], robot_m - options.delta_p_m / 2, options).band_m[0, 1]


def answer_by_definition(obstacles, options, start, end):
    """Test pose by pose with ``risk`` and the mean shapes, without code of the segment test."""
    pieces = math.ceil(np.linalg.norm((end - start)[:3]) / STEP_M - 1e-9)
    points = start[:3] + np.linspace(0, 1, pieces + 1)[:, None] * (end - start)[:3]
    radius = ROBOT_M + STEP_M / 2
    arrays = obstacle_arrays(obstacles, radius, options.sigma_level if options.method == "bounding_volume" else 0.0)
    method, count = METHODS.index(options.method), len(obstacles)
    w = np.einsum("nij,pnj->pni", arrays.map, points[:, None] - arrays.mean_m)
    p = np.array([[risk(method, False, tuple(at[n]), tuple(arrays.spread[n])) for n in range(count)] for at in w])
    if options.method == "exact":  # decision 14; the bounds are 1 there already
        inside = [np.linalg.norm(_unit_frame(obstacle, points, radius), axis=1) <= 1 for obstacle in obstacles]
        p = np.where(np.stack(inside, axis=1), 1.0, p)
    if options.joint_risk == "noisy_or":
        return bool((1 - np.prod(1 - p, axis=1) <= options.delta).all())
    return bool((p <= options.delta / (count if options.joint_risk == "boole" else 1)).all())


def _unit_frame(obstacle, points, radius):
    cos, sin = math.cos(obstacle.yaw_rad), math.sin(obstacle.yaw_rad)
    local = (points - obstacle.mean_m) @ np.array([[cos, -sin, 0], [sin, cos, 0], [0, 0, 1]])
    return local / (np.asarray(obstacle.semi_axes_m) + radius)


@pytest.mark.parametrize("joint_risk", JOINT_RISKS)
@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("cull", [True, False])
@pytest.mark.parametrize("isotropic", [True, False])
def test_segments_follow_the_probabilities_of_their_poses(method, joint_risk, cull, isotropic):
    options = GaussianCheckSettings(method, joint_risk=joint_risk, cull=cull, delta_p_m=STEP_M)
    answers = []
    for seed in range(5):
        obstacles = obstacles_of(seed, isotropic=isotropic)
        test = gaussian_test(obstacles, ROBOT_M, options)
        for start, end in segments_of(seed):
            answers.append(segment_passes(test, start, end))
            assert answers[-1] == answer_by_definition(obstacles, options, start, end)
            assert answers[-1] == segment_passes(test, end, start)
    assert 0.1 < np.mean(answers) < 0.95  # both answers occur


@pytest.mark.parametrize("joint_risk", JOINT_RISKS)
def test_numeric_search_and_closed_form_give_the_same_answers(joint_risk):
    for seed in range(5):
        obstacles = obstacles_of(seed, isotropic=True)
        tests = [
            gaussian_test(
                obstacles,
                ROBOT_M,
                GaussianCheckSettings("max_probability", joint_risk=joint_risk, cull=cull, numeric_search=numeric),
            )
            for cull, numeric in itertools.product((True, False), (True, False))
        ]
        for start, end in segments_of(seed + 100):
            assert len({segment_passes(test, start, end) for test in tests}) == 1


@settings(deadline=None, max_examples=60)
@given(
    st.integers(0, 10**6),
    st.sampled_from(METHODS),
    st.sampled_from(JOINT_RISKS),
    st.floats(1e-4, 0.2),
    st.floats(1.0, 2.4),
    st.floats(0.0, 0.02),
)
def test_smaller_delta_or_larger_robot_never_accepts_more(seed, method, joint_risk, delta, factor, more):
    obstacles = obstacles_of(seed)
    loose = GaussianCheckSettings(method, delta * factor, joint_risk)
    tight = GaussianCheckSettings(method, delta, joint_risk, sigma_level=3.0 * factor)
    tests = [
        gaussian_test(obstacles, ROBOT_M, loose),
        gaussian_test(obstacles, ROBOT_M, tight),
        gaussian_test(obstacles, ROBOT_M + more, loose),
    ]
    for start, end in segments_of(seed, 10):
        first, tighter, larger = (segment_passes(test, start, end) for test in tests)
        assert first or not tighter
        assert first or not larger


@settings(deadline=None, max_examples=60)
@given(
    st.sampled_from(("chance_constraint", "bounding_volume", "exact")),
    st.floats(0.02, 0.1),
    st.floats(0.001, 0.02),
    st.floats(0.0, 0.02),
)
def test_more_noise_requires_more_distance(method, radius, sigma, more):
    options = GaussianCheckSettings(method)
    distances = [
        keep_out_m(GaussianObstacle.ball((0, 0, 0), radius, value), ROBOT_M, options) for value in (sigma, sigma + more)
    ]
    assert radius + ROBOT_M <= distances[0] <= distances[1] + 1e-12


def test_distances_to_a_ball_are_those_of_the_literature():
    """methods.md, beyond R in sigma at delta = 0.05: exact 1.24, Zhu 1.645, Park 2.74 (4.1 at a fifth), Kamel 3."""
    found = {
        method: (keep_out_m(GaussianObstacle.ball((0, 0, 0), 0.1, 0.05), 0.0, GaussianCheckSettings(method)) - 0.1)
        / 0.05
        for method in METHODS
    }
    expected = {"exact": 1.24, "chance_constraint": 1.645, "max_probability": 2.74, "bounding_volume": 3.0}
    assert found == pytest.approx(expected, abs=5e-3)
    thin = GaussianObstacle.ball((0, 0, 0), 0.1, 0.01)
    assert (keep_out_m(thin, 0.0, GaussianCheckSettings("max_probability")) - 0.1) / 0.01 == pytest.approx(
        4.14, abs=0.01
    )


def test_boole_is_more_conservative_than_delta_each():
    obstacles = obstacles_of(3, count=8, isotropic=True)
    each, boole = (
        gaussian_test(obstacles, ROBOT_M, GaussianCheckSettings(joint_risk=kind)) for kind in ("each", "boole")
    )
    assert (boole.band_m > each.band_m).all()


def test_empty_scenes_accept_every_segment():
    for joint_risk in JOINT_RISKS:
        test = gaussian_test([], ROBOT_M, GaussianCheckSettings(joint_risk=joint_risk))
        assert segment_passes(test, np.zeros(4), np.ones(4))


@pytest.mark.parametrize("method", METHODS)
def test_search_keeps_its_distance_and_culling_changes_nothing(method):
    obstacle = GaussianObstacle.ball((0.0, 0.0, 0.0), 0.06, 0.005)
    bounds = np.array([-0.3, -0.3, -0.05, -0.1]), np.array([0.3, 0.3, 0.05, 0.1])
    ends = np.array([-0.25, 0.0, 0.0, 0.0]), np.array([0.25, 0.0, 0.0, 0.0])
    paths = []
    for cull in (True, False):
        options = GaussianCheckSettings(method, delta_p_m=STEP_M, cull=cull)
        problem = search_problem(gaussian_test([obstacle], ROBOT_M, options), line_cost("root"), *bounds)
        tree = grow_tree(problem, *ends, 500, seed=1)
        paths.append(tree.path())
    assert np.array_equal(*paths)
    dense = np.concatenate([a + np.linspace(0, 1, 200)[:, None] * (b - a) for a, b in itertools.pairwise(paths[0])])
    # tested poses include half a step, so that poses in between keep the distance without it
    kept = np.linalg.norm(dense[:, :3], axis=1).min()
    assert kept >= keep_out_m(obstacle, ROBOT_M, GaussianCheckSettings(method)) - 1e-9


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"method": "park"}, "method"),
        ({"joint_risk": "sum"}, "joint_risk"),
        ({"delta": 0.5}, "delta"),
        ({"sigma_level": -1.0}, "sigma_level"),
        ({"delta_p_m": 0.0}, "delta_p_m"),
    ],
)
def test_impossible_settings_are_refused(change, message):
    with pytest.raises(SettingsError, match=message):
        GaussianCheckSettings(**change)


def test_negative_robot_radius_is_refused():
    with pytest.raises(SettingsError, match="robot_radius_m"):
        gaussian_test(obstacles_of(0), -0.05, GaussianCheckSettings())
