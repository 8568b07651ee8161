"""R_0, the space that the tool occupies at the zero pose (section IV-A): one body for planner and simulator."""

import dataclasses
import math

from deltasafe.errors import SettingsError

__all__ = ["ToolBody"]


@dataclasses.dataclass(frozen=True)
class ToolBody:
    """An elliptic disc parallel to the table at the lower end of a slim vertical shaft (decision 12).

    The pose of the tool is the centre of the disc; yaw turns the ellipse, pi-periodically. The shaft rises
    from the disc to the flange, ``shaft_length_m`` above the centre of the disc.
    """

    semi_axis_x_m: float = 0.03
    semi_axis_y_m: float = 0.015
    thickness_m: float = 0.01
    shaft_radius_m: float = 0.005
    shaft_length_m: float = 0.25

    def __post_init__(self) -> None:
        for name, value in dataclasses.asdict(self).items():
            if not (math.isfinite(value) and value > 0):
                raise SettingsError(f"{name} must be a positive length in metres, got {value}")
        if self.shaft_radius_m > min(self.semi_axis_x_m, self.semi_axis_y_m):
            raise SettingsError(f"shaft_radius_m {self.shaft_radius_m} is wider than the disc")

    @property
    def rho_max_m(self) -> float:
        """Largest distance of a point of the body from the yaw axis: turns yaw error into workspace error."""
        return max(self.semi_axis_x_m, self.semi_axis_y_m)
