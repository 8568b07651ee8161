"""Settings of the tracking study, which identifies the tracking bound."""

import dataclasses
import math

from deltasafe.errors import SettingsError
from deltasafe.execution.arm_models import ArmSettings
from deltasafe.planning.body import ToolBody
from deltasafe.setting_ranges import check_range


@dataclasses.dataclass(frozen=True)
class TrackingStudySettings:
    """Number and kind of test motions, and the confidence of the bound.

    Attributes:
        n_slope_runs: runs that determine the slope, and nothing else.
        n_bound_runs: other runs, whose largest excess is the constant of the bound.
        n_held_out_runs: further runs, on which the bound is tested.
        runs_per_batch: number of runs that are computed and stored together.
        first_seed: run k, in this order, has the seed ``first_seed`` + k for motion, friction and sensors.
        content: fraction of all such runs that lies within the bound.
        confidence: confidence that it does.
        v_min_mps, v_max_mps: range of the top speeds, which are drawn uniformly.
        accelerations_mps2: accelerations of speeding up and of braking, drawn independently; the largest is that of the
            velocity schedule.
        yaw_rate_radps: largest turn rate.
        lower_m, upper_m: corners of the box of the tool's positions.
        record_rate_hz: rate at which errors are recorded.
        body: the space that the tool occupies.
        arm: which arm executes.
    """

    n_slope_runs: int = 200
    n_bound_runs: int = 600
    n_held_out_runs: int = 1000
    runs_per_batch: int = 50
    first_seed: int = 0
    content: float = 0.99
    confidence: float = 0.95
    v_min_mps: float = 0.005
    v_max_mps: float = 0.2
    accelerations_mps2: tuple[float, ...] = (0.1, 0.2, 0.35, 0.5)
    yaw_rate_radps: float = 1.0
    lower_m: tuple[float, float, float] = (-0.17, -0.12, 0.02)
    upper_m: tuple[float, float, float] = (0.17, 0.12, 0.2)
    record_rate_hz: float = 200.0
    body: ToolBody = dataclasses.field(default_factory=ToolBody)
    arm: ArmSettings = dataclasses.field(default_factory=ArmSettings)

    def __post_init__(self) -> None:
        check_range(self, "[1, inf)", "n_slope_runs", "n_bound_runs", "n_held_out_runs", "runs_per_batch")
        check_range(self, "(0, 1)", "content", "confidence")
        check_range(self, "[0, inf)", "first_seed")
        check_range(self, "(0, inf)", "accelerations_mps2", "yaw_rate_radps", "record_rate_hz")
        least = self.min_bound_runs
        if self.n_bound_runs < least:
            raise SettingsError(
                f"n_bound_runs must be at least {least} for {self.content:.0%} at {self.confidence:.0%} confidence, "
                f"got {self.n_bound_runs}"
            )
        if not 0 < self.v_min_mps <= self.v_max_mps < math.inf:
            raise SettingsError(f"speeds need 0 < v_min_mps <= v_max_mps, got {self.v_min_mps} and {self.v_max_mps}")
        if len(self.lower_m) != 3 or len(self.upper_m) != 3:
            raise SettingsError("lower_m and upper_m must have three coordinates")
        if not all(low < high for low, high in zip(self.lower_m, self.upper_m, strict=True)):
            raise SettingsError(f"lower_m must lie below upper_m, got {self.lower_m} and {self.upper_m}")

    @property
    def min_bound_runs(self) -> int:
        """Smallest n with 1 - content^n >= confidence (Wilks 1941): 299 for 99 % at 95 %."""
        return math.ceil(math.log(1 - self.confidence) / math.log(self.content) - 1e-12)

    @property
    def n_runs(self) -> int:
        """Number of all runs."""
        return self.n_slope_runs + self.n_bound_runs + self.n_held_out_runs
