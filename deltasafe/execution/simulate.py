"""Executing a trajectory: down onto its start, along it, up again, watched at every step of control."""

import contextlib
import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from deltasafe.compute.progress import Progress, silent
from deltasafe.errors import SettingsError
from deltasafe.execution.arm import Arm, ArmState, measurement_fault
from deltasafe.execution.distance import MeshDistance
from deltasafe.execution.disturbances import Disturbance
from deltasafe.execution.impedance import TaskReference, impedance_torques
from deltasafe.execution.monitor import CameraWatch, Monitor
from deltasafe.execution.recording import COLUMNS, PHASES, Execution
from deltasafe.execution.reference import Reference
from deltasafe.execution.settings import ExecutionSettings
from deltasafe.geometry import Trajectory
from deltasafe.planning.body import ToolBody
from deltasafe.planning.collision.distance_field import DistanceField
from deltasafe.planning.tracking_bound import TrackingBound

__all__ = ["ExecutionSettings", "execute", "iiwa_for"]

Array = NDArray[np.float64]
Mesh = tuple[NDArray[np.floating], NDArray[np.integer]]

_STOP_S = 0.5  # how long a stop is watched
_SLACK_M = 5e-4  # more than what iteration leaves over in a distance


def iiwa_for(
    body: ToolBody, mesh: Mesh | None, table_z_m: float = 0.0, disturbances: Sequence[Disturbance] = ()
) -> Callable[[int], contextlib.AbstractContextManager[Arm]]:
    """What ``execute`` calls with its seed to get a fresh simulated iiwa 14 beside a table and a hand.

    Args:
        disturbances: what happens to the arm that neither its controller nor its model is told.
    """

    def make(seed: int) -> contextlib.AbstractContextManager[Arm]:
        from deltasafe.execution.iiwa import IiwaArm

        return IiwaArm(body, mesh, table_z_m=table_z_m, seed=seed, disturbances=disturbances)

    return make


def execute(
    trajectory: Trajectory,
    mesh: Mesh | None,
    body: ToolBody,
    settings: ExecutionSettings,
    seed: int,
    *,
    bound: TrackingBound | None = None,
    unsafe_below_m: float | None = None,
    field: DistanceField | None = None,
    camera: CameraWatch | None = None,
    make_arm: Callable[[int], contextlib.AbstractContextManager[Arm]] | None = None,
    progress: Progress = silent,
) -> Execution:
    """Carry out ``trajectory`` on a simulated arm and record what happened. A pure function of its arguments.

    Args:
        trajectory: the reference, at any rate; the controller interpolates it.
        mesh: the hand's (vertices_m (V, 3), triangles (F, 3)), solid in the simulation; None: no hand.
        body: the tool at the flange.
        seed: draws the arm's friction and torque sensor gains.
        bound: gamma, which the monitor enforces; the paper's line if None.
        unsafe_below_m: height below which no link of the arm may come (decision 12), usually the top of the field.
        field: what the motion was planned in; the monitor stops the arm where the measured tool leaves what is safe.
        camera: its images; the monitor refuses to start, and stops, when they are old or repeat themselves.
        make_arm: makes an arm from the seed; the simulated iiwa 14 if None.

    Raises:
        PlanningError: the arm cannot follow: out of reach, a joint range or speed exceeded, a link too low; or what it
            measures before it starts is not finite.
        SettingsError: ``unsafe_below_m`` is not finite.
        StaleImageError: the image that the motion was planned from is too old or from the future, or the camera is
            frozen or unusable.
    """
    if camera is not None:
        camera.require_live(settings.max_look_age_s, settings.max_frame_age_s)
    distance = None if mesh is None else MeshDistance(*mesh)
    with (make_arm or iiwa_for(body, mesh))(seed) as arm:
        reference = Reference(trajectory, settings, arm, unsafe_below_m)
        recorder = _Recorder(reference, arm, body, distance)
        monitor = Monitor(bound or TrackingBound(), settings, arm.limits, body, field, camera)
        reason = _drive(arm, reference, recorder, monitor, settings, progress)
        return recorder.finish(seed, reason)


