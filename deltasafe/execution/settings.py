"""Settings of an execution."""

import dataclasses

from deltasafe.execution.arm_models import ArmSettings
from deltasafe.execution.impedance import ImpedanceSettings
from deltasafe.setting_ranges import check_range


@dataclasses.dataclass(frozen=True)
class ExecutionSettings:
    """How a motion is executed.

    Attributes:
        approach_m: the tool comes down from this height above the start, and leaves to this height above the goal;
            0 for no approach and no retreat.
        approach_speed_mps: mean speed of approach and retreat.
        settle_s: rest before and after the motion. The rest after it is evaluated too: lag persists after braking.
        record_rate_hz: sampling rate of the recording.
        monitor_margin_m: the monitor stops the arm if the workspace error exceeds gamma(max(v, v_min)) by more.
        brake_delay_s: after a stop the controller holds the arm softly until its brakes have closed after this time.
            Assumed, in the order of such brakes; not a figure of the data sheet.
        max_look_age_s: the arm does not start if the image that the motion was planned from is older.
        max_frame_age_s: the arm stops if the camera's newest image is older.
        impedance: gains of the controller.
        arm: which arm executes.
    """

    approach_m: float = 0.05
    approach_speed_mps: float = 0.05
    settle_s: float = 0.3
    record_rate_hz: float = 100.0
    monitor_margin_m: float = 0.001
    brake_delay_s: float = 0.03
    max_look_age_s: float = 60.0
    max_frame_age_s: float = 0.5
    impedance: ImpedanceSettings = dataclasses.field(default_factory=ImpedanceSettings)
    arm: ArmSettings = dataclasses.field(default_factory=ArmSettings)

    def __post_init__(self) -> None:
        check_range(self, "[0, inf)", "approach_m", "settle_s", "monitor_margin_m", "brake_delay_s")
        check_range(self, "(0, inf)", "approach_speed_mps", "record_rate_hz", "max_look_age_s", "max_frame_age_s")
