"""Liveness of the camera: age and repetition of its images."""

import dataclasses
from collections.abc import Callable

from deltasafe.errors import SettingsError, StaleImageError
from deltasafe.scene.image_stamp import ImageStamp

_MAX_AHEAD_S = 0.05
"""Tolerated lead of an image's stamp over the clock: synchronized clocks differ by milliseconds, others by years.

A dead camera is detected later by at most this time.
"""


@dataclasses.dataclass(frozen=True)
class CameraWatch:
    """Detects a camera that delivers no images, or the same one again. The hand is assumed to hold still (decision 27).

    A real sensor never delivers two identical images, because of its noise. An image with the same bits as the
    previous one comes from a stale buffer, and perhaps also the image that the motion was planned from.

    All times are those of the camera's clock. A stamp more than 0.05 s ahead belongs to another clock, for example
    Unix time beside a ``starts_s`` of 0: the age of such an image is negative, and never exceeds a limit. At the start
    it is refused, later it stops the motion.

    Attributes:
        newest: returns the newest image at a time of the camera's clock (s).
        planned_from: the image that the motion was planned from.
        starts_s: the camera's clock at the start of the execution.
    """

    newest: Callable[[float], ImageStamp]
    planned_from: ImageStamp
    starts_s: float = 0.0

    def require_live(self, max_look_age_s: float, max_frame_age_s: float) -> None:
        """Refuse to start with an image that is too old or from the future, or with a frozen camera.

        Raises:
            StaleImageError: with the remedy.
        """
        age_s = self.starts_s - self.planned_from.taken_s
        if not age_s >= -_MAX_AHEAD_S:  # true for NaN
            raise StaleImageError(
                f"the motion was planned from an image that is {-age_s:.2f} s ahead of the clock: taken_s "
                f"{self.planned_from.taken_s}, starts_s {self.starts_s}; give both by the camera's clock"
            )
        if not age_s <= max_look_age_s:
            raise StaleImageError(
                f"the motion was planned from an image {age_s:.1f} s old, {max_look_age_s:g} s are allowed; "
                "take a new one and plan again"
            )
        reason = self.violation(0.0, self.planned_from, max_frame_age_s)[1]
        if reason:
            raise StaleImageError(
                f"{reason}; restart the camera, take a new image and plan again, all times by the camera's clock"
            )

    def violation(self, time_s: float, previous: ImageStamp, max_frame_age_s: float) -> tuple[ImageStamp, str]:
        """Return the newest image at ``time_s`` of the execution, and why the arm must stop, or an empty string."""
        now_s = self.starts_s + time_s
        try:
            newest = self.newest(now_s)
        except SettingsError as error:  # ImageStamp refuses a stamp that is not finite
            return previous, f"the camera's newest image is unusable: {error}"
        age_s = now_s - newest.taken_s
        if not age_s >= -_MAX_AHEAD_S:
            return newest, f"the camera's newest image is {-age_s:.2f} s ahead of the clock"
        if not age_s <= max_frame_age_s:
            return newest, f"the camera's newest image is {age_s:.2f} s old"
        if newest.taken_s != previous.taken_s and newest.image_sha256 == previous.image_sha256:
            return newest, "the camera repeats an image to the last bit: it is frozen"
        return newest, ""
