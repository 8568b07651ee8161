"""Tracking study: its motions, its statistics on known distributions, its folders."""

import dataclasses
import json

import numpy as np
import pytest
from hypothesis import given
from hypothesis import settings as hypothesis_settings
from hypothesis import strategies as st

from deltasafe.errors import DataError, PlanningError, SettingsError
from deltasafe.planning.tracking_bound import TrackingBound
from deltasafe.studies.resumable_jobs import Effort
from deltasafe.studies.tracking import TrackingStudy, TrackingStudySettings, run_study, write_report
from deltasafe.studies.tracking.bound import coverage_of, fit_bound, fit_constant, fit_slope
from deltasafe.studies.tracking.test_motions import KINDS, draw_motion
from deltasafe.studies.tracking.tracking_errors import PHASES_OF_SPEED, Tracks, phases_of_speed

SETTINGS = TrackingStudySettings()
SMALL = TrackingStudySettings(
    n_slope_runs=3, n_bound_runs=4, n_held_out_runs=2, runs_per_batch=5, content=0.5, confidence=0.9
)


def synthetic(n_runs, seed, slope_s=0.01, constant_m=2e-4, samples=50):
    """Construct uniformly distributed errors below a line; the largest excess of a run has a known distribution."""
    rng = np.random.default_rng(seed)
    speed = rng.uniform(0, 0.2, (n_runs, samples))
    error = slope_s * speed + constant_m * rng.uniform(0, 1, (n_runs, 1)) * rng.uniform(0, 1, (n_runs, samples))
    return Tracks(
        np.arange(n_runs + 1) * samples,
        error.ravel(),
        speed.ravel(),
        rng.integers(0, 4, n_runs * samples).astype(np.int8),
        np.zeros(n_runs, np.int8),
        np.tile([0.1, 0.5], n_runs)[:n_runs],
        np.ones(n_runs),
    )


@hypothesis_settings(max_examples=60, deadline=None)
@given(st.integers(0, 2**31))
def test_motions_respect_box_speed_and_acceleration(seed):
    motion = draw_motion(SETTINGS, np.random.default_rng(seed))
    poses, velocities = motion.trajectory.poses, motion.trajectory.velocities
    assert (poses[:, :3] >= np.array(SETTINGS.lower_m) - 1e-9).all()
    assert (poses[:, :3] <= np.array(SETTINGS.upper_m) + 1e-9).all()
    np.testing.assert_allclose(velocities[[0, -1]], 0.0, atol=1e-12)
    np.testing.assert_allclose(np.diff(poses, axis=0) * 1e3, (velocities[1:] + velocities[:-1]) / 2, atol=5e-3)
    speed = np.linalg.norm(velocities[:, :3], axis=1)
    assert speed.max() == pytest.approx(motion.speed_mps, abs=1e-3)
    fastest = speed + SETTINGS.body.rho_max_m * np.abs(velocities[:, 3])
    assert np.abs(np.diff(fastest)).max() * 1e3 <= 0.5 * 1.02 + 1e-6
    assert np.abs(velocities[:, 3]).max() <= SETTINGS.yaw_rate_radps + 1e-9
    if KINDS[motion.kind] == "turn":
        assert np.ptp(poses[:, :3], axis=0).max() == 0.0
        assert abs(poses[-1, 3] - poses[0, 3]) > 0.01


def test_all_kinds_and_the_whole_range_of_speed_are_drawn():
    motions = [draw_motion(SETTINGS, np.random.default_rng(seed)) for seed in range(200)]
    assert {motion.kind for motion in motions} == set(range(len(KINDS)))
    assert {motion.braking_mps2 for motion in motions} == set(SETTINGS.accelerations_mps2)
    moving = np.array([motion.speed_mps for motion in motions if motion.speed_mps > 0])
    assert (np.histogram(moving, 4, (0, 0.2))[0] > 15).all()


def test_too_small_boxes_are_refused():
    with pytest.raises(PlanningError, match="fits between"):
        tight = dataclasses.replace(SETTINGS, lower_m=(0, 0, 0.1), upper_m=(0.001, 0.001, 0.101), v_min_mps=0.1)
        for seed in range(5):  # a rotation in place fits anywhere
            draw_motion(tight, np.random.default_rng(seed))


def test_phases_follow_acceleration_and_time_since_braking():
    time_s = np.arange(200) * 0.01
    speed = np.interp(time_s, [0, 0.5, 1.0, 1.4, 2.0], [0, 0.1, 0.1, 0, 0])
    names = [PHASES_OF_SPEED[index] for index in phases_of_speed(time_s, speed)]
    assert [names[k] for k in (20, 70, 120, 150, 195)] == [
        "speeding up", "steady", "braking", "just after braking", "steady"
    ]  # fmt: skip


def test_slope_of_a_line_is_recovered_and_never_negative():
    assert fit_slope(synthetic(300, 0), 0.99) == pytest.approx(0.01, rel=0.05)
    assert fit_slope(synthetic(300, 0, slope_s=-5e-4, constant_m=2e-4), 0.99) == 0.0


