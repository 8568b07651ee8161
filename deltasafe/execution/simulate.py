"""Executing a trajectory: down onto its start, along it, up again, watched at every step of control."""

import contextlib
import dataclasses
import math
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from deltasafe.errors import PlanningError, SettingsError
from deltasafe.execution.arm import Arm, ArmState
from deltasafe.execution.distance import MeshDistance
from deltasafe.execution.impedance import ImpedanceSettings, TaskReference, impedance_torques, rotation_error
from deltasafe.execution.recording import COLUMNS, PHASES, Execution
from deltasafe.geometry import Trajectory
from deltasafe.planning.body import ToolBody
from deltasafe.planning.tracking import TrackingBound
from deltasafe.progress import Progress, silent

__all__ = ["ExecutionSettings", "execute", "iiwa_for"]

Array = NDArray[np.float64]
Mesh = tuple[NDArray[np.floating], NDArray[np.integer]]

_STOP_S = 0.5  # how long a stop is watched


@dataclasses.dataclass(frozen=True)
class ExecutionSettings:
    """How a motion is carried out.

    Attributes:
        approach_m: the tool comes down from, and leaves to, this height above start and goal; 0 for neither.
        approach_speed_mps: mean speed of that.
        settle_s: rest before and after the motion; the rest after it is judged with it (lag persists after braking).
        record_rate_hz: rate of the recorded arrays.
        monitor_margin_m: the arm is stopped once the workspace error exceeds gamma(max(v, min_speed)) by this.
        min_speed_mps: the smallest speed at which the bound is read; it is 0 at rest (decision 13).
        impedance: gains of the controller.
    """

    approach_m: float = 0.05
    approach_speed_mps: float = 0.05
    settle_s: float = 0.3
    record_rate_hz: float = 100.0
    monitor_margin_m: float = 0.001
    min_speed_mps: float = 0.01
    impedance: ImpedanceSettings = dataclasses.field(default_factory=ImpedanceSettings)

    def __post_init__(self) -> None:
        for name in ("approach_m", "settle_s", "monitor_margin_m"):
            value = getattr(self, name)
            if not (math.isfinite(value) and value >= 0):
                raise SettingsError(f"{name} must be finite and not negative, got {value}")
        for name in ("approach_speed_mps", "record_rate_hz", "min_speed_mps"):
            value = getattr(self, name)
            if not (math.isfinite(value) and value > 0):
                raise SettingsError(f"{name} must be positive, got {value}")


def iiwa_for(
    body: ToolBody, mesh: Mesh | None, table_z_m: float = 0.0
) -> Callable[[int], contextlib.AbstractContextManager[Arm]]:
    """What ``execute`` calls with its seed to get a fresh simulated iiwa 14 beside a table and a hand."""

    def make(seed: int) -> contextlib.AbstractContextManager[Arm]:
        from deltasafe.execution.iiwa import IiwaArm

        return IiwaArm(body, mesh, table_z_m=table_z_m, seed=seed)

    return make


def execute(
    trajectory: Trajectory,
    mesh: Mesh,
    body: ToolBody,
    settings: ExecutionSettings,
    seed: int,
    *,
    bound: TrackingBound | None = None,
    unsafe_below_m: float | None = None,
    make_arm: Callable[[int], contextlib.AbstractContextManager[Arm]] | None = None,
    progress: Progress = silent,
) -> Execution:
    """Carry out ``trajectory`` on a simulated arm and record what happened. A pure function of its arguments.

    Args:
        trajectory: the reference, at any rate; the controller interpolates it.
        mesh: the hand's (vertices_m (V, 3), triangles (F, 3)), solid in the simulation.
        body: the tool at the flange.
        seed: draws the arm's friction and torque sensor gains.
        bound: gamma, which the monitor enforces; the paper's line if None.
        unsafe_below_m: height below which no link of the arm may come (decision 12), usually the top of the field.
        make_arm: makes an arm from the seed; the simulated iiwa 14 if None.

    Raises:
        PlanningError: the arm cannot follow: out of reach, a joint range or speed exceeded, a link too low.
    """
    bound = bound or TrackingBound()
    distance = MeshDistance(*mesh)
    with (make_arm or iiwa_for(body, mesh))(seed) as arm:
        reference = _Reference(trajectory, settings, arm, body, unsafe_below_m)
        recorder = _Recorder(reference, arm, body, distance)
        reason = _drive(arm, reference, recorder, settings, bound, progress)
        return recorder.finish(seed, reason)


class _Reference:
    """The whole motion at the controller's rate, in task and joint space."""

    def __init__(
        self,
        trajectory: Trajectory,
        settings: ExecutionSettings,
        arm: Arm,
        body: ToolBody,
        unsafe_below_m: float | None,
    ) -> None:
        period = arm.control_period_s
        self.period_s = period
        motion_time: Array = np.arange(math.floor(trajectory.duration_s / period + 1e-9) + 1, dtype=np.float64) * period
        poses = _at(motion_time, trajectory.time_s, trajectory.poses)
        velocities = _at(motion_time, trajectory.time_s, trajectory.velocities)
        approach, approach_velocity = _vertical(poses[0], settings, period)
        retreat, retreat_velocity = _vertical(poses[-1], settings, period)
        rest = round(settings.settle_s / period)
        pieces = [
            ("approach", approach[::-1], -approach_velocity[::-1]),
            ("rest", np.repeat(poses[:1], rest, axis=0), np.zeros((rest, 4))),
            ("motion", poses, velocities),
            ("settle", np.repeat(poses[-1:], rest, axis=0), np.zeros((rest, 4))),
            ("retreat", retreat, retreat_velocity),
        ]
        self.phase = np.concatenate([np.full(len(p), PHASES.index(name)) for name, p, _ in pieces])
        self.poses = np.concatenate([p for _, p, _ in pieces])
        self.velocities = np.concatenate([v for _, _, v in pieces])
        self.accelerations = np.diff(self.velocities, axis=0, append=self.velocities[-1:]) / period
        self.joints = arm.inverse(self.poses)
        self.joint_velocities = np.gradient(self.joints, period, axis=0)
        self._require_feasible(arm, unsafe_below_m)
        self.rho_max_m = body.rho_max_m
        # the arm may hold the tool turned by half turns, under which it looks the same
        arm.reset(self.joints[0])
        x, y, z, w = arm.state().tool_quaternion
        turned = math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z)) - self.poses[0, 3]
        self.half_turns_rad = math.pi * round(turned / math.pi)

    def target(self, index: int) -> TaskReference:
        """What the controller follows at one step."""
        x, y, z, yaw = self.poses[index]
        half = (yaw + self.half_turns_rad) / 2
        velocity, acceleration = self.velocities[index], self.accelerations[index]
        return TaskReference(
            np.array([x, y, z]),
            np.array([0.0, 0.0, math.sin(half), math.cos(half)]),
            np.array([velocity[0], velocity[1], velocity[2], 0.0, 0.0, velocity[3]]),
            np.array([acceleration[0], acceleration[1], acceleration[2], 0.0, 0.0, acceleration[3]]),
            self.joints[index],
            self.joint_velocities[index],
        )

    def _require_feasible(self, arm: Arm, unsafe_below_m: float | None) -> None:
        limits = np.array(arm.limits.velocity_radps)
        share = np.abs(self.joint_velocities) / limits
        if share.max() > 1:
            sample, joint = np.unravel_index(np.argmax(share), share.shape)
            raise PlanningError(
                f"at {sample * self.period_s:.2f} s joint {joint + 1} would have to turn "
                f"{share[sample, joint]:.2f} times as fast as it can; slow the trajectory down"
            )
        if unsafe_below_m is not None:
            for index in range(0, len(self.joints), 50):
                arm.reset(self.joints[index])
                points = arm.link_points_m()
                if len(points) and points[:, 2].min() < unsafe_below_m:
                    raise PlanningError(
                        f"at {index * self.period_s:.2f} s a link of the arm comes down to "
                        f"{points[:, 2].min():.3f} m, but space below {unsafe_below_m:.3f} m is not known to be "
                        "free; lengthen the tool's shaft or raise the path"
                    )


