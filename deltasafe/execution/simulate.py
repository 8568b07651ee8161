"""Execution of a trajectory: approach, motion and retreat, monitored at every control step."""

import contextlib
import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from deltasafe.compute.progress import Progress, silent
from deltasafe.errors import SettingsError
from deltasafe.execution.arm import Arm, ArmState, measurement_fault
from deltasafe.execution.arm_models import ArmSettings
from deltasafe.execution.distance import MeshDistance
from deltasafe.execution.impedance import TaskReference, impedance_torques
from deltasafe.execution.monitor import Monitor, MonitorLimits
from deltasafe.execution.recording import COLUMNS, PHASES, Execution, rotation_matrices
from deltasafe.execution.reference import Reference
from deltasafe.execution.settings import ExecutionSettings
from deltasafe.execution.workcell import Workcell
from deltasafe.geometry import Trajectory
from deltasafe.planning.body import ToolBody

Array = NDArray[np.float64]

_STOP_S = 0.5
"""Duration of the recording after a stop."""
_SLACK_M = 5e-4
"""Larger than the error of a distance that comes from an iteration."""


def execute(
    trajectory: Trajectory,
    cell: Workcell,
    settings: ExecutionSettings,
    seed: int,
    *,
    limits: MonitorLimits | None = None,
    unsafe_below_m: float | None = None,
    progress: Progress = silent,
) -> Execution:
    """Execute a trajectory on a simulated arm and record it. A pure function of its arguments.

    Args:
        trajectory: the reference at any rate; the controller interpolates it.
        cell: tool, hand and table.
        settings: among others, which arm executes.
        seed: draws the arm's friction and torque sensor gains.
        limits: enforced by the monitor; the paper's tracking bound alone if None.
        unsafe_below_m: height below which no link of the arm may come (decision 12), usually the top of the field.

    Raises:
        PlanningError: the arm cannot follow (out of reach, a joint range or speed exceeded, a link too low), or its
            first measurement is not finite.
        SettingsError: ``unsafe_below_m`` is not finite.
        DataError: the arm's URDF file is unusable.
        StaleImageError: the image that the motion was planned from is too old or from the future, or the camera is
            frozen or unusable.
    """
    limits = limits or MonitorLimits()
    if limits.camera is not None:
        limits.camera.require_live(settings.max_look_age_s, settings.max_frame_age_s)
    distance = None if cell.mesh is None else MeshDistance(*cell.mesh)
    with _arm_of(cell, settings.arm, seed) as arm:
        reference = Reference(trajectory, settings, arm, unsafe_below_m)
        recorder = _Recorder(reference, arm, cell.body, distance)
        monitor = Monitor(limits, settings, arm.limits, cell.body)
        reason = _drive(arm, reference, recorder, monitor, settings, progress)
        return recorder.finish(seed, reason, settings.arm)


def _arm_of(cell: Workcell, settings: ArmSettings, seed: int) -> contextlib.AbstractContextManager[Arm]:
    if cell.make_arm is not None:
        return cell.make_arm(seed)
    from deltasafe.execution.simulated_arm import SimulatedArm  # loads PyBullet

    return SimulatedArm(cell, seed, settings)


def _drive(
    arm: Arm,
    reference: Reference,
    recorder: "_Recorder",
    monitor: Monitor,
    settings: ExecutionSettings,
    progress: Progress,
) -> str:
    """Run the control loop; return why the monitor stopped the arm, or an empty string.

    While a measurement is not finite, controller and recorder use the last finite one, until the brakes have closed.
    """
    period, total = arm.control_period_s, len(reference.poses)
    every = max(1, round(1 / (settings.record_rate_hz * period)))
    torque_limit = np.array(arm.limits.torque_nm)
    arm.reset(reference.joints[0])
    reason, hold, last, contacts = "", None, total - 1, 0
    brake_at, index = math.inf, 0
    state, torques = reference.start_state, np.zeros_like(torque_limit)
    while index <= last:
        measured = arm.state()
        state = state if measurement_fault(measured) else measured
        target, controller_fault = hold or reference.target(index), ""
        try:
            torques = impedance_torques(state, arm.dynamics(state), target, settings.impedance)
        except (SettingsError, np.linalg.LinAlgError) as error:
            controller_fault = f"the controller has no torques: {error}"
        torques = np.minimum(np.maximum(torques, -torque_limit), torque_limit)
        if index % every == 0 or index == last:
            recorder.add(index, state, torques, contacts, bool(reason))
            progress(index, total, PHASES[reference.phase[index]])
            contacts = 0
        if not reason:
            reason = monitor.violation(index * period, measured, target, reference.is_planned(index))
            reason = reason or controller_fault
            if reason:
                hold = _hold(state)
                last = min(last, index + round(_STOP_S / period))
                brake_at = index + round(settings.brake_delay_s / period)
        if index >= brake_at:
            arm.brake()
        contacts += arm.step(torques)
        index += 1
    return reason


def _hold(state: ArmState) -> TaskReference:
    """Reference at rest at a measured state."""
    return TaskReference(
        state.tool_position_m,
        state.tool_quaternion,
        np.zeros(6),
        np.zeros(6),
        state.joint_positions_rad,
        np.zeros_like(state.joint_velocities_radps),
    )


class _Recorder:
    """Collects one row per recorded sample."""

    def __init__(self, reference: Reference, arm: Arm, body: ToolBody, distance: MeshDistance | None) -> None:
        self._reference, self._arm, self._body, self._distance = reference, arm, body, distance
        self._rows: list[tuple[object, ...]] = []
        self._stopped_at: int | None = None
        self._previous: tuple[ArmState, Array, float, float] | None = None

    def add(self, index: int, state: ArmState, torques: Array, contacts: int, stopped: bool) -> None:
        reference = self._reference
        if stopped and self._stopped_at is None:
            self._stopped_at = index
        referred = index if self._stopped_at is None else self._stopped_at
        self._rows.append(
            (
                index * reference.period_s,
                PHASES.index("stopped") if stopped else int(reference.phase[index]),
                reference.poses[referred],
                np.zeros(4) if stopped else reference.velocities[index],
                state.tool_position_m,
                _turned_about_z(state.tool_quaternion, -reference.half_turns_rad),
                state.joint_positions_rad,
                torques,
                *self._to_hand_m(state),
                contacts,
            )
        )

    def finish(self, seed: int, stop_reason: str, arm: ArmSettings) -> Execution:
        columns = dict(zip(COLUMNS, zip(*self._rows, strict=True), strict=True))
        arrays: dict[str, Any] = {name: np.array(column, dtype=COLUMNS[name][0]) for name, column in columns.items()}
        return Execution(body=self._body, seed=seed, stop_reason=stop_reason, arm=arm, **arrays)

    def _to_hand_m(self, state: ArmState) -> tuple[float, float]:
        """Distances of tool and links to the hand; the previous distances and the motion since bound the search."""
        if self._distance is None:
            return math.inf, math.inf
        rotation, points = rotation_matrices(state.tool_quaternion), self._arm.link_points_m()
        if self._previous is not None and not np.isfinite(points).all():
            points = self._previous[1]
        max_tool_m = max_arm_m = math.inf
        if self._previous is not None:
            previous, previous_points, tool_m, arm_m = self._previous
            turned = float(np.linalg.norm(rotation - rotation_matrices(previous.tool_quaternion)))
            moved = float(np.linalg.norm(state.tool_position_m - previous.tool_position_m))
            reach_m = max(self._body.shaft_length_m, self._body.rho_max_m) + self._body.thickness_m
            max_tool_m = tool_m + moved + turned * reach_m + _SLACK_M
            if len(points):
                max_arm_m = arm_m + float(np.sqrt(((points - previous_points) ** 2).sum(axis=1).max())) + _SLACK_M
        tool_m = self._distance.to_tool(self._body, state.tool_position_m, rotation, max_tool_m)
        arm_m = self._distance.to_points(points, max_arm_m)
        self._previous = state, points, tool_m, arm_m
        return tool_m, arm_m


def _turned_about_z(quaternion: Array, angle_rad: float) -> Array:
    """Rotate a tool frame about its own z axis."""
    x, y, z, w = quaternion
    s, c = math.sin(angle_rad / 2), math.cos(angle_rad / 2)
    return np.array([x * c + y * s, y * c - x * s, z * c + w * s, w * c - z * s])
