"""One delta per run: report, gate, overview and checks use the delta of planning."""

import pytest

from assets.run_settings import conflicting_deltas, gate_thresholds, planning_delta
from deltasafe.perception.settings import GateThresholds
from deltasafe.presets import PRESETS
from pipelines.automation.launch_check import wrong_settings

PRESET_DELTA = PRESETS["smoke"].motion.delta


def run_config(motion=None, report=None):
    ops = {}
    if motion is not None:
        ops["planned_motions"] = {"config": {"motion": {"delta": motion}}}
    if report is not None:
        ops["calibration_report"] = {"config": {"calibration": {"planning_delta": report}}}
    return {"ops": ops}


@pytest.mark.parametrize(
    ("config", "expected"),
    [
        ({}, PRESET_DELTA),
        (run_config(), PRESET_DELTA),
        (run_config(motion=0.02), 0.02),
        (run_config(report=0.1), 0.1),
        (run_config(motion=0.02, report=0.02), 0.02),
    ],
)
def test_the_delta_of_planning_is_the_delta_of_the_run(config, expected):
    assert planning_delta(config) == expected


def test_a_report_with_another_delta_is_refused_before_the_run():
    assert conflicting_deltas(run_config(motion=0.02, report=0.02)) == ""
    assert conflicting_deltas(run_config(motion=0.02)) == ""
    assert "0.1, but planned_motions plans with delta 0.02" in conflicting_deltas(run_config(motion=0.02, report=0.1))
    assert f"plans with delta {PRESET_DELTA:g}" in wrong_settings(run_config(report=0.1))


def test_thresholds_of_the_gate_are_those_of_the_run_else_of_the_data_set_else_of_the_preset():
    preset, of_dataset = GateThresholds(0.5, 0.5, 0.5), GateThresholds(0.9, 0.8, 0.7)
    given = {"ops": {"calibration_report_may_be_frozen": {"config": {"miou": 0.6}}}}
    assert gate_thresholds({}, preset, None) == preset
    assert gate_thresholds({}, preset, of_dataset) == of_dataset
    assert gate_thresholds(given, GateThresholds(0.5, 0.6, 0.5), of_dataset) == GateThresholds(0.9, 0.6, 0.7)
    assert gate_thresholds(given, GateThresholds(0.5, 0.6, 0.5), None) == GateThresholds(0.5, 0.6, 0.5)


@pytest.mark.parametrize("name", PRESETS)
def test_presets_report_and_plan_with_the_same_delta(name):
    assert PRESETS[name].calibration.planning_delta == PRESETS[name].motion.delta
