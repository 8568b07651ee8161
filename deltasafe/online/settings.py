"""Settings of planning while the hand moves."""

import dataclasses

from deltasafe.errors import SettingsError
from deltasafe.setting_ranges import check_range


@dataclasses.dataclass(frozen=True)
class OnlineSettings:
    """Assumed hand speed, control cycle, braking, and what counts as a fault.

    Attributes:
        v_hand_mps: assumed maximum speed of the hand in any direction. The promise holds up to this speed.
        margin_m: r, the conformal margin around the unsafe set at the time of the image; 0: none.
        cycle_s: control cycle; each accepted piece of a motion is as long.
        brake_mps2: deceleration of a braking trajectory, beyond the acceleration limit of the path's schedule.
        sample_s: spacing of the samples of a committed motion.
        max_frame_age_s: an older image brakes the arm, even if nothing is near.
        max_ahead_s: tolerated lead of an image's time over the control's clock.
        clock_tolerance_s: a cycle that begins later than ``cycle_s`` by more brakes the arm.
        patience_cycles: cycles at rest before a new path is planned.
        horizon_s: paths are planned beside the unsafe set as it may be at this age of the image.
        reach_m: distances to the unsafe set are exact up to here, at most 90 voxels; it bounds the age of an image.
        monitor_margin_m: largest excess of the tracking error over its bound.
    """

    v_hand_mps: float = 0.2
    margin_m: float = 0.0
    cycle_s: float = 0.05
    brake_mps2: float = 1.0
    sample_s: float = 0.0025
    max_frame_age_s: float = 0.3
    max_ahead_s: float = 0.05
    clock_tolerance_s: float = 0.025
    patience_cycles: int = 4
    horizon_s: float = 0.35
    reach_m: float = 0.25
    monitor_margin_m: float = 0.001

    def __post_init__(self) -> None:
        check_range(self, "(0, 1]", "cycle_s", "sample_s", "max_frame_age_s", "reach_m")
        check_range(self, "(0, 100]", "brake_mps2")
        check_range(self, "[0, 2]", "v_hand_mps", "horizon_s")
        check_range(self, "[0, 1]", "margin_m", "max_ahead_s", "clock_tolerance_s", "monitor_margin_m")
        check_range(self, "[1, 1e6]", "patience_cycles")
        if not self.sample_s <= self.cycle_s / 2:
            raise SettingsError(f"sample_s must be at most half of cycle_s {self.cycle_s} s, got {self.sample_s} s")

        if not self.v_hand_mps * max(self.horizon_s, self.max_frame_age_s) < self.reach_m:
            raise SettingsError(
                f"v_hand_mps times horizon_s and times max_frame_age_s must be less than reach_m {self.reach_m} m, got "
                f"{self.v_hand_mps} m/s, {self.horizon_s} s and {self.max_frame_age_s} s"
            )

    def braking_time_s(self, v_max_mps: float) -> float:
        """Return the longest time in which a braking trajectory comes to rest, at speeds up to ``v_max_mps``."""
        return v_max_mps / self.brake_mps2 + self.sample_s

    def stopping_time_s(self, v_max_mps: float) -> float:
        """Return the longest time from a fault to rest: the cycle that runs, one already accepted, and the braking."""
        return 2 * self.cycle_s + self.braking_time_s(v_max_mps)
