"""Settings of an execution, free of everything that carries it out."""

import dataclasses
import math

from deltasafe.errors import SettingsError
from deltasafe.execution.impedance import ImpedanceSettings

__all__ = ["ExecutionSettings"]


@dataclasses.dataclass(frozen=True)
class ExecutionSettings:
    """How a motion is carried out.

    Attributes:
        approach_m: the tool comes down from, and leaves to, this height above start and goal; 0 for neither.
        approach_speed_mps: mean speed of that.
        settle_s: rest before and after the motion; the rest after it is judged with it (lag persists after braking).
        record_rate_hz: rate of the recorded arrays.
        monitor_margin_m: the arm is stopped once the workspace error exceeds gamma(max(v, min_speed)) by this.
        min_speed_mps: the smallest speed at which the bound is read; the paper's line is 0 at rest (decision 13).
        brake_delay_s: after a stop the controller holds the arm softly where it is until its brakes have closed. An
            assumption of the order of such brakes, not a figure of the data sheet.
        max_look_age_s: the arm does not start on an image older than this.
        max_frame_age_s: it stops when the camera's newest image is older than this.
        impedance: gains of the controller.
    """

    approach_m: float = 0.05
    approach_speed_mps: float = 0.05
    settle_s: float = 0.3
    record_rate_hz: float = 100.0
    monitor_margin_m: float = 0.001
    min_speed_mps: float = 0.01
    brake_delay_s: float = 0.03
    max_look_age_s: float = 60.0
    max_frame_age_s: float = 0.5
    impedance: ImpedanceSettings = dataclasses.field(default_factory=ImpedanceSettings)

    def __post_init__(self) -> None:
        for name in ("approach_m", "settle_s", "monitor_margin_m", "brake_delay_s"):
            value = getattr(self, name)
            if not (math.isfinite(value) and value >= 0):
                raise SettingsError(f"{name} must be finite and not negative, got {value}")
        for name in ("approach_speed_mps", "record_rate_hz", "min_speed_mps", "max_look_age_s", "max_frame_age_s"):
            value = getattr(self, name)
            if not (math.isfinite(value) and value > 0):
                raise SettingsError(f"{name} must be positive, got {value}")
