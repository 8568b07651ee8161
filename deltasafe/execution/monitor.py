"""Monitor of a running motion: tracking error, joint speeds, clearance in the planned field, liveness of the camera."""

import dataclasses
import math

import numpy as np

from deltasafe.execution.arm import ArmState, JointLimits, measurement_fault
from deltasafe.execution.camera_watch import CameraWatch
from deltasafe.execution.impedance import TaskReference, pose_error
from deltasafe.execution.settings import ExecutionSettings
from deltasafe.geometry import yaw_of
from deltasafe.planning import (
    CheckSettings,
    DistanceField,
    MotionSettings,
    ToolBody,
    TrackingBound,
    body_clearance_m,
    is_segment_safe,
    segment_test,
)
from deltasafe.setting_ranges import check_range

_MAX_MARGIN_M = 0.02
_CHECK_EVERY_S = 0.01
"""Period of the tests of clearance and camera; all others run at every control step."""


@dataclasses.dataclass(frozen=True)
class MonitorLimits:
    """Limits that belong to a motion, not to the execution.

    Attributes:
        tracking: gamma(v), bound of the workspace error; the default is the paper's line.
        v_min_mps: gamma is evaluated at no smaller speed, because the paper's line is 0 at rest (decision 13).
        field: the distance field that the motion was planned in; None: clearance is not monitored.
        camera: None: the camera is not monitored.
    """

    tracking: TrackingBound = dataclasses.field(default_factory=TrackingBound)
    v_min_mps: float = MotionSettings.v_min_mps
    field: DistanceField | None = None
    camera: CameraWatch | None = None

    def __post_init__(self) -> None:
        check_range(self, "(0, inf)", "v_min_mps")

    @classmethod
    def of(
        cls, settings: MotionSettings, field: DistanceField | None = None, camera: CameraWatch | None = None
    ) -> "MonitorLimits":
        """Return the limits of a motion with these settings."""
        return cls(settings.tracking, settings.v_min_mps, field, camera)


class Monitor:
    """Decides at each control step whether the arm must stop.

    It fails closed: a measurement, target or time that is not finite stops the arm. Comparisons are written so that
    NaN stops it too.

    Args:
        joint_limits: of the arm.
        body: the tool.
    """

    def __init__(
        self, limits: MonitorLimits, settings: ExecutionSettings, joint_limits: JointLimits, body: ToolBody
    ) -> None:
        self._limits, self._settings, self._body = limits, settings, body
        self._speed_limit = joint_limits.velocity_radps
        self._margin_m = min(float(limits.tracking.error_m(limits.v_min_mps)), _MAX_MARGIN_M)
        field = limits.field
        self._test = None if field is None else segment_test(field, body, self._margin_m, CheckSettings())
        self._field_top_z_m = 0.0 if field is None else float(field.grid.upper_m[2])
        self._newest_image = None if limits.camera is None else limits.camera.planned_from
        self._next_check_s, self._time_s = 0.0, -math.inf

    def violation(self, time_s: float, state: ArmState, target: TaskReference, is_planned: bool) -> str:
        """Return why the arm must stop, or an empty string.

        Args:
            is_planned: whether this is the planned motion. Approach and retreat leave the camera's view.
        """
        previous_s, self._time_s = self._time_s, time_s
        if not previous_s < time_s < math.inf:  # the tests of clearance and camera are scheduled by this clock
            return f"the clock of the control went from {previous_s} s to {time_s} s"
        reason = measurement_fault(state) or self._tracking(state, target) or self._joint_speed(state)
        if reason or time_s < self._next_check_s:
            return reason
        self._next_check_s = time_s + _CHECK_EVERY_S - 1e-9
        return (self._clearance(state, target) if is_planned else "") or self._image(time_s)

    def _tracking(self, state: ArmState, target: TaskReference) -> str:
        x, y, z, a, b, c = pose_error(
            target.position_m, target.quaternion, state.tool_position_m, state.tool_quaternion
        ).tolist()
        error = math.hypot(x, y, z) + self._body.rho_max_m * math.hypot(a, b, c)
        speed = max(math.hypot(*target.twist[:3].tolist()), self._limits.v_min_mps)
        bound = self._limits.tracking
        allowed = bound.gamma0_m + bound.gamma1_s * speed + self._settings.monitor_margin_m
        if not error <= allowed < math.inf:
            return f"workspace error {error * 1e3:.2f} mm exceeds {allowed * 1e3:.2f} mm at {speed:.3f} m/s"
        return ""

    def _joint_speed(self, state: ArmState) -> str:
        for joint, (speed, limit) in enumerate(
            zip(state.joint_velocities_radps.tolist(), self._speed_limit, strict=True)
        ):
            if not abs(speed) <= limit:
                return f"joint {joint + 1} turns {abs(speed) / limit:.2f} times as fast as it may"
        return ""

    def _clearance(self, state: ArmState, target: TaskReference) -> str:
        """Compare the larger of two lower bounds of the clearance with 0.

        The first is the clearance of an upright tool at the measured pose, less the largest displacement by its tilt.
        The second holds if the planner's test accepts the target: the margin of that test less the distance to the
        measured pose. Without it, the voxel size alone would stop motions that are as close as their tracking bound
        allows.
        """
        if self._test is None:
            return ""
        lever_m = max(self._body.rho_max_m, self._field_top_z_m - float(state.tool_position_m[2]))
        x, y, _, _ = state.tool_quaternion.tolist()
        tilt_m = lever_m * 2 * math.asin(min(1.0, math.hypot(x, y)))
        pose = np.append(state.tool_position_m, yaw_of(state.tool_quaternion))
        clearance_m = float(body_clearance_m(self._test, pose[None])[0]) - tilt_m
        if not clearance_m >= 0:
            error = pose_error(target.position_m, target.quaternion, state.tool_position_m, state.tool_quaternion)
            error_m = math.hypot(*error[:3].tolist()) + lever_m * math.hypot(*error[3:].tolist())
            pose = np.append(target.position_m, yaw_of(target.quaternion))
            if is_segment_safe(self._test, pose, pose):
                clearance_m = max(clearance_m, self._margin_m - error_m)
        if not clearance_m >= 0:
            return f"the tool is {-clearance_m * 1e3:.2f} mm inside what is not known to be free"
        return ""

    def _image(self, time_s: float) -> str:
        if self._limits.camera is None or self._newest_image is None:
            return ""
        self._newest_image, reason = self._limits.camera.violation(
            time_s, self._newest_image, self._settings.max_frame_age_s
        )
        return reason
