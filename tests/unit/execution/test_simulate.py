"""The control loop with an in-memory fake arm."""

import json

import numpy as np
import pytest

from deltasafe.errors import DataError, PlanningError, SettingsError
from deltasafe.execution import PHASES, Execution, ExecutionSettings, MonitorLimits, Workcell, execute
from deltasafe.planning.tracking_bound import TrackingBound
from tests.unit.execution.conftest import BODY, quintic
from tests.unit.execution.floating_tool import FloatingTool

START, GOAL = (-0.05, 0.0, 0.12, 0.0), (0.05, 0.02, 0.12, 0.6)
SETTINGS = ExecutionSettings(approach_m=0.02, settle_s=0.1)


def run(hand, trajectory=None, drag=0.0, **options):
    cell = Workcell(BODY, hand, make_arm=lambda seed: FloatingTool(drag_ns_per_m=drag))
    return execute(trajectory or quintic(START, GOAL, 0.8), cell, SETTINGS, 0, **options)


@pytest.fixture(scope="module")
def execution(hand):
    return run(hand)


def test_a_frictionless_tool_follows_the_reference(execution):
    assert execution.completed
    assert execution.workspace_error_m.max() < 1e-4
    np.testing.assert_allclose(execution.tool_positions_m[execution.judged][-1], GOAL[:3], atol=1e-5)


def test_phases_are_in_order_and_only_the_motion_is_evaluated(execution):
    assert (np.diff(execution.phase) >= 0).all()
    assert {PHASES[p] for p in execution.phase} == {"approach", "rest", "motion", "settle", "retreat"}
    assert execution.tool_positions_m[0, 2] == pytest.approx(0.14, abs=1e-6)
    judged = execution.reference_poses[execution.judged]
    np.testing.assert_allclose(judged[0], START, atol=1e-9)
    np.testing.assert_allclose(judged[-1], GOAL, atol=1e-9)


def test_distance_to_the_sphere(execution):
    radial = np.linalg.norm(execution.tool_positions_m - [0, -0.02, 0.03], axis=1) - 0.04
    assert (execution.tool_to_hand_m <= radial).all()
    assert (execution.tool_to_hand_m >= radial - BODY.rho_max_m - 1e-3).all()
    assert np.isinf(execution.arm_to_hand_m).all()


def test_the_monitor_stops_an_arm_that_lags(hand):
    stopped = run(hand, drag=200.0, limits=MonitorLimits(TrackingBound(gamma1_s=0.005)))
    assert not stopped.completed
    assert "workspace error" in stopped.stop_reason
    assert PHASES[stopped.phase[-1]] == "stopped"
    assert stopped.time_s[-1] < run(hand).time_s[-1]
    still = stopped.tool_positions_m[-5:]
    assert np.linalg.norm(still - still[-1], axis=1).max() < 1e-3


def test_a_trajectory_above_the_joint_speeds_is_refused(hand):
    with pytest.raises(PlanningError, match=r"joint 1 would have to turn .* slow the trajectory down"):
        run(hand, quintic(START, (1.0, 0, 0.12, 0), 0.05))


def test_a_recording_is_loaded_as_it_was_saved(execution, tmp_path):
    execution.save(tmp_path / "run")
    again = Execution.load(tmp_path / "run")
    assert again.digest() == execution.digest()
    assert again.body == execution.body


def test_damaged_recordings_are_refused(execution, tmp_path):
    execution.save(tmp_path / "run")
    about = json.loads((tmp_path / "run/execution.json").read_text())
    about["seed"] = 5
    (tmp_path / "run/execution.json").write_text(json.dumps(about))
    with pytest.raises(DataError, match="altered"):
        Execution.load(tmp_path / "run")
    (tmp_path / "run/arrays.npz").write_bytes(b"PK\x03\x04broken")
    with pytest.raises(DataError, match=r"arrays\.npz"):
        Execution.load(tmp_path / "run")
    (tmp_path / "run/arrays.npz").unlink()
    with pytest.raises(DataError, match="missing"):
        Execution.load(tmp_path / "run")


def test_settings_are_validated():
    with pytest.raises(SettingsError, match="record_rate_hz"):
        ExecutionSettings(record_rate_hz=0)
    with pytest.raises(SettingsError, match="monitor_margin_m"):
        ExecutionSettings(monitor_margin_m=-1)
