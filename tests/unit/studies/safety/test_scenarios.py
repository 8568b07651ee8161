"""Scenarios are a pure function of settings and number; obstacles are fitted to the predicted hand."""

import dataclasses
import pathlib

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from deltasafe.errors import SettingsError
from deltasafe.scene import LoggedScene
from deltasafe.studies.safety.camera_noise import expose, photograph_again
from deltasafe.studies.safety.obstacle_fit import MIN_SIGMA_M, fit_obstacles
from deltasafe.studies.safety.scenarios import draw_scenario, draw_task, true_mask
from deltasafe.studies.safety.settings import METHODS, CameraSettings, SafetyStudySettings, TaskSettings

SCENE = LoggedScene.load(pathlib.Path(__file__).parents[4] / "datasets" / "scenes" / "scene_003")
SETTINGS = SafetyStudySettings()


def test_scenario_is_a_function_of_settings_and_number():
    first, again, other = (draw_scenario(SETTINGS, 20, SCENE, number) for number in (3, 3, 23))
    np.testing.assert_array_equal(first.rgb, again.rgb)
    assert dataclasses.replace(first, rgb=again.rgb) == again
    assert first.scene == other.scene == 3
    assert first.task != other.task
    assert (first.rgb != other.rgb).any()
    assert first.arm_seed != other.arm_seed
    elsewhere = draw_scenario(dataclasses.replace(SETTINGS, seed=1), 20, SCENE, 3)
    assert elsewhere.task != first.task


@given(st.integers(1, 5), st.integers(0, 400))
def test_locate_inverts_the_numbering_of_trials(compared_every, trial):
    settings = dataclasses.replace(SETTINGS, compared_every=compared_every)
    count, found = 0, None
    for scenario in range(trial + 1):
        n_trials = len(settings.trials_of(scenario))
        if trial < count + n_trials:
            found = scenario, trial - count
            break
        count += n_trials
    assert settings.locate(trial) == found


def test_ours_runs_in_every_scenario_and_the_others_in_some():
    assert tuple(dict(SETTINGS.trials_of(0))) == METHODS
    assert SETTINGS.trials_of(1) == SETTINGS.trials_of(4) == tuple(("ours", delta) for delta in SETTINGS.deltas)
    assert SETTINGS.trials_of(5) == SETTINGS.trials_of(0)
    # the bounding volume does not depend on delta; running it again would count the same motion twice
    assert [delta for name, delta in SETTINGS.trials_of(0) if name == "bounding_volume"] == [0.05]
    counts = [len(SETTINGS.trials_of(scenario)) for scenario in range(10)]
    assert np.mean(counts) == SETTINGS.trials_per_scenario
    alone = dataclasses.replace(SETTINGS, compared=())
    assert alone.trials_of(0) == alone.trials_of(1) == tuple(("ours", delta) for delta in alone.deltas)
    assert alone.locate(7) == (2, 1)


def test_tasks_pass_the_hand_and_their_ends_are_clear_of_it():
    rng, settings = np.random.default_rng(0), TaskSettings()
    hand = SCENE.true_mesh()[0].astype(float)
    for _ in range(8):
        start, goal = draw_task(settings, SCENE, rng)
        ends = np.array([start.as_array(), goal.as_array()])
        for end in ends:
            assert np.hypot(*(hand[:, :2] - end[:2]).T).min() >= settings.clearance_m
            uv, _ = SCENE.camera.project(end[None, :3])
            assert (uv > 30).all()
            assert (uv < (SCENE.camera.width - 30, SCENE.camera.height - 30)).all()
        assert np.linalg.norm(np.diff(ends[:, :2], axis=0)) >= settings.min_distance_m
        line = ends[0, :2] + np.linspace(0, 1, 400)[:, None] * (ends[1] - ends[0])[:2]
        assert np.hypot(*(hand[:, None, :2] - line).T).min() <= settings.near_hand_m
        assert ((ends[:, 2] >= 0.03) & (ends[:, 2] <= 0.05)).all()
        assert (np.abs(ends[:, 3]) <= 0.8).all()
    assert draw_task(TaskSettings(clearance_m=0.5), SCENE, rng) is None


