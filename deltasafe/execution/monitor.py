"""What is watched while the arm moves: tracking, joint speeds, clearance in the planned field, the camera's images."""

import dataclasses
import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from deltasafe.errors import SettingsError, StaleImageError
from deltasafe.execution.arm import ArmState, measurement_fault
from deltasafe.execution.impedance import TaskReference, pose_error
from deltasafe.execution.kinematics import JointLimits
from deltasafe.execution.settings import ExecutionSettings
from deltasafe.geometry import yaw_of
from deltasafe.planning import CheckSettings, body_clearance_m, is_segment_safe, segment_test
from deltasafe.planning.body import ToolBody
from deltasafe.planning.collision.distance_field import DistanceField
from deltasafe.planning.tracking_bound import TrackingBound
from deltasafe.scene.image_stamp import ImageStamp

__all__ = ["CameraWatch", "Monitor"]

Array = NDArray[np.float64]

_MOST_MARGIN_M = 0.02
_LOOK_EVERY_S = 0.01

_AHEAD_S = 0.05
"""By which an image's stamp may lie ahead of the clock: synchronized clocks differ by milliseconds, others by years.

A dead camera is found this much later at most.
"""


@dataclasses.dataclass(frozen=True)
class CameraWatch:
    """Whether the camera still sees. Its images are compared, not looked at: the hand is taken to hold still.

    A real sensor never delivers the same image twice, its noise differs. An image that repeats the one before it to
    the last bit is a stale buffer, and so was perhaps the one that the motion was planned from.

    All times are of one clock, the camera's. A stamp more than 0.05 s ahead of it is of another clock (Unix stamps
    beside a ``starts_s`` of 0, for example): the age of an image would be negative, and never too old. It is refused
    at the start and stops the motion later, as an old one does.

    Attributes:
        newest: the newest image at a time of the camera's clock (s).
        seen: the image that the motion was planned from.
        starts_s: the camera's clock when the execution begins.
    """

    newest: Callable[[float], ImageStamp]
    seen: ImageStamp
    starts_s: float = 0.0

    def require_live(self, max_look_age_s: float, max_frame_age_s: float) -> None:
        """Refuse to start on an old image, on one from the future, or beside a frozen camera.

        Raises:
            StaleImageError: with the remedy.
        """
        age_s = self.starts_s - self.seen.taken_s
        if not age_s >= -_AHEAD_S:  # true for NaN
            raise StaleImageError(
                f"the motion was planned from an image that is {-age_s:.2f} s ahead of the clock: taken_s "
                f"{self.seen.taken_s}, starts_s {self.starts_s}; give both by the camera's clock"
            )
        if not age_s <= max_look_age_s:
            raise StaleImageError(
                f"the motion was planned from an image {age_s:.1f} s old, {max_look_age_s:g} s are allowed; "
                "take a new one and plan again"
            )
        reason = self.violation(0.0, self.seen, max_frame_age_s)[1]
        if reason:
            raise StaleImageError(
                f"{reason}; restart the camera, take a new image and plan again, all times by the camera's clock"
            )

    def violation(self, time_s: float, before: ImageStamp, max_frame_age_s: float) -> tuple[ImageStamp, str]:
        """The newest image at ``time_s`` of the execution, and what is wrong with it after ``before``."""
        now_s = self.starts_s + time_s
        try:
            newest = self.newest(now_s)
        except SettingsError as error:  # a ImageStamp refuses a stamp that is not finite
            return before, f"the camera's newest image is unusable: {error}"
        age_s = now_s - newest.taken_s
        if not age_s >= -_AHEAD_S:
            return newest, f"the camera's newest image is {-age_s:.2f} s ahead of the clock"
        if not age_s <= max_frame_age_s:
            return newest, f"the camera's newest image is {age_s:.2f} s old"
        if newest.taken_s != before.taken_s and newest.image_sha256 == before.image_sha256:
            return newest, "the camera repeats an image to the last bit: it is frozen"
        return newest, ""