def _drive(
    arm: Arm,
    reference: _Reference,
    recorder: "_Recorder",
    settings: ExecutionSettings,
    bound: TrackingBound,
    progress: Progress,
) -> str:
    """Run the control loop; returns why the monitor stopped the arm, or nothing."""
    period, total = arm.control_period_s, len(reference.poses)
    every = max(1, round(1 / (settings.record_rate_hz * period)))
    torque_limit, speed_limit = np.array(arm.limits.torque_nm), np.array(arm.limits.velocity_radps)
    arm.reset(reference.joints[0])
    reason, held, last, contacts = "", None, total - 1, 0
    index = 0
    while index <= last:
        state = arm.state()
        target = held or reference.target(index)
        torques = impedance_torques(state, arm.dynamics(state), target, settings.impedance)
        torques = np.clip(torques, -torque_limit, torque_limit)
        if index % every == 0 or index == last:
            recorder.add(index, state, torques, contacts, bool(reason))
            progress(index, total, PHASES[reference.phase[index]])
            contacts = 0
        if not reason:
            reason = _violation(state, target, reference.rho_max_m, speed_limit, settings, bound)
            if reason:
                held = _hold(state)
                last = min(last, index + round(_STOP_S / period))
        contacts += arm.step(torques)
        index += 1
    return reason


def _violation(
    state: ArmState,
    target: TaskReference,
    rho_max_m: float,
    speed_limit: Array,
    settings: ExecutionSettings,
    bound: TrackingBound,
) -> str:
    position = float(np.linalg.norm(target.position_m - state.tool_position_m))
    rotation = float(np.linalg.norm(rotation_error(target.quaternion, state.tool_quaternion)))
    error = position + rho_max_m * rotation
    speed = max(float(np.linalg.norm(target.twist[:3])), settings.min_speed_mps)
    allowed = float(bound.error_m(speed)) + settings.monitor_margin_m
    if error > allowed:
        return f"workspace error {error * 1e3:.2f} mm exceeds {allowed * 1e3:.2f} mm at {speed:.3f} m/s"
    share = np.abs(state.joint_velocities_radps) / speed_limit
    if share.max() > 1:
        return f"joint {int(share.argmax()) + 1} turns {share.max():.2f} times as fast as it may"
    return ""


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

    def __init__(self, reference: _Reference, arm: Arm, body: ToolBody, distance: MeshDistance) -> None:
        self._reference, self._arm, self._body, self._distance = reference, arm, body, distance
        self._rows: list[tuple[object, ...]] = []
        self._frozen_at: int | None = None

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
                self._distance.to_tool(self._body, state.tool_position_m, _matrix(state.tool_quaternion)),
                self._distance.to_points(self._arm.link_points_m()),
                contacts,
            )
        )

    def finish(self, seed: int, stop_reason: str) -> Execution:
        columns = dict(zip(COLUMNS, zip(*self._rows, strict=True), strict=True))
        arrays: dict[str, Any] = {name: np.array(column, dtype=COLUMNS[name][0]) for name, column in columns.items()}
        return Execution(body=self._body, seed=seed, stop_reason=stop_reason, **arrays)


def _at(time_s: Array, known_s: Array, values: Array) -> Array:
    return np.stack([np.interp(time_s, known_s, column) for column in values.T], axis=1)


def _vertical(pose: Array, settings: ExecutionSettings, period_s: float) -> tuple[Array, Array]:
    """Poses and velocities (K, 4) that rise from ``pose``, at rest at both ends (quintic)."""
    if settings.approach_m == 0:
        return np.zeros((0, 4)), np.zeros((0, 4))
    duration = settings.approach_m / settings.approach_speed_mps
    count = max(2, round(duration / period_s))
    share = np.arange(count) / (count - 1)
    poses, velocities = np.repeat(pose[None], count, axis=0), np.zeros((count, 4))
    poses[:, 2] += settings.approach_m * share**3 * (10 - 15 * share + 6 * share**2)
    velocities[:, 2] = settings.approach_m / duration * 30 * share**2 * (1 - share) ** 2
    return poses, velocities


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