def _drive(
    arm: Arm,
    reference: Reference,
    recorder: "_Recorder",
    monitor: Monitor,
    settings: ExecutionSettings,
    progress: Progress,
) -> str:
    """Run the control loop; returns why the monitor stopped the arm, or nothing.

    While a measurement is not finite, controller and record go on with the last one that was, until the brakes close.
    """
    period, total = arm.control_period_s, len(reference.poses)
    every = max(1, round(1 / (settings.record_rate_hz * period)))
    torque_limit = np.array(arm.limits.torque_nm)
    arm.reset(reference.joints[0])
    reason, held, last, contacts = "", None, total - 1, 0
    brake_at, index = math.inf, 0
    state, torques = reference.start_state, np.zeros_like(torque_limit)
    while index <= last:
        measured = arm.state()
        state = state if measurement_fault(measured) else measured
        target, without_torques = held or reference.target(index), ""
        try:
            torques = impedance_torques(state, arm.dynamics(state), target, settings.impedance)
        except (SettingsError, np.linalg.LinAlgError) as error:
            without_torques = f"the controller has no torques: {error}"
        torques = np.minimum(np.maximum(torques, -torque_limit), torque_limit)
        if index % every == 0 or index == last:
            recorder.add(index, state, torques, contacts, bool(reason))
            progress(index, total, PHASES[reference.phase[index]])
            contacts = 0
        if not reason:
            reason = monitor.violation(index * period, measured, target, reference.is_planned(index))
            reason = reason or without_torques
            if reason:
                held = _hold(state)
                last = min(last, index + round(_STOP_S / period))
                brake_at = index + round(settings.brake_delay_s / period)
        if index >= brake_at:
            arm.brake()
        contacts += arm.step(torques)
        index += 1
    return reason


def _hold(state: ArmState) -> TaskReference:
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
        self._frozen_at: int | None = None
        self._before: tuple[ArmState, Array, float, float] | None = None

    def add(self, index: int, state: ArmState, torques: Array, contacts: int, stopped: bool) -> None:
        reference = self._reference
        if stopped and self._frozen_at is None:
            self._frozen_at = index
        shown = index if self._frozen_at is None else self._frozen_at
        self._rows.append(
            (
                index * reference.period_s,
                PHASES.index("stopped") if stopped else int(reference.phase[index]),
                reference.poses[shown],
                np.zeros(4) if stopped else reference.velocities[index],
                state.tool_position_m,
                _turned(state.tool_quaternion, -reference.half_turns_rad),
                state.joint_positions_rad,
                torques,
                *self._to_hand_m(state),
                contacts,
            )
        )

    def finish(self, seed: int, stop_reason: str) -> Execution:
        columns = dict(zip(COLUMNS, zip(*self._rows, strict=True), strict=True))
        arrays: dict[str, Any] = {name: np.array(column, dtype=COLUMNS[name][0]) for name, column in columns.items()}
        return Execution(body=self._body, seed=seed, stop_reason=stop_reason, **arrays)

    def _to_hand_m(self, state: ArmState) -> tuple[float, float]:
        """Distances of tool and links, looked for no further than they can have become since the sample before."""
        if self._distance is None:
            return math.inf, math.inf
        rotation, points = _matrix(state.tool_quaternion), self._arm.link_points_m()
        if self._before is not None and not np.isfinite(points).all():
            points = self._before[1]
        most_tool_m = most_arm_m = math.inf
        if self._before is not None:
            before, before_points, tool_m, arm_m = self._before
            turned = float(np.linalg.norm(rotation - _matrix(before.tool_quaternion)))
            moved = float(np.linalg.norm(state.tool_position_m - before.tool_position_m))
            reach_m = max(self._body.shaft_length_m, self._body.rho_max_m) + self._body.thickness_m
            most_tool_m = tool_m + moved + turned * reach_m + _SLACK_M
            if len(points):
                most_arm_m = arm_m + float(np.sqrt(((points - before_points) ** 2).sum(axis=1).max())) + _SLACK_M
        tool_m = self._distance.to_tool(self._body, state.tool_position_m, rotation, most_tool_m)
        arm_m = self._distance.to_points(points, most_arm_m)
        self._before = state, points, tool_m, arm_m
        return tool_m, arm_m


def _turned(quaternion: Array, angle_rad: float) -> Array:
    """``quaternion`` after a turn about the tool's own z."""
    x, y, z, w = quaternion
    s, c = math.sin(angle_rad / 2), math.cos(angle_rad / 2)
    return np.array([x * c + y * s, y * c - x * s, z * c + w * s, w * c - z * s])


def _matrix(quaternion: Array) -> Array:
    x, y, z, w = quaternion
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )
