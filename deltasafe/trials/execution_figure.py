"""Figure of an execution over time: distance to the true hand, tracking error with its bound, speed."""

import numpy as np
from matplotlib.figure import Figure

from deltasafe.execution.recording import Execution
from deltasafe.planning import MotionSettings

_TOOL, _ARM, _BOUND, _ERROR = "#1f6fb2", "#8a8d91", "#c8452d", "#1f6fb2"


def execution_figure(execution: Execution, settings: MotionSettings, title: str = "", thing: str = "hand") -> Figure:
    """Return three panels over time; approach and retreat are shaded.

    Args:
        execution: the recording.
        settings: of the motion; the bound is drawn as gamma(max(v, v_min)).
        title: above the figure, usually the scene.
        thing: display name of the obstacle.
    """
    figure = Figure(figsize=(8, 7), layout="constrained")
    distance, error, speed = figure.subplots(3, 1, sharex=True)
    time_s = execution.time_s
    if execution.beside_hand:
        distance.plot(time_s, execution.tool_to_hand_m * 1e3, color=_TOOL, label="tool")
    else:
        distance.plot([], [], color="none", label=f"not judged: the scene has no true {thing}")
        distance.set_yticks([])
    if np.isfinite(execution.arm_to_hand_m).any():
        distance.plot(time_s, execution.arm_to_hand_m * 1e3, color=_ARM, label="links of the arm")
    touched = execution.contacts > 0
    if touched.any():
        distance.plot(time_s[touched], np.zeros(touched.sum()), "x", color=_BOUND, label="contact")
    distance.set_ylabel(f"distance to\nthe {thing} [mm]")
    distance.set_ylim(bottom=0 if not touched.any() else -8)
    v_min_mps = settings.v_min_mps
    allowed = settings.tracking.error_m(np.maximum(execution.reference_speed_mps, v_min_mps)) * 1e3
    error.plot(time_s, execution.workspace_error_m * 1e3, color=_ERROR, label="executed")
    error.plot(time_s, allowed, color=_BOUND, linestyle="--", label=rf"bound $\gamma(\max(v, {v_min_mps:g}))$")
    error.set_yscale("log")
    error.set_ylim(bottom=1e-2)
    error.set_ylabel("workspace error [mm]")
    measured = np.gradient(execution.tool_positions_m, time_s, axis=0) if len(time_s) > 1 else np.zeros((1, 3))
    speed.plot(time_s, np.linalg.norm(measured, axis=1) * 1e3, color=_TOOL, label="executed")
    speed.plot(
        time_s, execution.reference_speed_mps * 1e3, color="black", linestyle=":", linewidth=1, label="reference"
    )
    speed.set_ylabel("speed [mm/s]")
    speed.set_ylim(bottom=0)
    speed.set_xlabel("time [s]")
    judged = time_s[execution.judged]
    for panel in (distance, error, speed):
        panel.axvspan(time_s[0], judged[0], color="black", alpha=0.06, linewidth=0)
        panel.axvspan(judged[-1], time_s[-1], color="black", alpha=0.06, linewidth=0)
        panel.grid(alpha=0.3)
        panel.legend(loc="lower right", bbox_to_anchor=(1, 0.98), frameon=False, fontsize="small", ncols=3)
        panel.margins(x=0)
    if execution.stop_reason:
        distance.set_title(
            f"stopped by the monitor: {execution.stop_reason}", color=_BOUND, fontsize="small", loc="left"
        )
    if title:
        figure.suptitle(title)
    return figure
