"""Settings that several steps of one run share: stated once in the run's configuration, used by all of them."""

from collections.abc import Mapping
from typing import Any

from deltasafe import presets

__all__ = ["conflicting_deltas", "planning_delta"]

_PRESET = presets.active()
_SOURCES = {
    "planned_motions": ("motion", "delta"),
    "calibration_report": ("calibration", "planning_delta"),
}


def planning_delta(run_config: Mapping[str, Any]) -> float:
    """The delta that the motions of a run are planned with; report, gate, overview and checks refer to it.

    It is the delta of ``planned_motions`` if the run configures one, else ``planning_delta`` of
    ``calibration_report``, else the preset's.
    """
    given = _given(run_config)
    return next((given[step] for step in _SOURCES if step in given), _PRESET.motion.delta)


def conflicting_deltas(run_config: Mapping[str, Any]) -> str:
    """One sentence if the calibration report would refer to another delta than the motions use; else empty."""
    given = _given(run_config)
    reported, planned = given.get("calibration_report"), given.get("planned_motions", _PRESET.motion.delta)
    if reported is None or reported == planned:
        return ""
    return (
        f"calibration_report: planning_delta is {reported:g}, but planned_motions plans with delta {planned:g}; "
        "set motion.delta of planned_motions alone, the report follows it"
    )


def _given(run_config: Mapping[str, Any]) -> dict[str, float]:
    given = {}
    for step, (group, name) in _SOURCES.items():
        value = run_config.get("ops", {}).get(step, {}).get("config", {}).get(group, {}).get(name)
        if value is not None:
            given[step] = float(value)
    return given
