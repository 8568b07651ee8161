"""Scenes and body of the planner study."""

import math

import numpy as np
import pytest

from deltasafe.errors import SettingsError
from deltasafe.planning import DistanceField, body_clearance_m, segment_test
from deltasafe.scene import Sphere, grid_from_shapes
from deltasafe.studies.baselines import GaussianCheckSettings, enclosing_obstacle, gaussian_test
from deltasafe.studies.planner.scenes import (
    GOAL,
    HIGHEST_POSE,
    LOWEST_POSE,
    START,
    WORKSPACE_M,
    EllipticDisc,
    cluttered_scene,
    crowded_scene,
    simple_scene,
)


@pytest.mark.parametrize(("scene", "count"), [(simple_scene(), 3), (cluttered_scene(), 8)], ids=lambda v: str(v)[:20])
def test_start_and_goal_are_free_for_the_most_conservative_method(scene, count):
    assert len(scene.shapes) == count
    robot_m = EllipticDisc().disc_radius_m + 0.0005
    options = GaussianCheckSettings("max_probability")
    for shape in scene.shapes:
        obstacle = enclosing_obstacle(shape, 0.025)
        reach_m = max(obstacle.semi_axes_m)
        ball = enclosing_obstacle(Sphere(shape.center_m, reach_m), 0.025)
        needed = gaussian_test([ball], robot_m, options).band_m[0, 1]
        for pose in (START, GOAL):
            assert math.dist(shape.center_m, pose[:3]) > needed


def test_disc_stays_inside_the_workspace_between_the_bounds():
    disc = EllipticDisc()
    for low, high, first, last in zip(LOWEST_POSE, HIGHEST_POSE, *WORKSPACE_M, strict=False):
        assert first < low - disc.disc_radius_m
        assert high + disc.disc_radius_m < last


def test_crowded_scenes_are_nested_and_leave_the_ends_free():
    small, large = crowded_scene(5, 3), crowded_scene(40, 3)
    assert large.shapes[:5] == small.shapes
    assert crowded_scene(5, 4).shapes != small.shapes
    for shape in large.shapes:
        assert min(math.dist(shape.center_m, pose[:3]) for pose in (START, GOAL)) > 0.15 + shape.radius_m
        assert (np.abs(np.array(shape.center_m) - (0.5, 0.5, 0.25)) <= (0.47, 0.47, 0.22)).all()
    with pytest.raises(SettingsError, match="at least one"):
        crowded_scene(0, 0)


def test_disc_has_no_shaft():
    """A sphere straight above the disc is free, a sphere at the height of the disc is not."""
    grid = grid_from_shapes([Sphere((0.15, 0.15, 0.2), 0.02)], 0.0, (0, 0, 0), (0.3, 0.3, 0.25), 0.005)
    field, disc = DistanceField.build(grid, 0.05), EllipticDisc()
    below, beside = np.array([[0.15, 0.15, 0.1, 0.3]]), np.array([[0.15, 0.15, 0.19, 0.3]])
    test = segment_test(field, disc, 0.001)
    assert body_clearance_m(test, below)[0] > 0.05
    assert body_clearance_m(test, beside)[0] <= 0


def test_samples_are_uniform_in_the_enlarged_disc():
    disc, margin_m = EllipticDisc(), 0.005
    points = disc.samples(margin_m, 20_000, 0)
    assert points.shape == (20_000, 3)
    assert disc.distance_m(points).max() <= margin_m
    assert np.abs(points[:, 2]).max() <= 0.001 + margin_m
    volume = math.pi * 0.04 * 0.02 * 0.002  # the disc's fraction of the samples equals its fraction of the volume
    box = np.prod(2 * (np.array([0.04, 0.02, 0.001]) + margin_m))
    rng = np.random.default_rng(1)
    drawn = (2 * rng.random((200_000, 3)) - 1) * (np.array([0.04, 0.02, 0.001]) + margin_m)
    enlarged = box * (disc.distance_m(drawn) <= margin_m).mean()
    assert (disc.distance_m(points) == 0).mean() == pytest.approx(volume / enlarged, rel=0.1)


@pytest.mark.parametrize("change", [{"thickness_m": 0.0}, {"semi_axis_x_m": math.nan}])
def test_impossible_discs_are_refused(change):
    with pytest.raises(SettingsError, match=next(iter(change))):
        EllipticDisc(**change)
    with pytest.raises(SettingsError, match="samples need"):
        EllipticDisc().samples(-0.1, 10, 0)
