"""Settings of one step that other steps of the same run use as well."""

import dataclasses
from collections.abc import Mapping
from typing import Any

from deltasafe import presets
from deltasafe.perception.settings import GateThresholds

_PRESET = presets.active()
_SOURCES = {
    "planned_motions": ("motion", "delta"),
    "calibration_report": ("calibration", "planning_delta"),
}


def planning_delta(run_config: Mapping[str, Any]) -> float:
    """Return the delta of planning in a run, which report, gate, overview and checks use as well.

    It is the delta of ``planned_motions``, else ``planning_delta`` of ``calibration_report``, else that of the preset.
    """
    configured = _configured(run_config)
    return next((configured[step] for step in _SOURCES if step in configured), _PRESET.motion.delta)


def conflicting_deltas(run_config: Mapping[str, Any]) -> str:
    """Return an error message if the calibration report would use another delta than planning; else empty."""
    configured = _configured(run_config)
    reported = configured.get("calibration_report")
    planned = configured.get("planned_motions", _PRESET.motion.delta)
    if reported is None or reported == planned:
        return ""
    return (
        f"calibration_report: planning_delta is {reported:g}, but planned_motions plans with delta {planned:g}; "
        "set only motion.delta of planned_motions, which the report uses as well"
    )


def gate_thresholds(
    run_config: Mapping[str, Any], configured: GateThresholds, of_dataset: GateThresholds | None
) -> GateThresholds:
    """Return the thresholds of the gate: what the run gives explicitly, else the data set, else ``configured``."""
    given = run_config.get("ops", {}).get("calibration_report_may_be_frozen", {}).get("config", {})
    return configured if of_dataset is None else dataclasses.replace(of_dataset, **given)


def _configured(run_config: Mapping[str, Any]) -> dict[str, float]:
    configured = {}
    for step, (group, name) in _SOURCES.items():
        value = run_config.get("ops", {}).get(step, {}).get("config", {}).get(group, {}).get(name)
        if value is not None:
            configured[step] = float(value)
    return configured