def test_camera_noise_has_the_requested_spread():
    gray = np.full((200, 300, 3), 100, np.uint8)
    still = CameraSettings(0.0, 0.0, 2.0, 4.0, (100, 100))
    noisy = expose(gray, still, np.random.default_rng(0)).astype(float)
    assert noisy.mean() == pytest.approx(100, abs=0.1)
    # the last term is the variance of rounding
    assert noisy.std() == pytest.approx(np.sqrt(2.0**2 + 4.0**2 * 100 / 255 + 1 / 12), rel=0.02)
    compressed = photograph_again(gray, still, np.random.default_rng(0)).astype(float)
    assert 0 < np.abs(compressed - noisy).mean() < noisy.std()
    quiet = CameraSettings(0.3, 0.05, 0.0, 0.0, (100, 100))
    levels = [expose(gray[:8, :8], quiet, np.random.default_rng(n)).mean(axis=(0, 1)) for n in range(200)]
    stops = np.log2(np.array(levels)[:, 1] / 100)
    assert stops.std() == pytest.approx(0.3, rel=0.2)
    assert (np.array(levels)[:, 0] / np.array(levels)[:, 1]).std() == pytest.approx(0.05, rel=0.25)


def blurred_truth(sigma_px):
    import cv2

    return cv2.GaussianBlur(true_mask(SCENE).astype(np.float32), (0, 0), sigma_px)


def test_ellipsoids_contain_the_hand():
    camera, height_m = SCENE.camera, SCENE.hand_height_m
    obstacles = fit_obstacles(blurred_truth(3.0), camera, SCENE.table_z_m, height_m, 8, 0)
    assert 4 <= len(obstacles) <= 8
    rows, columns = np.nonzero(true_mask(SCENE)[::3, ::3])
    pixels = np.column_stack([3 * columns + 0.5, 3 * rows + 0.5])
    for z_m in (SCENE.table_z_m, SCENE.table_z_m + height_m / 2, SCENE.table_z_m + height_m):
        inside = np.zeros(len(pixels), bool)
        points = camera.pixel_to_plane(pixels, z_m)
        for one in obstacles:
            cos, sin = np.cos(one.yaw_rad), np.sin(one.yaw_rad)
            local = (points - one.mean_m) @ np.array([[cos, -sin, 0], [sin, cos, 0], [0, 0, 1]])
            inside |= ((local / one.semi_axes_m) ** 2).sum(axis=1) <= 1 + 1e-6
        # only every second pixel was fitted; parts of the pixels in between may lie outside
        assert inside.mean() > 0.999


def test_sigma_is_half_the_width_of_the_border():
    # a Gaussian blur of s pixels falls from 0.5 to 0.05 over 1.645 s
    pixel_m = (SCENE.camera.position_m[2] - SCENE.table_z_m) / SCENE.camera.fx
    sharp, soft = (
        [
            np.sqrt(one.covariance_m2[0][0])
            for one in fit_obstacles(blurred_truth(sigma_px), SCENE.camera, 0.0, SCENE.hand_height_m, 4, 0)
        ]
        for sigma_px in (1.0, 8.0)
    )
    assert sharp == pytest.approx([MIN_SIGMA_M] * len(sharp))
    assert np.median(soft) == pytest.approx(1.645 * 8.0 * pixel_m / 2, rel=0.25)


def test_no_obstacle_is_fitted_below_one_half():
    assert fit_obstacles(0.9 * 0.5 * blurred_truth(2.0), SCENE.camera, 0.0, 0.06, 8, 0) == []


def test_impossible_settings_are_refused():
    for change in (
        {"deltas": ()},
        {"deltas": (0.05, 0.01)},
        {"deltas": (0.01, 0.6)},
        {"compared": ("ours",)},
        {"compared": ("top_speed", "top_speed")},
        {"n_executions": 0},
        {"compared_every": 0},
        {"n_films": -1},
    ):
        with pytest.raises(SettingsError):
            dataclasses.replace(SETTINGS, **change)
    with pytest.raises(SettingsError, match="jpeg_quality"):
        CameraSettings(jpeg_quality=(90, 60))
    with pytest.raises(SettingsError, match="z_range_m"):
        TaskSettings(z_range_m=(0.05, 0.03))