class Monitor:
    """Says why the arm must stop, or nothing, at each step of control.

    It fails closed: a measurement, target or time that is not finite is a reason to stop, and every comparison is
    written so that NaN stops.
    """

    def __init__(
        self,
        bound: TrackingBound,
        settings: ExecutionSettings,
        limits: JointLimits,
        body: ToolBody,
        field: DistanceField | None,
        camera: CameraWatch | None,
    ) -> None:
        self._bound, self._settings, self._body, self._camera = bound, settings, body, camera
        self._speed_limit = limits.velocity_radps
        self._margin_m = min(float(bound.error_m(settings.min_speed_mps)), _MOST_MARGIN_M)
        self._planned = None if field is None else segment_test(field, body, self._margin_m, CheckSettings())
        self._top_z_m = 0.0 if field is None else float(field.grid.upper_m[2])
        self._seen = None if camera is None else camera.seen
        self._look_at_s, self._time_s = 0.0, -math.inf

    def violation(self, time_s: float, state: ArmState, target: TaskReference, is_planned: bool) -> str:
        """Why the arm must stop.

        Args:
            is_planned: whether this is the planned motion; approach and retreat lead through what was not seen.
        """
        before_s, self._time_s = self._time_s, time_s
        if not before_s < time_s < math.inf:  # looks at clearance and camera follow this clock
            return f"the clock of the control went from {before_s} s to {time_s} s"
        reason = measurement_fault(state) or self._tracking(state, target) or self._joint_speed(state)
        if reason or time_s < self._look_at_s:
            return reason
        self._look_at_s = time_s + _LOOK_EVERY_S - 1e-9
        return (self._clearance(state, target) if is_planned else "") or self._image(time_s)

    def _tracking(self, state: ArmState, target: TaskReference) -> str:
        x, y, z, a, b, c = pose_error(
            target.position_m, target.quaternion, state.tool_position_m, state.tool_quaternion
        ).tolist()
        error = math.hypot(x, y, z) + self._body.rho_max_m * math.hypot(a, b, c)
        speed = max(math.hypot(*target.twist[:3].tolist()), self._settings.min_speed_mps)
        allowed = self._bound.gamma0_m + self._bound.gamma1_s * speed + self._settings.monitor_margin_m
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
        """The measured tool in the field, by the better of two bounds.

        What is known at the measured pose, the field taking it upright: what its tilt moves at most is taken off. What
        the planner's own test shows at the reference, less the way between: bounds are short of the truth by a part
        of a voxel, and a motion as close as its tracking bound allows would be stopped for nothing but that.
        """
        if self._planned is None:
            return ""
        lever_m = max(self._body.rho_max_m, self._top_z_m - float(state.tool_position_m[2]))
        x, y, _, _ = state.tool_quaternion.tolist()
        tilted_m = lever_m * 2 * math.asin(min(1.0, math.hypot(x, y)))
        pose = np.append(state.tool_position_m, yaw_of(state.tool_quaternion))
        clearance_m = float(body_clearance_m(self._planned, pose[None])[0]) - tilted_m
        if not clearance_m >= 0:
            error = pose_error(target.position_m, target.quaternion, state.tool_position_m, state.tool_quaternion)
            way_m = math.hypot(*error[:3].tolist()) + lever_m * math.hypot(*error[3:].tolist())
            pose = np.append(target.position_m, yaw_of(target.quaternion))
            if is_segment_safe(self._planned, pose, pose):
                clearance_m = max(clearance_m, self._margin_m - way_m)
        if not clearance_m >= 0:
            return f"the tool is {-clearance_m * 1e3:.2f} mm inside what is not known to be free"
        return ""

    def _image(self, time_s: float) -> str:
        if self._camera is None or self._seen is None:
            return ""
        self._seen, reason = self._camera.violation(time_s, self._seen, self._settings.max_frame_age_s)
        return reason
