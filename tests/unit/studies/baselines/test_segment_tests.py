"""The compared methods as tests of segments: against their probabilities pose by pose, and their invariants."""

import itertools
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from deltasafe.errors import SettingsError
from deltasafe.planning import grow_tree, line_cost, search_problem
from deltasafe.planning.collision.segment_query import ask_segment
from deltasafe.studies.baselines import (
    JOINT_RISKS,
    METHODS,
    GaussianCheckSettings,
    GaussianObstacle,
    collision_probability,
    gaussian_test,
    joint_probability,
    keep_out_m,
)

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


def answer_by_definition(obstacles, options, start, end):
    """Pose by pose from ``collision_probability`` and the mean shapes: no code of the segment test."""
    pieces = math.ceil(np.linalg.norm((end - start)[:3]) / STEP_M - 1e-9)
    points = start[:3] + np.linspace(0, 1, pieces + 1)[:, None] * (end - start)[:3]
    radius = ROBOT_M + STEP_M / 2
    p = collision_probability(obstacles, points, radius, options.method, options.sigma_level)
    inside = collision_probability(obstacles, points, radius, "max_probability") >= 1.0
    if options.method == "exact":  # decision 14; the bounds say 1 there by themselves
        local = [np.linalg.norm(_unit_frame(obstacle, points, radius), axis=1) <= 1 for obstacle in obstacles]
        inside = np.stack(local, axis=1)
        p = np.where(inside, 1.0, p)
    if options.joint_risk == "noisy_or":
        return bool((joint_probability(p) <= options.delta).all())
    return bool((p <= options.delta / (len(obstacles) if options.joint_risk == "boole" else 1)).all())


def _unit_frame(obstacle, points, radius):
    cos, sin = math.cos(obstacle.yaw_rad), math.sin(obstacle.yaw_rad)
    local = (points - obstacle.mean_m) @ np.array([[cos, -sin, 0], [sin, cos, 0], [0, 0, 1]])
    return local / (np.asarray(obstacle.semi_axes_m) + radius)


@pytest.mark.parametrize("joint_risk", JOINT_RISKS)
@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("cull", [True, False])
@pytest.mark.parametrize("isotropic", [True, False])
def test_segments_are_judged_by_the_probabilities_of_their_poses(method, joint_risk, cull, isotropic):
    options = GaussianCheckSettings(method, joint_risk=joint_risk, cull=cull, delta_p_m=STEP_M)
    told = []
    for seed in range(5):
        obstacles = obstacles_of(seed, isotropic=isotropic)
        test = gaussian_test(obstacles, ROBOT_M, options)
        for start, end in segments_of(seed):
            told.append(ask_segment(test, start, end))
            assert told[-1] == answer_by_definition(obstacles, options, start, end)
            assert told[-1] == ask_segment(test, end, start)
    assert 0.1 < np.mean(told) < 0.95  # neither all nor nothing


@pytest.mark.parametrize("joint_risk", JOINT_RISKS)
def test_the_numeric_search_and_the_closed_form_answer_alike(joint_risk):
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
            assert len({ask_segment(test, start, end) for test in tests}) == 1


@settings(deadline=None, max_examples=60)
@given(
    st.integers(0, 10**6),
    st.sampled_from(METHODS),
    st.sampled_from(JOINT_RISKS),
    st.floats(1e-4, 0.2),
    st.floats(1.0, 2.4),
    st.floats(0.0, 0.02),
)
def test_smaller_delta_or_larger_robot_never_accepts_what_was_refused(seed, method, joint_risk, delta, factor, more):
    obstacles = obstacles_of(seed)
    loose = GaussianCheckSettings(method, delta * factor, joint_risk)
    tight = GaussianCheckSettings(method, delta, joint_risk, sigma_level=3.0 * factor)
    tests = [
        gaussian_test(obstacles, ROBOT_M, loose),
        gaussian_test(obstacles, ROBOT_M, tight),
        gaussian_test(obstacles, ROBOT_M + more, loose),
    ]
    for start, end in segments_of(seed, 10):
        first, tighter, larger = (ask_segment(test, start, end) for test in tests)
        assert first or not tighter
        assert first or not larger


@settings(deadline=None, max_examples=60)
@given(
    st.sampled_from(("chance_constraint", "bounding_volume", "exact")),
    st.floats(0.02, 0.1),
    st.floats(0.001, 0.02),
    st.floats(0.0, 0.02),
)
def test_more_noise_needs_more_distance(method, radius, sigma, more):
    options = GaussianCheckSettings(method)
    distances = [
        keep_out_m(GaussianObstacle.ball((0, 0, 0), radius, value), ROBOT_M, options) for value in (sigma, sigma + more)
    ]
    assert radius + ROBOT_M <= distances[0] <= distances[1] + 1e-12


def test_distances_kept_from_a_ball_are_those_of_the_literature():
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


def test_no_single_distance_is_named_where_there_is_none():
    flat = GaussianObstacle((0, 0, 0), (0.1, 0.1, 0.05), tuple(map(tuple, 1e-4 * np.eye(3))))
    with pytest.raises(SettingsError, match="ball"):
        keep_out_m(flat, 0.0, GaussianCheckSettings())


def test_boole_takes_more_room_than_delta_each():
    obstacles = obstacles_of(3, count=8, isotropic=True)
    each, boole = (
        gaussian_test(obstacles, ROBOT_M, GaussianCheckSettings(joint_risk=kind)) for kind in ("each", "boole")
    )
    assert (boole.band_m > each.band_m).all()


def test_nothing_is_in_the_way_of_an_empty_scene():
    for joint_risk in JOINT_RISKS:
        test = gaussian_test([], ROBOT_M, GaussianCheckSettings(joint_risk=joint_risk))
        assert ask_segment(test, np.zeros(4), np.ones(4))


@pytest.mark.parametrize("method", METHODS)
def test_a_search_keeps_its_distance_and_culling_changes_nothing(method):
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
    # at tested poses the robot is grown by half a step, so between them it is as far as without
    kept = np.linalg.norm(dense[:, :3], axis=1).min()
    assert kept >= keep_out_m(obstacle, ROBOT_M, GaussianCheckSettings(method)) - 1e-9


@pytest.mark.parametrize(
    ("change", "told"),
    [
        ({"method": "park"}, "method"),
        ({"joint_risk": "sum"}, "joint_risk"),
        ({"delta": 0.5}, "delta"),
        ({"sigma_level": -1.0}, "sigma_level"),
        ({"delta_p_m": 0.0}, "delta_p_m"),
    ],
)
def test_impossible_settings_are_refused(change, told):
    with pytest.raises(SettingsError, match=told):
        GaussianCheckSettings(**change)


def test_a_negative_robot_is_refused():
    with pytest.raises(SettingsError, match="robot_radius_m"):
        gaussian_test(obstacles_of(0), -0.05, GaussianCheckSettings())
