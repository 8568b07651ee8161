"""Reference of the controller, sampled at its rate: approach of the start, the trajectory, retreat from the goal."""

import math

import numpy as np
from numpy.typing import NDArray

from deltasafe.errors import PlanningError, SettingsError
from deltasafe.execution.arm import Arm, measurement_fault
from deltasafe.execution.impedance import TaskReference
from deltasafe.execution.recording import PHASES, UNPLANNED_PHASES
from deltasafe.execution.settings import ExecutionSettings
from deltasafe.geometry import Trajectory, yaw_of

Array = NDArray[np.float64]

_LINKS_EVERY = 50
"""Control steps between two tests of the links' height."""


class Reference:
    """The whole motion at the controller's rate, in task and joint space.

    Args:
        unsafe_below_m: height below which no link of the arm may come; None: no such height.

    Raises:
        PlanningError: the arm cannot follow, or its first measurement is not finite.
        SettingsError: ``unsafe_below_m`` is not finite.
    """

    def __init__(
        self, trajectory: Trajectory, settings: ExecutionSettings, arm: Arm, unsafe_below_m: float | None
    ) -> None:
        if unsafe_below_m is not None and not math.isfinite(unsafe_below_m):
            raise SettingsError(f"unsafe_below_m must be a finite height in meters, got {unsafe_below_m}")
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
        accelerations = np.diff(self.velocities, axis=0, append=self.velocities[-1:]) / period
        self.joints = arm.inverse(self.poses)
        self.joint_velocities = np.gradient(self.joints, period, axis=0)
        self._require_feasible(arm, unsafe_below_m)
        arm.reset(self.joints[0])
        self.start_state = arm.state()
        if fault := measurement_fault(self.start_state):
            raise PlanningError(f"the arm cannot start: {fault}; check its sensors")
        # the elliptic tool is symmetric, so the arm may hold it turned by half turns
        turned = float(yaw_of(self.start_state.tool_quaternion)) - self.poses[0, 3]
        self.half_turns_rad = math.pi * round(turned / math.pi)
        half = (self.poses[:, 3] + self.half_turns_rad) / 2
        self._quaternions = np.stack([0 * half, 0 * half, np.sin(half), np.cos(half)], axis=1)
        self._twists = np.insert(self.velocities, [3, 3], 0.0, axis=1)
        self._task_accelerations = np.insert(accelerations, [3, 3], 0.0, axis=1)
        self._planned = ~np.isin(self.phase, UNPLANNED_PHASES)

    def target(self, index: int) -> TaskReference:
        """Return the reference at one control step."""
        return TaskReference(
            self.poses[index, :3],
            self._quaternions[index],
            self._twists[index],
            self._task_accelerations[index],
            self.joints[index],
            self.joint_velocities[index],
        )

    def is_planned(self, index: int) -> bool:
        """Whether a control step belongs to the plan, from rest at the start to rest at the goal."""
        return bool(self._planned[index])

    def _require_feasible(self, arm: Arm, unsafe_below_m: float | None) -> None:
        fraction = np.abs(self.joint_velocities) / np.array(arm.limits.velocity_radps)
        if not fraction.max() <= 1:  # true for NaN
            sample, joint = np.unravel_index(np.argmax(fraction), fraction.shape)
            raise PlanningError(
                f"at {sample * self.period_s:.2f} s joint {joint + 1} would have to turn "
                f"{fraction[sample, joint]:.2f} times as fast as it can; slow the trajectory down"
            )
        if unsafe_below_m is None:
            return
        for index in range(0, len(self.joints), _LINKS_EVERY):
            arm.reset(self.joints[index])
            points = arm.link_points_m()
            if len(points) and not points[:, 2].min() >= unsafe_below_m:
                raise PlanningError(
                    f"at {index * self.period_s:.2f} s a link of the arm comes down to "
                    f"{points[:, 2].min():.3f} m, but space below {unsafe_below_m:.3f} m is not known to be "
                    "free; lengthen the tool's shaft or raise the path"
                )


def _at(time_s: Array, known_s: Array, values: Array) -> Array:
    return np.stack([np.interp(time_s, known_s, column) for column in values.T], axis=1)


def _vertical(pose: Array, settings: ExecutionSettings, period_s: float) -> tuple[Array, Array]:
    """Poses and velocities (K, 4) that rise from ``pose``, at rest at both ends (quintic)."""
    if settings.approach_m == 0:
        return np.zeros((0, 4)), np.zeros((0, 4))
    duration = settings.approach_m / settings.approach_speed_mps
    count = max(2, round(duration / period_s))
    s = np.arange(count) / (count - 1)
    poses, velocities = np.repeat(pose[None], count, axis=0), np.zeros((count, 4))
    poses[:, 2] += settings.approach_m * s**3 * (10 - 15 * s + 6 * s**2)
    velocities[:, 2] = settings.approach_m / duration * 30 * s**2 * (1 - s) ** 2
    return poses, velocities