def test_constant_is_the_largest_excess():
    tracks = synthetic(300, 1)
    gamma0_m = fit_constant(tracks, 0.01)
    assert gamma0_m == pytest.approx((tracks.error_m - 0.01 * tracks.speed_mps).max())
    assert tracks.excess_m(TrackingBound(gamma0_m, 0.01)).max() == pytest.approx(0.0, abs=1e-12)


def test_wilks_bound_holds_with_its_confidence():
    """With 299 runs the largest excess covers >= 99 % in at least 95 % of all studies, but not in all."""
    kept = 0
    for seed in range(400):
        runs = np.random.default_rng(seed).uniform(0, 1, 299)
        kept += runs.max() >= 0.99
    assert 0.92 <= kept / 400 < 0.99
    assert SETTINGS.min_bound_runs == 299
    assert TrackingStudySettings(content=0.95).min_bound_runs == 59
    assert TrackingStudySettings(confidence=0.99).min_bound_runs == 459


def test_coverage_counts_runs_and_samples():
    bound = fit_bound(synthetic(200, 2), synthetic(600, 3))
    held_out = synthetic(1000, 4)
    whole, *bins = coverage_of(bound, held_out)
    outside = held_out.worst_of_runs(held_out.excess_m(bound)) > 0
    assert whole.runs - whole.runs_within == outside.sum()
    assert whole.run_fraction >= 0.99
    assert 0.98 < whole.runs_lower95 < whole.run_fraction
    speeds = [one for one in bins if one.name.startswith("speed ")]
    assert sum(one.samples for one in speeds) == whole.samples == held_out.error_m.size
    assert sum(one.samples_within for one in speeds) == whole.samples_within
    tight, *_ = coverage_of(TrackingBound(0.0, 0.01), held_out)
    assert tight.runs_within == 0
    raised, *_ = coverage_of(TrackingBound(0.0, 0.05), held_out, min_speed_mps=0.01)
    assert raised.samples_within > coverage_of(TrackingBound(0.0, 0.05), held_out)[0].samples_within


@pytest.fixture(scope="module")
def study(tmp_path_factory):
    folder = tmp_path_factory.mktemp("tracking")
    return folder, run_study(SMALL, folder / "batches")


def test_a_small_study_from_motions_to_folder(study, tmp_path):
    folder, found = study
    assert found.tracks.n_runs == SMALL.n_runs
    assert 0 < found.bound.gamma0_m < 0.005
    assert found.tracks.error_m.max() < 0.005
    figures = write_report(found, tmp_path / "report")
    assert figures["tracking_held_out_runs"] == 2
    assert {file.name for file in (tmp_path / "report").iterdir()} == {"report.md", "tracking.png", "figures.json"}
    found.save(tmp_path / "study")
    again = TrackingStudy.load(tmp_path / "study")
    assert again.figures() == found.figures()
    # a study with another number of runs reuses the batches
    more = run_study(dataclasses.replace(SMALL, n_held_out_runs=3), folder / "batches")
    np.testing.assert_array_equal(more.tracks.part(0, 5).error_m, found.tracks.part(0, 5).error_m)


def test_runs_do_not_depend_on_the_batches(study, tmp_path):
    _, found = study
    other = run_study(dataclasses.replace(SMALL, runs_per_batch=9), tmp_path)
    for field in dataclasses.fields(Tracks):
        np.testing.assert_array_equal(getattr(other.tracks, field.name), getattr(found.tracks, field.name))


def test_damaged_folders_are_refused(study, tmp_path):
    _, found = study
    found.save(tmp_path / "study")
    record = json.loads((tmp_path / "study" / "study.json").read_text())
    record["settings"]["n_held_out_runs"] = 5
    (tmp_path / "study" / "study.json").write_text(json.dumps(record))
    with pytest.raises(DataError, match="9 runs, the settings require 12"):
        TrackingStudy.load(tmp_path / "study")
    (tmp_path / "study" / "tracks.npz").write_bytes(b"nothing")
    with pytest.raises(DataError, match="not readable"):
        TrackingStudy.load(tmp_path / "study")
    (tmp_path / "study" / "study.json").write_text("{}")
    with pytest.raises(DataError, match="format"):
        TrackingStudy.load(tmp_path / "study")


def test_impossible_settings_are_refused():
    for change in (
        {"n_bound_runs": 298},
        {"n_held_out_runs": 0},
        {"content": 1.0},
        {"v_min_mps": 0.3},
        {"accelerations_mps2": ()},
        {"lower_m": (0.0, 0.0)},
        {"upper_m": (-1.0, 1.0, 1.0)},
    ):
        with pytest.raises(SettingsError):
            dataclasses.replace(SETTINGS, **change)
    with pytest.raises(SettingsError, match="different lengths"):
        dataclasses.replace(synthetic(3, 0), error_m=np.zeros(2))
    assert TrackingStudy(SMALL, synthetic(SMALL.n_runs, 0), Effort(1.0, 1.0)).held_out.n_runs == 2
